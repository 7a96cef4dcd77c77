"""Networks that remember: compiled, in torch and by the plain interpreter."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from random_kernel_models import DOMAINS, random_kernel_models
from random_models import models_as, random_models
from support import (
    as_double,
    nested_actions,
    random_graphs,
    recurrent_actions,
    seeded,
    world,
)
from test_resumable_rollouts import assert_same, in_torch, waiting
from told_by_runs import tensors_of
from torch.nn.functional import pad
from walking import Path, RewardedPath, chain, path

from cgtorch.graphs import (
    Action,
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Graphs,
    RecurrentNN,
    Step,
    SubSkill,
    Test,
    reward_actions,
)
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.native import available
from cgtorch.simulation import rollout
from cgtorch.simulation.compiled import NETWORKS, WITH_MEMORY, compiled_actions
from cgtorch.simulation.rollout import engine_of
from cgtorch.tabletop.actions import paper_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

PLAIN_SETS = [recurrent_actions(), nested_actions(0, recurrent_actions())]


def using(graphs: Graphs, actions: ActionSet) -> torch.Tensor:
    """(P,) bool, which graphs have a node that remembers."""
    known = [i for i, each in enumerate(actions.actions) if isinstance(each, RecurrentNN | DelayNN)]
    return torch.isin(graphs.action, torch.tensor(known)).any(1)


def not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(*given: Any) -> None:
        raise AssertionError("Python is asked for what the network says")

    monkeypatch.setattr(RecurrentNN, "forward", asked)
    monkeypatch.setattr(DelayNN, "forward", asked)


@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize("hidden", [1, 3, 5, 20])
def test_in_the_models_of_any_domain(domain: str, hidden: int) -> None:
    environment = random_kernel_models(3, 7, *DOMAINS[domain])
    d, u = environment.percept_size, environment.control_size
    networks = RecurrentNN(d, hidden, u), BranchingNN(d), ContinuousNN(d - 1, outputs=u)
    actions = ActionSet(
        ("RecurrentNN", "Branch", "Aim", "Step", "Test"), (*networks, Step(u), Test())
    )
    graphs = as_double(random_graphs(hidden, 60, actions))
    given = graphs, actions, environment, (20, 60)
    found = waiting(*given)
    assert (found.state[..., 0] > 1).any()
    assert_same(found, in_torch(*given), 1e-8)


def walkers(network: Action, count: int, spread: float) -> tuple[Graphs, ActionSet]:
    """Two networks in turns, in every graph others, which go on from one another's states."""
    actions = ActionSet(("Network", "Step"), (network, Step(1)))
    one = chain(actions, "Network", "Step", "Network", "Step")
    graphs = one[torch.zeros(count, dtype=torch.long)]
    values = spread * torch.randn(graphs.parameters.shape, generator=seeded(1))
    values[:, 1::2] = 0
    return replace(graphs, parameters=values), actions


@pytest.mark.parametrize("kind", [Path, RewardedPath])
@pytest.mark.parametrize(
    ("network", "spread"),
    [
        (RecurrentNN(2, 3, 1), 1.0), (RecurrentNN(2, 30, 1), 0.25), (RecurrentNN(2, 64, 1), 0.25),
        (RecurrentNN(2, 65, 1), 0.25), (DelayNN(2, 0, 1), 1.0), (DelayNN(2, 1, 1), 0.5),
        (DelayNN(2, 3, 1), 0.25), (DelayNN(2, 100, 1), 0.01),
    ],
)  # fmt: skip
def test_whole_walks(kind: type[Path], network: Action, spread: float) -> None:
    given = *walkers(network, 20, spread), kind(path(3, 30, 40).scenarios), (60, 400)
    found, wanted = waiting(*given), in_torch(*given)
    assert found.executed == wanted.executed > 5_000
    assert found.percept.std() > 0.1
    assert_same(found, wanted, 1e-3)


