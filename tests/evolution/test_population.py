"""First populations, choices, and how strategies drift (eq. 2)."""

import math
from typing import Any

import pytest
import torch
from support import custom_actions, nested_actions, seeded
from torch import Generator, Tensor

from cgtorch.evolution import STRATEGY
from cgtorch.evolution.population import (
    INITIAL_STRATEGY,
    PROBABILITY_MAX,
    SIGMA_MAX,
    STRATEGY_MIN,
    drifted,
    factors,
    population_from,
    random_population,
    seeded_population,
)
from cgtorch.graphs import (
    compacted,
)
from cgtorch.ground.counter_rng import BITS, keys, nth_true, pick, random_key
from cgtorch.ground.errors import GraphError

ACTIONS = custom_actions()


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
