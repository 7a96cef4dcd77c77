"""Compiled rollouts against the batched engine, which the plain interpreter checks."""

import copy
import itertools
from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import models_as, random_models
from support import (
    FOOTPRINT,
    as_double,
    as_double_actions,
    custom_actions,
    nested_actions,
    random_graphs,
    seeded,
)
from told_by_runs import tensors_of
from torch import Tensor
from walking import chain

from cgtorch.graphs import ActionSet, Graphs, Skill, SubSkill, resized
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.rollout import engine_of
from cgtorch.simulation.torch_engine import rollout_in_torch
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import edge_actions, edge_way_actions

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SCENES = [("box", 0), ("box", 1), ("yaw", 0), ("yaw", 1), ("yaw", 3)]


def sets_for(size: int) -> list[ActionSet]:
    paper, edge = paper_actions(size), edge_actions(size)
    both = ActionSet(
        (*paper.names, "EdgeNN", "EdgeBranchingNN"), (*paper.actions, *edge.actions[3:])
    )
    inner, way = nested_actions(3, both), edge_way_actions(size, FOOTPRINT)
    return [as_double_actions(s) for s in (paper, edge, both, inner, way)]


def graphs_of(seed: int, actions: ActionSet, count: int = 12) -> Graphs:
    return as_double(random_graphs(seed, count, actions))


def run_compiled(
    graphs: Graphs,
    actions: ActionSet,
    environment: ModelEnvironment,
    scenarios: Tensor,
    limit: int = 20,
    steps: int = 400,
) -> Rollouts | None:
    engine = engine_of(actions, environment)
    return engine and engine.rollouts(graphs, scenarios, limit, steps)


def compiled(*given: Any) -> Rollouts:
    """`run_compiled`, which has to be possible."""
    found = run_compiled(*given)
    assert found is not None
    return found


def run_in_torch(
    graphs: Graphs,
    actions: ActionSet,
    environment: ModelEnvironment,
    scenarios: Tensor,
    limit: int = 20,
    steps: int = 400,
) -> Rollouts:
    program = compile_graphs(graphs, actions)
    return rollout_in_torch(program, environment, scenarios, limit, steps)


def assert_same(found: Rollouts, wanted: Rollouts) -> None:
    for name in ("succeeded", "timed_out", "transitions"):
        assert torch.equal(getattr(found, name), getattr(wanted, name)), name
    for name in ("percept", "state"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), atol=1e-9, rtol=0)


def equal(first: Rollouts, second: Rollouts) -> bool:
    one, other = tensors_of(first), tensors_of(second)
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


@given(
    seed=st.integers(0, 2**31),
    scene=st.sampled_from(SCENES),
    which=st.integers(0, 4),
    limit=st.integers(1, 20),
    steps=st.integers(1, 60),
    errors=st.booleans(),
)
@settings(max_examples=20, deadline=None)
def test_compiled_rollouts_are_those_of_the_engine(
    seed: int, scene: tuple[str, int], which: int, limit: int, steps: int, errors: bool
) -> None:
    environment = random_models(seed, 6, *scene, errors=errors)
    actions = sets_for(environment.percept_size)[which]
    some = torch.tensor([4, 0, 5])
    given = graphs_of(seed, actions), actions, environment, some, limit, steps
    assert_same(compiled(*given), run_in_torch(*given))


@pytest.mark.parametrize("scene", SCENES)
def test_the_comparison_meets_every_end(scene: tuple[str, int]) -> None:
    environment = random_models(5, 10, *scene)
    found = [
        compiled(graphs_of(1, actions, 60), actions, environment, torch.arange(10))
        for actions in sets_for(environment.percept_size)
    ]
    ends = [(r.succeeded.sum(), r.timed_out.sum(), (r.state[..., 0] > 1).sum()) for r in found]
    success, timeout, moved = torch.tensor(ends).sum(0).tolist()
    lost = sum(int((r.state[..., 1] > 0).sum()) for r in found)
    assert min(success, timeout, moved, lost) >= 20, (success, timeout, moved, lost)


