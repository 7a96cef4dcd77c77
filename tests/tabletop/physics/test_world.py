"""The world in physics: rows are independent, nothing is asked twice, and things go wrong."""

from dataclasses import replace

import pytest
import torch

from cgtorch import native
from cgtorch.ground.dry_run import check_environment
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.native.processes import listening
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics import MujocoWorld, Physics, model
from cgtorch.tabletop.physics import world as physics_world
from cgtorch.tabletop.physics.world import WORTH_SHARING
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.tabletop.world import Scenarios, TabletopWorld, draw_of, stage_scenarios

CONTROL = torch.tensor([[0.4, 0.05, 0.1], [0.2, -0.1, -0.3], [9.0, 0, 0], [0.45, 0.1, 0.0]])


def begun(physics: Physics, **how: str) -> tuple[MujocoWorld, Lanes]:
    world = MujocoWorld(stage_scenarios("near", 4), physics, **how)
    return world, start_lanes(world, torch.arange(4), 3, 0)


def same(a: Lanes, b: Lanes) -> bool:
    return torch.equal(a.state, b.state) and torch.equal(a.percept, b.percept)


def tried(robot: Robot, rows: list[int]) -> list[torch.Tensor]:
    """What happens to some of four lanes in a physics that knows nothing yet."""
    world, lanes = begun(Physics(robot))
    lanes, done = world.step(lanes.rows(torch.tensor(rows)), CONTROL[rows])
    after, good = world.success(lanes)
    return [lanes.state, lanes.percept, done, after.state, good]


def test_it_keeps_the_interface_and_begins_like_the_kinematic_world(physics: Physics) -> None:
    """The same percepts but for rounding, and the same noise."""
    world, lanes = begun(physics)
    check_environment(world)
    other = TabletopWorld(world.scenarios, lambda p, t: p[:, 0] > 0, (-0.3, 0.3, -0.3, 0.3))
    expected = start_lanes(other, torch.arange(4), 3, 0)
    assert torch.allclose(lanes.percept, expected.percept, atol=1e-6)
    assert torch.equal(lanes.state[:, :12], expected.state)


def test_the_object_stands_upright_on_the_table_at_first(physics: Physics) -> None:
    world, lanes = begun(physics)
    rows = world.scene(lanes.state)
    assert rows.shape == (4, 16)
    assert rows[:, -4:].tolist() == [[1.0, 0.0, 0.0, 0.0]] * 4
    tops = world.scenarios.table[:, 5]
    assert torch.allclose(rows[:, -5], tops + physics.thing.half_height)
    assert torch.equal(rows[:, 9:11], world.scenarios.object)
    assert torch.allclose(world.placed(lanes.state)[:, 2], tops)
    assert not lanes.state[:, -1].any(), "no arm has touched anything"


