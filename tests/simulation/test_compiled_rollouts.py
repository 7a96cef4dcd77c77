"""Compiled rollouts against the batched engine, which the plain interpreter checks."""

import copy
import itertools

import pytest
import reference
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_models
from support import (
    as_double,
    as_double_actions,
    custom_actions,
    nested_actions,
    random_graphs,
    seeded,
)

from cgtorch.actions import ActionSet, edge_actions, paper_actions
from cgtorch.native import available
from cgtorch.simulation import ModelEnvironment, Rollouts, rollout
from cgtorch.simulation.compiled import compiled_rollout
from cgtorch.simulation.program import (
    Program,
    _laid_out,
    _laid_out_in_torch,
    compile_graphs,
)
from cgtorch.simulation.rollout import rollout_in_torch
from cgtorch.world import ClearWay

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

SCENES = [("box", 0), ("box", 1), ("yaw", 0), ("yaw", 1), ("yaw", 3)]


def sets_for(size: int) -> list[ActionSet]:
    paper, edge = paper_actions(size), edge_actions(size)
    both = ActionSet(
        (*paper.names, "EdgeNN", "EdgeBranchingNN"), (*paper.actions, *edge.actions[3:])
    )
    inner = nested_actions(3, both)
    return [as_double_actions(s) for s in (paper, edge, both, inner)]


def program_of(seed: int, actions: ActionSet, count: int = 12) -> Program:
    return compile_graphs(as_double(random_graphs(seed, count, actions)), actions)


def assert_same(found: Rollouts | None, wanted: Rollouts) -> None:
    assert found is not None
    for name in ("succeeded", "timed_out", "transitions"):
        assert torch.equal(getattr(found, name), getattr(wanted, name)), name
    for name in ("percept", "state"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), atol=1e-9, rtol=0)


def equal(first: Rollouts, second: Rollouts) -> bool:
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


@given(
    seed=st.integers(0, 2**31),
    scene=st.sampled_from(SCENES),
    which=st.integers(0, 3),
    limit=st.integers(1, 20),
    steps=st.integers(1, 60),
    errors=st.booleans(),
)
@settings(max_examples=80, deadline=None)
def test_compiled_rollouts_are_those_of_the_engine(
    seed: int, scene: tuple[str, int], which: int, limit: int, steps: int, errors: bool
) -> None:
    environment = random_models(seed, 6, *scene, errors=errors)
    program = program_of(seed, sets_for(environment.percept_size)[which])
    some = torch.tensor([4, 0, 5])
    found = compiled_rollout(program, environment, some, limit, steps)
    assert_same(found, rollout_in_torch(program, environment, some, limit, steps))


@pytest.mark.parametrize("scene", SCENES)
def test_the_comparison_meets_every_end(scene: tuple[str, int]) -> None:
    environment = random_models(5, 10, *scene)
    found = [
        compiled_rollout(program_of(1, actions, 60), environment, torch.arange(10), 20, 400)
        for actions in sets_for(environment.percept_size)
    ]
    assert all(each is not None for each in found)
    ends = [(r.succeeded.sum(), r.timed_out.sum(), (r.state[..., 0] > 1).sum()) for r in found if r]
    success, timeout, moved = torch.tensor(ends).sum(0).tolist()
    lost = sum(int((r.state[..., 1] > 0).sum()) for r in found if r)
    assert min(success, timeout, moved, lost) >= 20, (success, timeout, moved, lost)


@given(seed=st.integers(0, 2**31), limit=st.integers(1, 20), steps=st.integers(1, 40))
@settings(max_examples=15, deadline=None)
def test_compiled_rollouts_are_those_of_the_plain_interpreter(
    seed: int, limit: int, steps: int
) -> None:
    environment = random_models(seed, 4)
    actions = as_double_actions(nested_actions(seed % 5, paper_actions()))
    graphs = as_double(random_graphs(seed, 5, actions))
    program = compile_graphs(graphs, actions)
    found = compiled_rollout(program, environment, torch.arange(4), limit, steps)
    assert found is not None
    for i in range(len(graphs)):
        for j in range(4):
            end, robot = reference.run(graphs[i : i + 1], actions, environment, j, limit, steps)
            assert (end == "success") == bool(found.succeeded[i, j])
            assert (end == "timeout") == bool(found.timed_out[i, j])
            assert robot.steps == int(found.transitions[i, j])
            assert found.percept[i, j].tolist() == pytest.approx(robot.percept.tolist(), abs=1e-9)