def test_rollout_asks_compiled_code_first() -> None:
    environment, actions = random_models(0, 4), sets_for(7)[0]
    graphs = as_double(random_graphs(0, 5, actions))
    wanted = compiled(graphs, actions, environment, torch.arange(4))
    assert equal(rollout(graphs, actions, environment), wanted)


def test_what_cannot_be_counted_runs_in_torch() -> None:
    actions = sets_for(7)[0]
    given = graphs_of(0, actions), actions, random_models(0, 4), torch.arange(4)
    assert run_compiled(*given, 2**30, 400) is not None
    assert run_compiled(*given, 2**30 + 1, 400) is None
    assert run_compiled(*given, 20, 2**31) is None
    graphs = graphs_of(0, actions)
    assert run_compiled(replace(graphs, edges=graphs.edges.int()), *given[1:]) is None
    assert run_compiled(replace(graphs, parameters=graphs.parameters.float()), *given[1:]) is None


@given(
    seed=st.integers(0, 2**31),
    which=st.integers(0, 4),
    nodes=st.integers(0, 3),
    outcomes=st.integers(0, 2),
    count=st.integers(0, 12),
)
@settings(max_examples=10, deadline=None)
def test_slots_that_nothing_uses_and_strides_change_nothing(
    seed: int, which: int, nodes: int, outcomes: int, count: int
) -> None:
    environment, actions = random_models(seed, 3), sets_for(7)[which]
    graphs, some = graphs_of(seed, actions)[:count], torch.arange(3)
    n, o, k = *graphs.edges.shape[1:], graphs.parameters.shape[2]
    wide = resized(graphs, n + nodes, o, k + outcomes)
    every_other = Graphs(*(x.repeat_interleave(2, 0)[::2] for x in vars(wide).values()))
    wanted = compiled(graphs, actions, environment, some)
    for same in (wide, every_other):
        assert equal(compiled(same, actions, environment, some), wanted)


def test_what_others_plug_in_runs_in_torch() -> None:
    environment, everything = random_models(0, 4), torch.arange(4)

    def runs_compiled(environment: ModelEnvironment, actions: ActionSet) -> bool:
        found = run_compiled(graphs_of(0, actions), actions, environment, everything)
        return found is not None

    def swapped(name: str, value: object) -> ModelEnvironment:
        other = copy.copy(environment)
        setattr(other, name, value)
        return other

    class Mine(ModelEnvironment):
        """A model environment that might do anything."""

    mine = copy.copy(environment)
    mine.__class__ = Mine
    actions = sets_for(7)[0]
    assert runs_compiled(environment, actions)
    assert not runs_compiled(environment, as_double_actions(custom_actions()))
    gamma, classifier, possible = environment.gamma, environment.classifier, environment.possible
    assert not runs_compiled(swapped("gamma", lambda p, u: gamma(p, u)), actions)
    assert not runs_compiled(swapped("classifier", lambda p: classifier(p)), actions)
    assert not runs_compiled(swapped("possible", lambda p, u: possible(p, u)), actions)
    assert not runs_compiled(mine, actions)


def test_no_number_of_threads_changes_anything() -> None:
    environment, actions = random_models(2, 9), sets_for(7)[2]
    graphs, before = graphs_of(2, actions, 50), torch.get_num_threads()
    try:
        results = []
        for count in (1, 2, 5):
            torch.set_num_threads(count)
            results.append(compiled(graphs, actions, environment, torch.arange(9)))
    finally:
        torch.set_num_threads(before)
    assert all(equal(results[0], other) for other in results)


@given(
    seed=st.integers(0, 2**31),
    scene=st.sampled_from(SCENES),
    which=st.integers(0, 4),
    single=st.booleans(),
    count=st.integers(1, 37),
)
@settings(max_examples=20, deadline=None)
def test_no_lane_depends_on_others_to_the_bit(
    seed: int, scene: tuple[str, int], which: int, single: bool, count: int
) -> None:
    environment, generator = random_models(seed, 37, *scene), seeded(seed)
    environment.percepts[3, 4], environment.percepts[5, 0] = torch.nan, torch.inf
    actions = sets_for(environment.percept_size)[which]
    graphs = as_double(random_graphs(seed, 9, actions))
    if single:
        if which == 3:
            return  # sub-skills are in float64
        environment, graphs = models_as(environment, torch.float32), random_graphs(seed, 9, actions)
    some = torch.randperm(37, generator=generator)[:count]
    rows = torch.randperm(9, generator=generator)[:4]
    whole, part = (
        compiled(g, actions, environment, scenarios)
        for g, scenarios in ((graphs, torch.arange(37)), (graphs[rows], some))
    )
    for name, value in tensors_of(whole).items():
        wanted = value[rows][:, some]
        same = (getattr(part, name) == wanted) | (
            (wanted != wanted) & (getattr(part, name) != wanted)
        )
        assert bool(same.all()), name