@pytest.mark.parametrize("actions", PLAIN_SETS)
def test_python_is_not_asked(actions: ActionSet, monkeypatch: pytest.MonkeyPatch) -> None:
    graphs = random_graphs(1, 200, paper_with(actions))
    assert using(graphs, paper_with(actions)).any()
    places: list[Environment] = [models_as(random_models(1, 5), torch.float32), world(1, 5)]
    wanted = [rollout(graphs, paper_with(actions), place) for place in places]
    not_asked(monkeypatch)
    for place, runs in zip(places, wanted, strict=True):
        found = rollout(graphs, paper_with(actions), place)
        assert all(torch.equal(x, tensors_of(found)[n]) for n, x in tensors_of(runs).items())


def paper_with(actions: ActionSet) -> ActionSet:
    """The paper's actions and a network that remembers of those given, which may be in skills."""
    names = [*paper_actions().names, "RecurrentNN", *(n for n in actions.names if n[0] == "S")]
    return ActionSet(tuple(names), tuple(actions.actions[actions.index(n)] for n in names))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_result_depends_on_nothing_else_in_the_batch(dtype: torch.dtype) -> None:
    """One graph's lanes share their weights, those of many have columns of them: the same bits."""
    actions, place = PLAIN_SETS[0], world(2, 33, dtype=dtype)
    graphs = random_graphs(2, 60, actions)
    if dtype == torch.float64:
        graphs = as_double(graphs)
    everything = rollout(graphs, actions, place)
    for i in using(graphs, actions).nonzero()[:20, 0].tolist():
        alone = rollout(graphs[i : i + 1], actions, place)
        for name, value in tensors_of(alone).items():
            assert torch.equal(value[0], getattr(everything, name)[i]), name


@pytest.mark.parametrize(("silent", "still"), [(False, False), (True, False), (True, True)])
def test_what_is_remembered_counts_as_a_change(silent: bool, still: bool) -> None:
    """A loop is only skipped where neither the message nor the state is another one."""
    actions, place = ActionSet(("R",), (RecurrentNN(2, 3, 1),)), Path(path(0, 20).scenarios)
    graphs = chain(actions, "R")
    values = torch.randn(graphs.parameters.shape, generator=seeded(4))
    own, first = actions.actions[0].num_parameters, 3 * (2 + 3 + 1)
    values[..., own:] = 0
    if silent:
        values[..., first:own] = 0
    if still:
        values[..., :first] = 0
    given = replace(graphs, parameters=values), actions, place, (8, 400)  # before it comes to rest
    found, wanted = waiting(*given), in_torch(*given)
    assert (found.transitions == 8).all()
    assert found.executed == wanted.executed == (2 if still else 8) * 20


def test_graphs_without_it_stay_where_they_were() -> None:
    """In a set that has it they run graph by graph, to the same bits; those with it do not."""
    environment, some = models_as(random_models(3, 21), torch.float32), torch.arange(21)
    paper = paper_actions()
    actions = paper_with(PLAIN_SETS[1])
    before, after = engine_of(paper, environment), engine_of(actions, environment)
    graphs = random_graphs(0, 40, paper)
    assert before is not None
    assert after is not None
    wide = replace(graphs, parameters=pad(graphs.parameters, (0, 20)))
    for limits in ((20, 400), (7, 11)):
        wanted, found = before.rollouts(graphs, some, *limits), after.rollouts(wide, some, *limits)
        assert wanted is not None
        assert found is not None
        assert found.executed == wanted.executed
        for name, value in tensors_of(wanted).items():
            assert torch.equal(getattr(found, name), value), name
    assert not after.known.resumable_alone(wide)
    for name in ("RecurrentNN", "S0", "S1"):
        mixed = replace(wide, action=wide.action.clone())
        mixed.action[7, 0] = actions.index(name)
        action = actions.actions[actions.index(name)]
        inside = action.skill.used_actions if isinstance(action, SubSkill) else {name}
        uses = bool(inside - {*paper.names, "S0", "S1"})
        assert after.known.resumable_alone(mixed) == uses
        assert (after.rollouts(mixed, some, 20, 400) is None) == uses


