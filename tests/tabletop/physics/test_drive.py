"""The base comes to where it is sent within its limits, and stops at what is in its way."""

import math

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.drive import (
    REST,
    SPEED,
    STEPS,
    TURN_SPEED,
    drive,
    goal_near,
    motion_to,
    ramp,
)
from cgtorch.tabletop.physics.model import TIMESTEP, Model
from cgtorch.tabletop.physics.scene import Scene, in_contact

STANDING, LYING = [-0.3, 0.0, 0.79, 1, 0, 0, 0], [-1.0, 0.0, 0.05, 1, 0, 0, 0]


def scene(thing: list[float]) -> Scene:
    return Scene.of(numpy.array([-1.5, 0.0, 0.0, 0.0, 0, 0, 0.8, 1.2, 0.74, *thing]))


@given(st.floats(1e-4, 10), st.floats(0.1, 3), st.floats(0.1, 5))
def test_a_ramp_goes_all_the_way_within_its_limits(
    length: float, fast: float, gather: float
) -> None:
    tick = 0.02
    rows = numpy.array([(0.0, 0.0), *ramp(length, fast, gather, tick)])
    assert rows[-1] == pytest.approx([length, 0.0], abs=1e-9)
    assert rows[:, 1].max() <= fast + 1e-9
    assert numpy.abs(numpy.diff(rows[:, 1])).max() <= gather * tick + 1e-9
    assert (numpy.diff(rows[:, 0]) >= -1e-12).all()


@settings(max_examples=20)
@given(st.tuples(*[st.floats(-3, 3)] * 3), st.tuples(*[st.floats(-3, 3)] * 3))
def test_a_motion_is_straight_and_then_a_turn_the_short_way(
    start: tuple[float, ...], goal: tuple[float, ...]
) -> None:
    rows = motion_to(numpy.array(start), numpy.array(goal), STEPS * TIMESTEP)
    if not rows:
        return
    pose, speed = (numpy.array(column) for column in zip(*rows, strict=True))
    assert numpy.allclose(pose[-1, :2], goal[:2])
    assert math.cos(pose[-1, 2] - goal[2]) == pytest.approx(1)
    assert numpy.abs(pose[:, 2] - start[2]).max() <= math.pi + 1e-9
    driving, turning = numpy.hypot(*speed[:, :2].T), numpy.abs(speed[:, 2])
    assert not ((driving > 1e-9) & (turning > 1e-9)).any()
    assert driving.max() <= SPEED + 1e-9
    assert turning.max() <= TURN_SPEED + 1e-9


@pytest.mark.parametrize(
    "goal", [[-1.6, 0.5, 1.0], [-2.4, -1.2, -2.5], [-1.0, 0.3, 0.0], [-1.5, 0.0, math.pi]]
)
def test_the_base_comes_to_within_millimetres(physics: Physics, goal: list[float]) -> None:
    speeds: list[float] = []

    def watch(model: Model) -> None:
        speeds.append(float(numpy.hypot(*model.data.qvel[:2])))

    found = drive(physics.model(None, 0), scene(STANDING), numpy.array(goal), watch)
    assert found[10] == 1
    assert numpy.hypot(*(found[:2] - goal[:2])) < 0.002
    assert abs(math.remainder(found[2] - goal[2], math.tau)) < 0.005
    assert max(speeds) < 1.05 * SPEED
    assert numpy.allclose(found[3:6], STANDING[:3], atol=1e-3), "the object stands still"


def test_the_base_stops_at_what_it_touches(physics: Physics) -> None:
    """It stops at the table, and pushes what lies on the floor."""
    seen = list[tuple[bool, bool]]()

    def watch(model: Model) -> None:
        seen.append((in_contact(model, model.bumping), bool(model.data.ctrl[:3].any())))

    at_table = drive(physics.model(None, 0), scene(STANDING), numpy.array([-0.2, 0.0, 0.0]), watch)
    first = seen.index((True, True))
    assert first > 10
    assert all(commanded for _, commanded in seen[:first])
    after = seen[first + 1 :]
    assert len(after) == round(REST / (STEPS * TIMESTEP))
    assert not any(commanded for _, commanded in after)
    assert at_table[10] == 0
    assert at_table[0] < -0.4 - 0.334 + 0.02
    pushed = drive(physics.model(None, 0), scene(LYING), numpy.array([-0.9, 0.0, 0.0]))
    assert pushed[10] == 0
    assert pushed[3] > -1.0


@pytest.mark.parametrize(
    ("length", "seconds", "peak"), [(0.25, 1.0, 0.5), (1.0, 2.0, 1.0), (3.0, 4.0, 1.0)]
)
def test_a_ramp_gathers_speed_and_loses_it_evenly(
    length: float, seconds: float, peak: float
) -> None:
    rows = ramp(length, 1.0, 1.0, 0.125)
    assert len(rows) == seconds / 0.125
    assert max(speed for _, speed in rows) == pytest.approx(peak)
    for k in range(1, len(rows)):
        t, (done, speed) = k * 0.125, rows[k - 1]
        assert speed == pytest.approx(min(t, seconds - t, peak))
        assert done + rows[len(rows) - k - 1][0] == pytest.approx(length)  # forth as back
    assert rows[0][0] == pytest.approx(0.125**2 / 2)
    assert rows[-1] == pytest.approx((length, 0.0))


@pytest.mark.parametrize(
    ("heading", "wanted", "found"),
    [(0.5, 1.0, 1.0), (3.0, -3.0, math.tau - 3.0), (-3.0, 3.0, 3.0 - math.tau), (7.0, 0.5, 6.783)],
)
def test_a_goal_is_turned_to_the_shorter_way(heading: float, wanted: float, found: float) -> None:
    goal = goal_near(heading, numpy.array([1.0, 2.0, wanted]))
    assert goal.tolist() == pytest.approx([1, 2, found], abs=1e-3)


def test_no_motion_has_no_poses_and_a_turn_has_the_speed_of_a_turn() -> None:
    here = numpy.array([1.0, 2.0, 0.5])
    assert motion_to(here, here, 0.02) == []
    rows = motion_to(here, here + numpy.array([0.0, 0.0, 2.5]), 0.02)
    speeds = numpy.array([speed for _, speed in rows])
    assert speeds[:, :2].tolist() == [[0.0, 0.0]] * len(rows)
    assert speeds[:, 2].max() == pytest.approx(TURN_SPEED)
    assert speeds[0, 2] == pytest.approx(2.0 * 0.02)  # rad/s after a tick
    (pose, speed), *_ = motion_to(here, here - numpy.array([3.0, 4.0, 0.0]), 0.02)
    assert speed.tolist() == pytest.approx([-0.6 * 0.02, -0.8 * 0.02, 0.0])
    way = 0.02**2 / 2
    assert pose.tolist() == pytest.approx([1 - 0.6 * way, 2 - 0.8 * way, 0.5])