def test_percepts_that_are_not_numbers_end_as_in_torch() -> None:
    environment = random_models(1, 6)
    environment.percepts[0, 4], environment.percepts[1, 0] = torch.nan, torch.inf
    environment.percepts[2] = 1e300
    environment.first_state[:3, 2] = environment.classifier(environment.percepts[:3])
    for actions in sets_for(7):
        graphs = graphs_of(7, actions, 40)
        graphs.parameters.flatten(0, 1)[::7] = torch.nan
        given = graphs, actions, environment, torch.arange(6)
        found, wanted = compiled(*given), run_in_torch(*given)
        finite = wanted.percept.isfinite().all(-1) & wanted.state.isfinite().all(-1)
        assert torch.equal(
            finite, found.percept.isfinite().all(-1) & found.state.isfinite().all(-1)
        )
        for name in ("succeeded", "timed_out", "transitions"):
            assert torch.equal(getattr(found, name)[finite], getattr(wanted, name)[finite]), name


def test_models_that_change_between_two_rollouts_are_looked_at_again() -> None:
    environment, some = random_models(3, 10, errors=True), torch.arange(10)
    actions = sets_for(7)[2]
    given = graphs_of(2, actions, 60), actions, environment, some

    def check() -> Rollouts:
        found = compiled(*given)
        assert_same(found, run_in_torch(*given))
        return found

    seen = [check(), check()]
    assert equal(*seen)
    gamma = environment.gamma.__self__  # type: ignore[attr-defined]
    classifier = environment.classifier
    assert environment.errors is not None
    environment.errors *= -3  # in place
    seen.append(check())
    gamma.most = gamma.most * 0.01  # another tensor
    seen.append(check())
    classifier.machine.weights.neg_()
    environment.first_state[:, 2] = classifier(environment.percepts)
    seen.append(check())
    environment.most_novel = 2.0
    seen.append(check())
    environment.percepts = environment.percepts + 0.05
    seen.append(check())
    changed = [not equal(a, b) for a, b in itertools.pairwise(seen[1:])]
    assert all(changed), changed


def test_parts_that_are_done_again_change_nothing() -> None:
    environment = random_models(7, 20)
    actions = sets_for(environment.percept_size)[0]
    engine, graphs = engine_of(actions, environment), graphs_of(3, actions, 60)
    assert engine is not None

    def evaluation(again: list[int]) -> tuple[Tensor, Tensor, Tensor, int, int]:
        scenarios, more = torch.arange(20), torch.tensor(again)
        found = engine.evaluation(graphs, scenarios, 4, 20, 400, again=more)
        assert found is not None
        return found

    once, again = evaluation([0, 0, 0, 0]), evaluation([3, 1, 2, 4])
    assert all(torch.equal(a, b) for a, b in zip(once[:3], again[:3], strict=True))
    assert once[3:] == again[3:]
    assert once[3] > 2000


def test_a_long_sub_skill_is_no_endless_loop() -> None:
    """Its nodes are more than a word has bits, and no two of them are taken for one."""
    actions, environment = paper_actions(), models_as(random_models(0, 3), torch.float32)
    nodes = [*["Detect"] * 69, "Grasp"]
    long = chain(actions, *nodes, edges={(69, "failure"): 69})
    outer = actions.extended(["long"], [SubSkill(Skill("long", long, actions, 140))])
    given = chain(outer, "long"), outer, environment, torch.arange(3), 1, 1000
    found, wanted = compiled(*given), run_in_torch(*given)
    assert torch.equal(found.transitions, wanted.transitions)
    assert torch.equal(found.succeeded, wanted.succeeded)
    assert found.executed >= 3 * 70
