"""First populations, random graphs of many kinds, choices, and how strategies drift (eq. 2)."""

import math
from typing import Any

import networkx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, nested_actions, same, seeded
from torch import Generator, Tensor
from walking import chain

from cgtorch.evolution import STRATEGY
from cgtorch.evolution.population import (
    INITIAL_STRATEGY,
    PROBABILITY_MAX,
    SIGMA_MAX,
    STRATEGY_MIN,
    drifted,
    factors,
    lasting,
    looping,
    occurrence,
    population_from,
    random_graphs,
    random_population,
    seeded_population,
    varied_graphs,
)
from cgtorch.graphs import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Graphs,
    LinearNN,
    RecurrentNN,
    Step,
    compacted,
    to_networkx,
    valid,
)
from cgtorch.ground.counter_rng import BITS, keys, nth_true, pick, random_key
from cgtorch.ground.errors import GraphError

ACTIONS = custom_actions()
SENDING = {"Linear", "Aim", "Delay", "Recur", "ContinuousNN", "Counter"}
REWARDED = ActionSet(
    ("Linear", "Aim", "Delay", "Recur", "Branch", "Step"),
    (
        LinearNN(4, 2),
        ContinuousNN(4, 8, 2),
        DelayNN(4, outputs=2),
        RecurrentNN(4, outputs=2),
        BranchingNN(4),
        Step(2),
    ),
)


class Counts(LinearNN):
    """Counts for how many nodes parameters are drawn, by its name."""

    def __init__(self, name: str, counts: dict[str, int]) -> None:
        super().__init__(20, 2)
        self.name, self.counts = name, counts

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        self.counts[self.name] += n
        return super().initial_parameters(n, generator)


def test_choices_are_uniform_and_only_where_allowed() -> None:
    mask = torch.tensor([[False, True, True, False, True], [False] * 5]).repeat(3000, 1)
    draws = torch.rand(6000, 3, generator=seeded(0))
    for column in range(3):
        picked = nth_true(mask, draws[:, column])
        counts = torch.bincount(picked[::2], minlength=5)
        assert counts[0] == counts[3] == 0
        assert ((counts[[1, 2, 4]] - 1000).abs() < 5 * 1000**0.5).all()
        assert (picked[1::2] == 0).all()
    assert torch.equal(nth_true(mask, draws)[:, 1], nth_true(mask, draws[:, 1]))


def test_a_pick_is_never_out_of_range() -> None:
    ends = torch.tensor([0.0, 1 - 2.0**-BITS, 1 - 2.0**-24, 1.0])
    for count in (1, 3, 24, 1000, 2**25):
        picked = pick(ends, count)
        assert picked[0] == 0
        assert (picked < count).all()
        assert picked[-1] == count - 1
    assert (pick(ends, 0) == 0).all()


def test_a_random_population_is_as_random_as_it_says() -> None:
    population = random_population(3000, ACTIONS, 20, (4, 12), seeded(0))
    graphs = population.graphs
    assert torch.equal(population.strategy, torch.tensor(INITIAL_STRATEGY).repeat(3000, 1))
    counts = torch.bincount(graphs.action[graphs.used])
    assert (counts > 0).all()
    assert len(counts) == len(ACTIONS)
    of_network = graphs.parameters[graphs.action == ACTIONS.index("ContinuousNN")]
    assert of_network.mean().item() == pytest.approx(0, abs=0.01)
    assert of_network.std().item() == pytest.approx(1, abs=0.01)


def test_half_of_a_seeded_population_copies_the_seeds_in_turn() -> None:
    old = random_population(3, ACTIONS, 12, (4, 12), seeded(0))
    wider = nested_actions()
    population = seeded_population(9, old, wider, 16, (4, 12), seeded(1))
    assert len(population) == 9
    for i in range(4):
        copy, seed = population[i : i + 1].graphs, compacted(old.graphs[i % 3 : i % 3 + 1])
        assert torch.equal(copy.action[:, :12], seed.action)
        assert torch.equal(copy.edges[:, :12], seed.edges)
        assert torch.equal(copy.parameters[:, :12, : seed.parameters.shape[2]], seed.parameters)
        assert int(copy.num_nodes[0]) == int(seed.num_nodes[0])
        assert torch.equal(population.strategy[i], old.strategy[i % 3])


