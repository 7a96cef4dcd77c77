"""The coreset of W: what stays covers what goes, and what goes is not forgotten."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from support import seeded
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.improvement.events import GenerationDone, SkillAccepted
from cgtorch.improvement.grouping import cover
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Setup, Stage
from cgtorch.improvement.team import StageState, compose_team
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios


@given(st.integers(0, 2**31), st.integers(0, 60), st.integers(1, 70))
def test_every_scenario_has_a_kept_one_within_the_distance(
    seed: int, count: int, size: int
) -> None:
    percepts = torch.randn(count, 3, generator=seeded(seed))
    rows, distance = cover(percepts, size)
    assert rows.tolist() == sorted(set(rows.tolist()))
    assert len(rows) == min(count, size)
    if count:
        nearest = (percepts[:, None] - percepts[rows]).norm(dim=2).amin(1)
        assert float(nearest.max()) <= distance + 1e-5
        assert distance == pytest.approx(float(nearest.max()), abs=1e-5)


def test_the_same_percept_is_kept_once() -> None:
    rows, distance = cover(torch.eye(3).repeat(4, 1), 10)
    assert rows.tolist() == [0, 1, 2]
    assert distance == 0


def test_it_is_at_most_twice_as_far_as_with_the_best_choice() -> None:
    """Four heaps: four are enough to be near everything."""
    centres = torch.tensor([[0.0, 0], [9, 0], [0, 9], [9, 9]])
    heaps = centres.repeat_interleave(25, 0) + 0.2 * torch.rand(100, 2, generator=seeded(0))
    rows, distance = cover(heaps, 4)
    assert sorted((rows // 25).tolist()) == [0, 1, 2, 3]
    assert distance < 0.3


def test_acceptance_is_checked_on_all_of_w(setup: Setup, nothing_yet: Progress) -> None:
    """Eq. 1a holds for scenarios that no member was tried on; those once lost are not lost again.

    With a member that solves the coreset and what is missed, but not all of W, the branches would
    send everything to it.
    """
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    world = setup.world_of(scenarios)
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    first, second = (try_skill(m, world).succeeded for m in (earlier, far))
    both, only_first, only_second = first & second, first & ~second, second & ~first
    assert both.any()
    assert only_first.any()
    order = torch.cat([both.nonzero()[:, 0], only_first.nonzero()[:, 0]])
    missed = scenarios[only_second.nonzero()[:, 0]]
    progress = replace(
        nothing_yet, skill=earlier, members=(far,), solved=scenarios[order], missed=missed
    )
    told: list[object] = []
    small = replace(setup, core=2, attempts=1, rounds=1)
    after = improve(
        Stage(small, "S1", seeded(1), told.append),
        progress,
        missed,
        torch.ones(len(missed), dtype=torch.bool),
        lambda generator: random_scenarios("near", 0, generator),
    )
    assert after.skill is not None
    assert after.skill is not earlier
    assert try_skill(after.skill, small.world_of(progress.solved)).succeeded.all()
    assert len(after.solved) + len(after.missed) == len(order) + len(missed)
    (accepted,) = (e for e in told if isinstance(e, SkillAccepted))
    assert len(accepted.scenarios) == len(order) + len(missed)
    assert int(accepted.keep.sum()) == len(order)
    again = try_skill(accepted.skill, small.world_of(accepted.scenarios)).succeeded
    assert torch.equal(again, accepted.succeeded)
    assert again[accepted.keep].all()


def two_members(setup: Setup, nothing_yet: Progress) -> Progress:
    """A skill with what it solves as W, what it misses as M, and a member who solves all of M."""
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    world = setup.world_of(scenarios)
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    first, second = (try_skill(m, world).succeeded for m in (earlier, far))
    solved, missed = (scenarios[rows.nonzero()[:, 0]] for rows in (first, second & ~first))
    return replace(nothing_yet, skill=earlier, members=(far,), solved=solved, missed=missed)


def test_no_scenario_is_dropped_where_a_further_try_fails(
    setup: Setup, nothing_yet: Progress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a failed try had lost of the rest of W is still W under the skill accepted before."""
    progress = two_members(setup, nothing_yet)
    solved, missed = progress.solved, progress.missed
    accepted: list[SkillAccepted] = []
    losing: list[Skill] = []

    def watch(event: object) -> None:
        if isinstance(event, SkillAccepted):
            accepted.append(event)

    def forgetful(
        stage: Stage, state: StageState, progress: Progress
    ) -> tuple[Skill, Tensor] | None:
        """A team that loses something, and then none, once a skill was accepted."""
        if not accepted:
            return compose_team(stage, state, progress)
        losing.append(nearly(1.5))
        return (losing[0], state.keep) if len(losing) == 1 else None

    def draw(generator: Generator) -> Scenarios:
        return random_scenarios("perimeter", 20, generator)

    monkeypatch.setattr("cgtorch.improvement.improve.compose_team", forgetful)
    few = replace(setup, core=2, attempts=0, rounds=2)
    everything = torch.ones(len(missed), dtype=torch.bool)
    after = improve(Stage(few, "S1", seeded(0), watch), progress, missed, everything, draw)
    assert len(accepted) == 1
    assert len(losing) == 2
    assert len(after.solved) + len(after.missed) == len(solved) + len(missed) + 20
    assert after.skill is accepted[0].skill
    assert try_skill(after.skill, setup.world_of(after.solved)).succeeded.all()


def test_where_no_team_can_be_composed_one_more_is_recruited(
    setup: Setup, nothing_yet: Progress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though members solve all that is missed, so that nobody seemed to be needed."""
    progress = two_members(setup, nothing_yet)
    missed = progress.missed
    teams: list[StageState] = []
    evolved: set[str] = set()

    def failing_once(
        stage: Stage, state: StageState, progress: Progress
    ) -> tuple[Skill, Tensor] | None:
        teams.append(state)
        return compose_team(stage, state, progress) if len(teams) > 1 else None

    def watch(event: object) -> None:
        if isinstance(event, GenerationDone):
            evolved.add(event.candidate)

    monkeypatch.setattr("cgtorch.improvement.improve.compose_team", failing_once)
    everything = torch.ones(len(missed), dtype=torch.bool)
    once = replace(
        setup, trials=1, attempts=1, rounds=1, budget=replace(setup.budget, generations=3)
    )
    stage = Stage(once, "S1", seeded(0), watch)
    after = improve(stage, progress, missed, everything, lambda _: missed[:0])
    assert len(teams) == 2
    assert evolved == {"S1.1"}
    assert after.skill is not None
    assert after.skill.name == "S1"
    nobody = Stage(replace(once, attempts=0), "S1", seeded(0), watch)
    teams.clear()
    same = improve(nobody, progress, missed, everything, lambda _: missed[:0])
    assert len(teams) == 1
    assert same.skill is progress.skill


def test_with_nothing_missed_all_stays(setup: Setup, nothing_yet: Progress) -> None:
    progress = two_members(setup, nothing_yet)
    nothing = progress.missed[:0]
    progress = replace(progress, members=(), missed=nothing)
    none = torch.zeros(0, dtype=torch.bool)
    stage = Stage(setup, "S1", seeded(0), lambda event: None)
    after = improve(stage, progress, nothing, none, lambda _: nothing)
    assert after.skill is progress.skill
    assert len(after.solved) == len(progress.solved)
