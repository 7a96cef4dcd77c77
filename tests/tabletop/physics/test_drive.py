"""The base comes to where it is sent within its limits, and stops at what is in its way."""

import math

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.drive import (
    GATHER,
    SPEED,
    STEPS,
    TURN_GATHER,
    TURN_SPEED,
    drive,
    motion_to,
    ramp,
)
from cgtorch.tabletop.physics.model import TIMESTEP
from cgtorch.tabletop.physics.scene import Scene

TABLE = [0.0, 0, 0, 0.8, 1.2, 0.74]


def scene(pose: list[float], thing: list[float] | None = None) -> Scene:
    thing = thing or [-0.3, 0.0, 0.79, 1, 0, 0, 0]
    return Scene.of(numpy.array([*pose, *TABLE, *thing]))


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
    pose = numpy.array([r for r, _ in rows])
    speed = numpy.array([s for _, s in rows])
    assert numpy.allclose(pose[-1, :2], goal[:2])
    assert math.cos(pose[-1, 2] - goal[2]) == pytest.approx(1)
    assert numpy.abs(pose[:, 2] - start[2]).max() <= math.pi + 1e-9
    driving, turning = numpy.hypot(*speed[:, :2].T) > 1e-9, numpy.abs(speed[:, 2]) > 1e-9
    assert not (driving & turning).any()
    assert numpy.hypot(*speed[:, :2].T).max() <= SPEED + 1e-9
    assert numpy.abs(speed[:, 2]).max() <= TURN_SPEED + 1e-9
    assert GATHER > 0
    assert TURN_GATHER > 0


@pytest.mark.parametrize(
    "goal", [[-1.6, 0.5, 1.0], [-2.4, -1.2, -2.5], [-1.0, 0.3, 0.0], [-1.5, 0.0, math.pi]]
)
def test_the_base_comes_to_within_millimetres(physics: Physics, goal: list[float]) -> None:
    at = [-1.5, 0.0, 0.0]
    fastest = 0.0

    def watch(data: object) -> None:
        nonlocal fastest
        fastest = max(fastest, float(numpy.hypot(*data.qvel[:2])))  # type: ignore[attr-defined]

    found = drive(physics.model(None, 0), scene(at), numpy.array(goal), watch)
    assert found[10] == 1
    assert numpy.hypot(*(found[:2] - goal[:2])) < 0.002
    assert abs(math.remainder(found[2] - goal[2], math.tau)) < 0.005
    assert fastest < 1.05 * SPEED
    assert numpy.allclose(found[3:6], [-0.3, 0.0, 0.79], atol=1e-3), "the object stands still"


def test_the_base_stops_at_the_table(physics: Physics) -> None:
    found = drive(physics.model(None, 0), scene([-1.5, 0, 0]), numpy.array([-0.2, 0.0, 0.0]))
    assert found[10] == 0
    assert found[0] < -0.4 - 0.334 + 0.02


def test_the_base_pushes_what_lies_on_the_floor(physics: Physics) -> None:
    lying = [-1.0, 0.0, 0.05, 1, 0, 0, 0]
    goal = numpy.array([-0.9, 0.0, 0.0])
    found = drive(physics.model(None, 0), scene([-1.5, 0, 0], lying), goal)
    assert found[10] == 0
    assert found[3] > -1.0