def test_seeds_that_do_not_fit_are_refused() -> None:
    old = random_population(50, ACTIONS, 20, (20, 20), seeded(0))
    big = old[(old.graphs.num_nodes > 6).nonzero()[:, 0]]
    with pytest.raises(GraphError, match="do not fit into 6 nodes"):
        seeded_population(10, big, ACTIONS, 6, (2, 6), seeded(0))


@pytest.mark.parametrize(
    "bad",
    [
        {"action": torch.zeros(3, 5, dtype=torch.int32)},
        {"action": torch.zeros(0, 5, dtype=torch.long)},
        {"edges": torch.zeros(3, 5, 1, dtype=torch.long)},
        {"start": torch.full((3,), 5)},
        {"strategy": torch.zeros(3, len(STRATEGY), dtype=torch.float64)},
        {"strategy": torch.zeros(2, len(STRATEGY))},
        {"strategy": torch.full((3, len(STRATEGY)), torch.nan)},
        {"start": "one"},
        {"parameters": "inf"},
        {"parameters": "double"},
    ],
)
def test_tensors_of_other_shapes_types_or_numbers_are_no_population(bad: dict[str, Any]) -> None:
    made = random_population(3, ACTIONS, 5, (2, 5), seeded(0))
    tensors = {**vars(made.graphs), "strategy": made.strategy}
    again = population_from(tensors, ACTIONS)
    assert all(again.graphs.__dict__[name] is tensors[name] for name in vars(made.graphs))
    some = made.graphs.parameters
    one = torch.where(torch.arange(3) == 1, 5, made.graphs.start)
    odd = {"inf": some + torch.inf, "double": some.double(), "one": one}
    wrong = {name: odd[x] if isinstance(x, str) else x for name, x in bad.items()}
    with pytest.raises(GraphError, match="not those of valid graphs; restore the file"):
        population_from({**tensors, **wrong}, ACTIONS)


def kinds(graphs: Graphs) -> list[tuple[int, ...]]:
    return [tuple(sorted(x for x in row if x >= 0)) for row in graphs.action.tolist()]


def test_a_seed_says_which_varied_graphs_there_are() -> None:
    one, again, other = (varied_graphs(20, ACTIONS, 8, (2, 5), seeded(s)) for s in (0, 0, 1))
    assert same(one, again)
    assert not same(one, other)


def test_small_populations_have_all_pairs_that_act_equally_often_and_nothing_else() -> None:
    """Of each pair, four act by what was seen first only."""
    for seed in range(10):
        graphs = varied_graphs(48, REWARDED, 24, (2, 2), seeded(seed))
        assert valid(graphs, REWARDED).all()
        loops = looping(graphs, REWARDED)
        assert lasting(graphs, REWARDED).all()
        for some, count in ((graphs[loops], 8), (graphs[~loops], 4)):
            found = kinds(some)
            assert {kind: found.count(kind) for kind in found} == {(a, 5): count for a in range(4)}
        assert loops[:4].all()


def test_without_steps_all_strongly_connected_graphs_loop() -> None:
    actions = ActionSet(REWARDED.names[:4], REWARDED.actions[:4])
    found = kinds(varied_graphs(48, actions, 24, (2, 2), seeded(0)))
    assert set(found) == {(a, b) for a in range(4) for b in range(a, 4)} | {(a,) for a in range(4)}


@given(st.integers(0, 2**20), st.sampled_from([custom_actions(), REWARDED]))
def test_looping_is_strongly_connected_by_edges_that_are_followed(
    seed: int, actions: ActionSet
) -> None:
    graphs = random_graphs(30, actions, 6, (1, 6), seeded(seed))
    for i, loops in enumerate(looping(graphs, actions).tolist()):
        whole = to_networkx(graphs, actions, i)
        steps = {node for node, name in whole.nodes(data="action") if name in ("Step", "MoveBase")}
        failures = [e for e in whole.edges(keys=True) if e[0] in steps and e[2] == "failure"]
        others = [e for e in whole.edges(keys=True) if e[0] in steps and e[2] == "success"]
        later, first = whole.copy(), whole.copy()
        later.remove_edges_from(failures)
        first.remove_edges_from(others)
        begins = {*networkx.descendants(first, whole.graph["start"]), whole.graph["start"]}
        sends = any(whole.nodes[node]["action"] in SENDING for node in begins)
        assert loops == (networkx.is_strongly_connected(later) and sends and bool(steps))


