"""Commands for a robot's driver: the planned way at equal times, and the gripper's part in it."""

from functools import cache
from itertools import pairwise
from typing import Any

import pytest
import torch

from cgtorch.ground.errors import DataError
from cgtorch.tabletop.arm_command import EVERY, arm_command
from cgtorch.tabletop.kinematics import Robot, arm_ways, load_robot
from cgtorch.tabletop.physics.grasp import CLOSING, TICK

PERCEPT = torch.tensor([0.4, 1.2, -0.6, 0.6, 0.5, 0.1, 0.74])
TABLE = torch.tensor([[0.8, 0.0, 0.0, 0.8, 1.2, 0.74]])


@cache
def robot() -> Robot:
    return load_robot()


@cache
def command() -> dict[str, Any]:
    found = arm_command(robot(), PERCEPT)
    assert found is not None
    return found


def test_a_command_names_the_arm_whose_way_it_has_and_its_fingers() -> None:
    ways = arm_ways(robot(), PERCEPT[None, 4:], TABLE)
    arm = robot().arms[int(ways.arm[0])]
    assert (command()["arm"], command()["joints"]) == (arm.name, list(arm.joint_names))
    side = arm.name[0]
    assert command()["gripper"]
    assert all(name.startswith(f"{side}_gripper") for name in command()["gripper"])
    fingers = [robot().urdf.joint(name) for name in command()["gripper"]]
    assert all(finger.mimic is None for finger in fingers)
    most = [50.0 if finger.type == "prismatic" else 5.0 for finger in fingers]
    limits = [each.limit.effort or 1e9 for each in fingers]
    assert command()["effort"] == [min(each) for each in zip(most, limits, strict=True)]


def test_rows_of_a_command_are_a_twentieth_of_a_second_apart_at_most() -> None:
    times = command()["times"]
    assert len(times) == len(command()["positions"]) == len(command()["openings"])
    assert times[0] == pytest.approx(EVERY * TICK) == pytest.approx(0.05)
    assert all(0 < b - a <= EVERY * TICK + 1e-9 for a, b in pairwise(times))
    usual = [b - a for a, b in pairwise(times) if b - a > EVERY * TICK - 1e-9]
    assert len(times) - 1 - len(usual) <= 6  # but where a part of the way ends
    speed = max(
        abs(y - x) / (t - s)
        for (s, a), (t, b) in pairwise(zip(times, command()["positions"], strict=True))
        for x, y in zip(a, b, strict=True)
    )
    assert 0.05 < speed < 4  # rad/s


def test_the_gripper_closes_where_the_arm_has_come_to_the_object_and_then_it_is_lifted() -> None:
    ways = arm_ways(robot(), PERCEPT[None, 4:], TABLE)
    count = len(command()["joints"])
    home, grasp, lifted = (
        ways.joints[0, int(at), :count].tolist() for at in (0, ways.grasp[0], ways.lifted[0])
    )
    positions, openings, times = (command()[name] for name in ("positions", "openings", "times"))
    opened, closed = openings[0], openings[-1]
    assert opened == [robot().description.held[name] for name in command()["gripper"]]
    assert opened != closed
    there = openings.index(closed)
    assert openings == [opened] * there + [closed] * (len(openings) - there)
    assert positions[0] == pytest.approx(home, abs=0.05)
    assert positions[there - 1] == pytest.approx(grasp, abs=1e-6)
    assert positions[-1] == pytest.approx(lifted, abs=1e-6)
    still = [row for row in range(there, len(times)) if positions[row] == positions[there - 1]]
    assert still == [*range(there, there + len(still))]
    assert times[still[-1]] - times[there - 1] == pytest.approx(CLOSING, abs=1e-9)


def test_the_side_of_a_turned_table_is_planned_for() -> None:
    """The percept of the same table with its side has the same command."""
    assert arm_command(robot(), torch.cat([PERCEPT, torch.tensor([0.8, 0.0])])) == command()


def test_there_is_no_command_where_there_is_no_way_or_no_percept() -> None:
    away = PERCEPT + torch.tensor([1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert arm_command(robot(), away) is None
    with pytest.raises(DataError, match="a percept has 6 numbers"):
        arm_command(robot(), PERCEPT[:6])
