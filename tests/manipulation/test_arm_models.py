"""What is learned of an arm's task: Γ of segments, grades, and a training with few steps."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from arms import fetch, meta_world, starts
from support import seeded
from torch import Tensor

from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import DomainError
from cgtorch.improvement.played import Steps
from cgtorch.manipulation.domain import SparingMetaWorld
from cgtorch.manipulation.models import ArmModels, LearnedGrade, SegmentProcess, grades_after
from cgtorch.manipulation.settings import ManipulationSettings
from cgtorch.manipulation.simulator import CLOSE, STEPS
from cgtorch.manipulation.world import GRADED
from cgtorch.runs.log import read_log
from cgtorch.training.run import train

SPARING = meta_world("reach-v3").sparing()
ARM = SPARING.arm
HAND, THING, GOAL = (ARM.columns(place) for place in ("hand", "object", "goal"))
TIME = ARM.names.index("time")


def percepts(n: int, seed: int) -> Tensor:
    """Places at random, in units of percepts."""
    rows = torch.zeros(n, len(ARM.names))
    for where in (HAND, THING, GOAL):
        rows[:, where] = 0.5 * torch.randn(n, 3, generator=seeded(seed + where.start))
    return rows


def controls(target: Tensor) -> Tensor:
    """Segments to targets (n, 3), in units of percepts."""
    place = ARM.unit * target + torch.tensor(ARM.centre)
    return torch.cat([place, torch.tensor([[-1.0, 45, 1, 0.01]]).expand(len(place), 4)], 1)


def pushed(before: Tensor, target: Tensor) -> Tensor:
    """The hand stops above the floor z = 0, and pushes a thing the more the nearer it comes."""
    after = before.clone()
    after[:, HAND] = target
    after[:, HAND.stop - 1] = target[:, 2].clamp_min(0)
    far = (target - before[:, THING]).square().sum(1, keepdim=True)
    after[:, THING] += 0.3 * (-far).exp()
    after[:, TIME] = before[:, TIME] + 0.1
    return after


def segments(n: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    before = percepts(n, seed)
    target = before[:, THING] + 0.5 * torch.randn(n, 3, generator=seeded(seed + 99))
    return before, controls(target), pushed(before, target)


def test_gamma_knows_where_a_segment_ends_before_it_learns_how_it_is_hindered() -> None:
    known = segments(150, 0)
    gamma = SegmentProcess(ARM, *known, None)
    before, control, after = segments(200, 1)
    found, unsure = gamma.predict(before, control)
    assert found.dtype == unsure.dtype == torch.float64
    error = (found - after).abs()
    usual = (gamma.expected(before.double(), control.double()) - after).abs()
    freely = slice(HAND.start, HAND.stop - 1)
    assert error[:, freely].median() < 1e-6
    assert error[:, HAND].mean() < 0.5 * usual[:, HAND].mean()
    assert error[:, TIME].mean() < 1e-3
    assert error[:, THING].mean() < 0.4 * usual[:, THING].mean()
    assert error[:, GOAL].max() < 1e-9
    # A target out of reach is not expected to be reached, but the farthest place where it has been.
    away = gamma.expected(before.double(), controls(before[:, HAND] + 50).double())
    farthest = torch.cat([known[0], known[2]])[:, HAND].amax(0).double()
    assert bool((away[:, HAND] == farthest).all())


def test_gamma_does_not_depend_on_where_the_goal_is() -> None:
    gamma = SegmentProcess(ARM, *segments(60, 0), None)
    before, control, _ = segments(5, 1)
    moved = before.clone()
    moved[:, GOAL] += 1
    (one, sure), (other, as_sure) = gamma.predict(before, control), gamma.predict(moved, control)
    assert torch.equal(sure, as_sure)
    torch.testing.assert_close(one[:, HAND], other[:, HAND])
    torch.testing.assert_close(other[:, GOAL] - one[:, GOAL], torch.ones(5, 3).double())


def reached(n: int, seed: int) -> Steps:
    """One step each, which gives the more the nearer the hand comes to the goal."""
    before, control, after = segments(n, seed)
    way = (after[:, HAND] - after[:, GOAL]).norm(dim=1)
    near = torch.rand(n, generator=seeded(seed)) < 0.3
    after[near, HAND.start : HAND.stop] = after[near, GOAL.start : GOAL.stop] + 0.02
    way = (after[:, HAND] - after[:, GOAL]).norm(dim=1)
    grade = torch.where(way < 0.1, 1.0, GRADED * (-way).exp()).double()
    return Steps(before, control, after, grade, way < 0.1)


def test_grades_and_success_are_learned_from_what_steps_gave() -> None:
    steps, others = reached(120, 0), reached(200, 7)
    learned = LearnedGrade(ARM, steps)
    grade, solved = learned.grade(others.after)
    assert (solved == others.ended).float().mean() > 0.97
    assert bool((grade[solved] == 1).all())
    unsolved = ~solved & ~others.ended
    assert (grade - others.reward)[unsolved].abs().mean() < 0.04
    assert grade[~solved].max() <= GRADED
    # A later fit begins with the parameters of this one.
    again = LearnedGrade(ARM, steps, learned.free)
    torch.testing.assert_close(again.grade(others.after)[0], grade, atol=0.05, rtol=0)


def test_a_step_gives_what_the_grade_changes_by_and_a_first_one_all_of_it() -> None:
    learned = LearnedGrade(ARM, reached(60, 0))
    before, control, after = segments(40, 3)
    after[:, TIME] = 0.5
    after[:5, TIME] = 1.0
    before[:20, TIME] = 0.25
    gain, ended = learned(before, control, after)
    now, solved = learned.grade(after)
    then = learned.grade(before)[0].clamp_max(GRADED)
    torch.testing.assert_close(gain[:20].double(), (now - then)[:20], atol=1e-6, rtol=0)
    torch.testing.assert_close(gain[20:].double(), now[20:], atol=1e-6, rtol=0)
    assert bool(ended[:5].all())
    assert torch.equal(ended[5:], solved[5:])


def test_without_a_success_none_is_imagined_and_with_nothing_else_all_is() -> None:
    steps = reached(60, 0)
    failed, good = steps.rows(~steps.ended), steps.rows(steps.ended)
    assert not bool(LearnedGrade(ARM, failed).grade(good.after)[1].any())
    assert bool(LearnedGrade(ARM, good).grade(good.after)[1].all())


def test_grades_add_up_within_an_episode() -> None:
    steps = reached(5, 0)
    steps.percept[:, TIME] = torch.tensor([0.0, 0.2, 0.4, 0.0, 0.3])
    steps = replace(steps, reward=torch.tensor([0.1, 0.2, -0.05, 0.3, 0.7]).double())
    assert grades_after(ARM, steps).tolist() == pytest.approx([0.1, 0.3, 0.25, 0.3, 1.0])


def test_random_segments_lead_to_somewhere_around_a_place() -> None:
    here = percepts(1, 0)
    models = ArmModels(SPARING)
    drawn = torch.cat([models.random_control(here, seeded(i)) for i in range(200)])
    places = torch.stack([ARM.position(here, place)[0] for place in ("hand", *ARM.places)])
    way = torch.cdist(drawn[:, :3], places)
    assert 0.05 < way.amin(1).mean() < 0.16
    assert way.argmin(1).bincount(minlength=len(places)).min() > 20
    assert sorted(drawn[:, 3].unique().tolist()) == [-1, 1]
    assert torch.equal(models.random_control(here, seeded(3)), drawn[3:4])


def test_a_world_for_few_steps_returns_how_close_it_is() -> None:
    world = SPARING.world(starts(SPARING, 1, 2))
    lanes = start_lanes(world, torch.arange(2), 0, 1)
    assert world.returns(lanes).tolist() == [0, 0]
    goal = ARM.position(lanes.percept, "goal")
    far = goal + torch.tensor([[0.0, 0, 0], [0.15, 0, 0]])
    more = torch.tensor([[-1.0, 60, 1, 0.01]]).expand(2, 4)
    lanes, _ = world.step(lanes, torch.cat([far, more], 1))
    near, away = world.returns(lanes).tolist()
    assert near == 1
    assert 0 < away < GRADED
    assert away == pytest.approx(GRADED * float(lanes.state[1, CLOSE]))
    state = lanes.state.clone()
    state[:, STEPS] = 0  # as at a start, whatever is told there
    assert world.returns(replace(lanes, state=state))[1] == 0


def test_gamma_is_learned_of_a_single_task() -> None:
    assert isinstance(SPARING, SparingMetaWorld)
    assert (dict(SPARING.stages), SPARING.kinds) == ({"01-reach-v3": "reach-v3"}, ("reach-v3",))
    models = ArmModels(SPARING)
    assert (models.domain, models.most_steps, models.graded) == (SPARING, 200, True)
    assert (models.looks, len(models.changes)) == (100, 6)
    with pytest.raises(DomainError, match="'metaworld:MT10' has 10 tasks, and Γ is learned of a"):
        SparingMetaWorld(ManipulationSettings(environment="MT10"))
    with pytest.raises(DomainError, match="not learned of gymnasium-robotics:FetchPush-v4, where"):
        fetch().sparing()


def test_a_skill_is_learned_with_few_low_level_steps(tmp_path: Path) -> None:
    about = {"stage": "01-reach-v3", "models": "learned", "quiet": True}
    run = train("metaworld:reach-v3", tmp_path / "run", **about)
    (result,) = run.results
    asked = result["asked"].values()
    assert sum(each["steps"] for each in asked) < 5500  # without Γ it is 11,126
    assert result["fresh"]["succeeded"] >= 38
    log = [row for row in read_log(tmp_path / "run") if row["event"] in ("asked", "practised")]
    assert log[-1]["in_a_row"] == 75
    told = sum(row["steps"] for row in log if row["event"] == "asked")
    assert told == sum(each["steps"] for each in asked)