@pytest.mark.parametrize(
    ("names", "edges", "loops", "lasts"),
    [
        (("Aim", "Step"), {}, True, True),
        (("Aim", "Linear"), {}, False, False),  # says much and does nothing
        (("Step", "Branch"), {}, False, False),  # does nothing, as nothing is said
        (("Aim", "Step"), {(1, "failure"): 1}, True, True),  # there is a message by then
        (("Aim", "Step"), {(1, "success"): 1}, False, True),  # only the first percept counts
        (("Step", "Aim"), {}, True, True),  # the first step fails, as there is no message yet
        (("Step", "Aim"), {(0, "failure"): 0}, False, False),  # and fails for ever
        (("Aim", "Step", "Linear"), {(2, "success"): 2}, False, False),  # acts once, then talks
        (
            ("Branch", "Aim", "Step"),
            {(0, "out1"): 1, (0, "out2"): 2, (2, "failure"): 2}, True, True,
        ),
    ],
)  # fmt: skip
def test_what_is_a_loop_where_steps_do_not_fail(
    names: tuple[str, ...], edges: dict[tuple[int, str], int], loops: bool, lasts: bool
) -> None:
    graph = chain(REWARDED, *names, edges=edges)
    assert looping(graph, REWARDED).tolist() == [loops]
    assert lasting(graph, REWARDED).tolist() == [lasts]


def test_only_the_parameters_of_kept_graphs_are_drawn() -> None:
    counts = dict.fromkeys(REWARDED.names, 0)
    counted = [Counts(name, counts) for name in ("Linear", "Aim")]
    actions = ActionSet((*[each.name for each in counted], "Step"), (*counted, Step(2)))
    graphs = varied_graphs(24, actions, 8, (2, 2), seeded(0))
    for i, name in enumerate(actions.names[:2]):
        assert counts[name] == int((graphs.action == i).sum()) > 0
        drawn = graphs.parameters[graphs.action == i]
        assert drawn.std().item() == pytest.approx(1, abs=0.1)
    assert (graphs.parameters[graphs.action < 0] == 0).all()
    assert (graphs.parameters[graphs.action == 2] == 0).all()


def test_what_does_not_loop_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cgtorch.evolution.population.DRAWN", 1)
    actions = custom_actions()
    loops = looping(varied_graphs(60, actions, 6, (3, 6), seeded(0)), actions).tolist()
    assert loops == sorted(loops, reverse=True)
    assert True in loops
    assert False in loops


def test_the_order_of_a_group() -> None:
    group = torch.tensor([3, 1, 3, 3, 1, 2])
    assert occurrence(group).tolist() == [0, 0, 1, 2, 1, 0]
    assert occurrence(group[:0]).tolist() == []


def drift(strategy: Tensor, tau: float, generator: Generator) -> Tensor:
    own = keys(random_key(generator), len(strategy))
    return drifted(strategy, factors(own, tau))


def test_drift_is_log_normal_with_variance_tau() -> None:
    strategy: Tensor = torch.full((20_000, len(STRATEGY)), 0.05)
    for tau in (0.01, 0.05):
        log = (drift(strategy, tau, seeded(0)) / strategy).log()
        assert log.mean().item() == pytest.approx(0, abs=0.002)
        assert log.var().item() == pytest.approx(tau, rel=0.02)
        within = (log.abs() < tau**0.5).float().mean()
        assert within == pytest.approx(math.erf(0.5**0.5), abs=0.005)
        together = torch.corrcoef(log.T) - torch.eye(len(STRATEGY))
        assert together.abs().max() < 0.05  # every parameter drifts by itself


def test_drift_stays_within_its_bounds_and_needs_a_variance() -> None:
    strategy = torch.rand(50, len(STRATEGY)).clamp_min(STRATEGY_MIN)
    assert torch.equal(drift(strategy, 0.0, seeded(0)), strategy)
    strategy = torch.full((50, len(STRATEGY)), 0.5)
    generator = seeded(0)
    for _ in range(200):
        strategy = drift(strategy, 1.0, generator)
        assert strategy.min() >= STRATEGY_MIN
        assert strategy[:, :-1].max() <= PROBABILITY_MAX
        assert strategy[:, -1].max() <= SIGMA_MAX
    assert STRATEGY[-1] == "sigma"
    assert strategy[:, -1].max() > PROBABILITY_MAX