@pytest.mark.parametrize(
    ("kind", "sizes", "compiled"),
    [
        (RecurrentNN, (7, 64, 32), True), (RecurrentNN, (400, 64, 32), True),
        (RecurrentNN, (7, 65, 3), False), (RecurrentNN, (401, 3, 3), False),
        (RecurrentNN, (7, 3, 33), False), (RecurrentNN, (421, 3, 3), False),
        (DelayNN, (7, 3, 32), True), (DelayNN, (400, 3, 32), True), (DelayNN, (320, 4, 3), True),
        (DelayNN, (400, 4, 3), False), (DelayNN, (401, 0, 3), False),
    ],
)  # fmt: skip
def test_what_is_too_large_is_in_python(
    kind: type[Action], sizes: tuple[int, int, int], compiled: bool
) -> None:
    actions = ActionSet(("Network",), (kind(*sizes),))
    known = compiled_actions(actions, 420, torch.float32, (*NETWORKS, *WITH_MEMORY))
    assert known is not None
    assert known.in_python == (not compiled,)
    assert known.only_resumable.tolist() == [1, 0]


class Dimmed(RecurrentNN):
    """Another class, which C knows nothing of."""


def test_subclasses_and_changed_ones_run_in_python() -> None:
    changed = RecurrentNN()
    changed.forward = changed.forward  # type: ignore[method-assign]
    short = RecurrentNN()
    short.memory_size = 2
    shallow = DelayNN()
    shallow.memory_size -= 1
    for action in (Dimmed(), changed, short, shallow):
        known = compiled_actions(ActionSet(("A",), (action,)), 7, torch.float32, WITH_MEMORY)
        assert known is not None
        assert known.in_python == (True,)


@pytest.mark.parametrize(
    ("kind", "sizes", "alone"),
    [
        (ContinuousNN, (64, 8, 16), False), (ContinuousNN, (65, 8, 3), True),
        (ContinuousNN, (7, 8, 17), True), (BranchingNN, (64, 8), False),
        (BranchingNN, (65, 8), True),
    ],
)  # fmt: skip
def test_what_is_too_large_for_vectors_of_lanes_waits_for_python(
    kind: type[Action], sizes: tuple[int, ...], alone: bool
) -> None:
    actions = ActionSet(("Network", "Step"), (kind(*sizes), Step(3)))
    known = compiled_actions(actions, 420, torch.float32, (*NETWORKS, "STEP"))
    assert known is not None
    assert known.in_python == (False, False)
    assert known.only_resumable.tolist() == [int(alone), 0, 0]


class Far:
    """Lanes with D numbers, of which U controls move all."""

    def __init__(self, percepts: int, controls: int) -> None:
        self.num_scenarios, self.percept_size, self.control_size = 5, percepts, controls

    def start(self, scenario: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        percept = torch.linspace(-1, 1, self.percept_size, dtype=torch.float64)
        return torch.zeros(len(scenario), 1), percept * (1 + scenario[:, None])

    def step(self, lanes: Lanes, control: torch.Tensor) -> tuple[Lanes, torch.Tensor]:
        moved = lanes.percept.roll(1, 1) + 0.1 * control.mean(1, keepdim=True).tanh()
        done = control.isfinite().all(1)
        return replace(lanes, percept=torch.where(done[:, None], moved, lanes.percept)), done

    def observe(self, lanes: Lanes) -> Lanes:
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, torch.Tensor]:
        return lanes, lanes.percept[:, 0]


@pytest.mark.parametrize(("percepts", "controls"), [(65, 17), (105, 8), (348, 17), (400, 32)])
def test_networks_of_wide_percepts_run_compiled_and_do_what_they_do_in_torch(
    percepts: int, controls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several graphs with lanes of their own, whose large networks cannot run side by side."""
    basic = reward_actions(percepts, controls)
    graphs = as_double(random_graphs(0, 40, basic, nodes=(2, 4)))
    given = graphs, basic, Far(percepts, controls), (30, 30)
    wanted = in_torch(*given)
    for kind in (RecurrentNN, DelayNN, ContinuousNN, BranchingNN):
        monkeypatch.setattr(kind, "forward", None)
    assert wanted.percept.std() > 0.1
    assert_same(waiting(*given), wanted, 1e-9)