def test_rollout_asks_compiled_code_first() -> None:
    environment, actions = random_models(0, 4), sets_for(7)[0]
    graphs = as_double(random_graphs(0, 5, actions))
    program = compile_graphs(graphs, actions)
    found, wanted = (
        rollout(graphs, actions, environment),
        compiled_rollout(program, environment, torch.arange(4), 20, 400),
    )
    assert wanted is not None
    assert equal(found, wanted)


def test_what_cannot_be_counted_runs_in_torch() -> None:
    environment, program = random_models(0, 4), program_of(0, sets_for(7)[0])
    everything = torch.arange(4)
    assert compiled_rollout(program, environment, everything, 2**30, 400) is not None
    assert compiled_rollout(program, environment, everything, 2**30 + 1, 400) is None
    assert compiled_rollout(program, environment, everything, 20, 2**31) is None


@given(seed=st.integers(0, 2**31), which=st.integers(0, 3), count=st.integers(0, 12))
@settings(max_examples=30, deadline=None)
def test_graphs_are_laid_out_as_in_torch(seed: int, which: int, count: int) -> None:
    actions = sets_for(7)[which]
    graphs = random_graphs(seed, 12, actions)[:count]
    kinds = torch.randperm(len(actions), generator=seeded(seed))
    ends = torch.randint(-2, 0, (len(actions), graphs.edges.shape[2]), generator=seeded(seed))
    for more in (0, 2):
        given = graphs, kinds, ends, 1000, graphs.edges.shape[2] + more
        found, wanted = _laid_out(*given), _laid_out_in_torch(*given)
        assert found is not None
        assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))


def test_what_others_plug_in_runs_in_torch() -> None:
    environment, everything = random_models(0, 4), torch.arange(4)

    def runs_compiled(environment: ModelEnvironment, actions: ActionSet) -> bool:
        found = compiled_rollout(program_of(0, actions), environment, everything, 20, 400)
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
    program, before = program_of(2, actions, 50), torch.get_num_threads()
    try:
        results = []
        for count in (1, 2, 5):
            torch.set_num_threads(count)
            results.append(compiled_rollout(program, environment, torch.arange(9), 20, 400))
    finally:
        torch.set_num_threads(before)
    first = results[0]
    assert first is not None
    for other in results[1:]:
        assert other is not None
        assert equal(first, other)


def as_single(environment: ModelEnvironment) -> ModelEnvironment:
    """The same models in float32."""
    gamma, classifier = environment.gamma.__self__.float(), environment.classifier.float()
    possible = ClearWay(environment.possible.footprint.float())
    return ModelEnvironment(
        environment.percepts.float(),
        gamma.predict_with_novelty,
        classifier,
        possible,
        errors=None if environment.errors is None else environment.errors.float(),
        most_novel=environment.most_novel,
    )


@given(
    seed=st.integers(0, 2**31),
    scene=st.sampled_from(SCENES),
    which=st.integers(0, 3),
    single=st.booleans(),
    count=st.integers(1, 37),
)
@settings(max_examples=60, deadline=None)
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
        environment, graphs = as_single(environment), random_graphs(seed, 9, actions)
    some = torch.randperm(37, generator=generator)[:count]
    rows = torch.randperm(9, generator=generator)[:4]
    whole, part = (
        compiled_rollout(compile_graphs(g, actions), environment, scenarios, 20, 400)
        for g, scenarios in ((graphs, torch.arange(37)), (graphs[rows], some))
    )
    assert whole is not None
    assert part is not None
    for name, value in vars(whole).items():
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
        program = program_of(7, actions, 40)
        program.parameters[::7] = torch.nan
        found = compiled_rollout(program, environment, torch.arange(6), 20, 400)
        wanted = rollout_in_torch(program, environment, torch.arange(6), 20, 400)
        assert found is not None
        finite = wanted.percept.isfinite().all(-1) & wanted.state.isfinite().all(-1)
        assert torch.equal(
            finite, found.percept.isfinite().all(-1) & found.state.isfinite().all(-1)
        )
        for name in ("succeeded", "timed_out", "transitions"):
            assert torch.equal(getattr(found, name)[finite], getattr(wanted, name)[finite]), name


def test_models_that_change_between_two_rollouts_are_looked_at_again() -> None:
    """What compiled code knows of models is remembered, but not beyond any change of them."""
    environment, some = random_models(3, 10, errors=True), torch.arange(10)
    program = program_of(2, sets_for(7)[2], 60)

    def check() -> Rollouts:
        found = compiled_rollout(program, environment, some, 20, 400)
        assert_same(found, rollout_in_torch(program, environment, some, 20, 400))
        assert found is not None
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