def test_rows_do_not_depend_on_one_another_nor_on_processes(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    together = tried(robot, [0, 1, 2, 3])
    for parts, whole in zip(tried(robot, [2, 0]), together, strict=True):
        assert torch.equal(parts, whole[[2, 0]])
    monkeypatch.setattr(physics_world, "WORTH_SHARING", 2)
    native.use_threads(2)
    shared = tried(robot, [0, 1, 2, 3])
    assert all(torch.equal(a, b) for a, b in zip(shared, together, strict=True))


def test_nothing_is_asked_twice_unless_noise_changes_the_question(
    physics: Physics, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, lanes = begun(physics)
    first, done = world.step(lanes, CONTROL)
    found = world.success(first)
    known = len(physics.memo)
    world.step(world.observe(lanes), CONTROL)
    assert len(physics.memo) > known

    def refuse(*given: object) -> torch.Tensor:
        raise AssertionError("asked again")

    monkeypatch.setattr(physics_world, "drive", refuse)
    monkeypatch.setattr(physics_world, "grasp", refuse)
    again, done_again = world.step(lanes, CONTROL)
    assert same(first, again)
    assert torch.equal(done, done_again)
    assert done.tolist()[2] is False, "too far"
    assert torch.equal(world.success(again)[1], found[1])


def test_how_many_questions_are_answered_is_told(robot: Robot) -> None:
    """Of those that are new, and of each kind."""
    told: list[tuple[str, int, int]] = []
    world = MujocoWorld(stage_scenarios("near", 8), Physics(robot))
    lanes = start_lanes(world, torch.arange(8), 3, 0)
    with listening(lambda *given: told.append(given)):
        for _ in range(2):
            world.step(lanes, torch.tensor([[0.2, 0.0, 0.0]]).expand(8, 3))
    assert told == [("motions in physics", done, 8) for done in (0, 2, 4, 6, 8)]


def test_models_that_processes_may_need_are_made_before_them(robot: Robot) -> None:
    """Of all arms, where there is enough to share."""
    for count, made in ((WORTH_SHARING - 1, {(None, 0)}), (WORTH_SHARING, {(None, 0), (0, 0)})):
        alone = replace(robot, arms=robot.arms[:1], home=robot.home[:1])
        physics = Physics(alone)
        world = MujocoWorld(stage_scenarios("near", count), physics)
        lanes = start_lanes(world, torch.arange(count), 3, 0)
        world.step(lanes, torch.tensor([[0.05, 0.0, 0.0]]).expand(count, 3))
        assert physics.models.keys() == made


def test_a_refused_motion_leaves_a_lane_as_it_is(physics: Physics) -> None:
    world, lanes = begun(physics)
    after, done = world.step(lanes, torch.full((4, 3), float("nan")))
    assert not done.any()
    assert same(after, lanes)


def test_an_object_that_was_pushed_is_seen_where_it_is(physics: Physics) -> None:
    world, lanes = begun(physics)
    state = lanes.state.clone()
    state[:, 9], state[:, 10], state[:, -6] = -0.9, 0.2, 0.05  # on the floor
    seen = world.observe(replace(lanes, state=state)).percept
    away = seen[:, 4:6] - (torch.tensor([-0.9, 0.2]) - state[:, :2])
    assert away.abs().max() < 0.05
    assert seen[:, 6].abs().max() < 0.05
    assert not world.success(replace(lanes, state=state))[1].any()


def test_a_touch_counts_as_it_is_said(physics: Physics, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answers are remembered once, and either world reads them its own way."""
    answers = torch.tensor([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])

    def told(given: Physics, rows: torch.Tensor) -> torch.Tensor:
        return torch.cat([answers[: len(rows)], rows[:, 9:16]], 1)

    monkeypatch.setattr(physics_world, "grasps", told)
    for touch, good in (("fails", [0, 1, 0, 0]), ("allowed", [1, 1, 0, 0])):
        world, lanes = begun(physics, touch=touch)
        after, found = world.success(lanes)
        assert found.tolist() == good
        assert after.state[:, -1].tolist() == [1, 0, 1, 0]
        assert torch.equal(after.percept, lanes.percept)
    with pytest.raises(SettingsError, match="use one of fails, allowed"):
        begun(physics, touch="maybe")


def test_obstacles_and_any_table(physics: Physics) -> None:
    drawn: Scenarios = draw_of("general-clutter")(6, torch.Generator().manual_seed(1))
    world = MujocoWorld(drawn, physics, percept="yaw")
    lanes = start_lanes(world, torch.arange(6), 3, 0)
    assert lanes.percept.shape == (6, 13)
    after, done = world.step(lanes, torch.tensor([[0.2, 0.0, 0.1]]).expand(6, 3))
    assert done.any()
    assert torch.equal(after.state[:, 12:17], lanes.state[:, 12:17])


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything begins, with the way to install it."""
    monkeypatch.setattr(model, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"pip install 'cgtorch\[physics\]'"):
        Tabletop(TabletopSettings(world="mujoco"))
    Tabletop(TabletopSettings())  # needs none


def test_worlds_and_measures_by_name() -> None:
    domain = Tabletop()
    assert not domain.other_measures()
    strict = domain.in_world("mujoco")
    assert strict.settings.world == "mujoco"
    ((name, lifted),) = strict.other_measures().items()
    assert "lifted" in name
    assert lifted.settings.touch == "allowed"
    assert lifted.physics is strict.physics is domain.physics, "they share what they know"
    with pytest.raises(SettingsError, match="use one of kinematic, mujoco"):
        domain.in_world("moon")
