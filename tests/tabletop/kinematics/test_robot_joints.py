"""What is read of single joints and links: limits, lengths, where they may be held, inertias."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.robot import _check_held, _check_home, _limits, _reach
from cgtorch.tabletop.kinematics.urdf import inertial_problem


def joint(kind: str = "revolute", lower: float = -1.0, upper: float = 2.0, **more: object) -> Any:
    limit = SimpleNamespace(lower=lower, upper=upper)
    every = {"mimic": None, "safety_controller": None, "origin": None, "name": "j", **more}
    return SimpleNamespace(type=kind, limit=limit, **every)


def soft(lower: float | None, upper: float | None) -> Any:
    return SimpleNamespace(soft_lower_limit=lower, soft_upper_limit=upper)


@pytest.mark.parametrize(
    ("controller", "limits"),
    [
        (None, (-1, 2)),
        (soft(-0.5, 1.5), (-0.5, 1.5)),
        (soft(-3, 1.5), (-1, 1.5)),
        (soft(-0.5, 3), (-0.5, 2)),
        (soft(None, 1.5), (-1, 2)),
        (soft(-0.5, None), (-1, 2)),
        (soft(1.5, 0.5), (-1, 2)),  # which leave nothing between them
        (soft(0.5, 0.5), (-1, 2)),
    ],
)
def test_soft_limits_narrow_hard_ones(controller: object, limits: tuple[float, float]) -> None:
    assert _limits(joint(safety_controller=controller)) == limits
    assert _limits(joint("continuous", safety_controller=controller)) == (-3 * math.pi, 3 * math.pi)


def moved(*shift: float) -> Any:
    pose = np.eye(4)
    pose[:3, 3] = shift
    return pose


def test_an_arm_reaches_as_far_as_its_links_in_one_line_and_its_slides() -> None:
    links = joint(origin=moved(3, 4, 0)), joint("fixed", origin=moved(0, 0, -2)), joint()
    assert _reach(links) == pytest.approx(7.0)
    slides = joint("prismatic", -0.5, 0.2), joint("prismatic", 0.1, 0.4), joint("prismatic", -2, -1)
    assert _reach((*links, *slides)) == pytest.approx(7.0 + 0.5 + 0.4 + 2)
    assert _reach((joint("prismatic", 0.0, 0.0),)) == 0


@pytest.mark.parametrize(
    ("given", "position", "problem"),
    [
        (joint(), -1.0, None),
        (joint(), 2.0, None),
        (joint("continuous"), 99.0, None),
        (joint(), -1.01, "give a position within its limits -1.0 to 2.0"),
        (joint(), 2.01, "cannot be held at 2.01: give a position within"),
        (joint("fixed"), 0.0, "it is fixed or follows another joint"),
        (joint(mimic="another"), 0.0, "it is fixed or follows another joint"),
        (joint(name="arm"), 0.0, "moves an arm: name a joint outside the arms"),
    ],
)
def test_a_joint_is_held_within_its_limits(
    given: Any, position: float, problem: str | None
) -> None:
    if problem is None:
        _check_held(given, position, {"arm"})
    else:
        with pytest.raises(RobotError, match=problem):
            _check_held(given, position, {"arm"})


@pytest.mark.parametrize(
    ("position", "problem"),
    [(-1.0, None), (2.0, None), (2.01, "within its limits -1.0 to 2.0"), (-1.01, "at -1.01 at")],
)
def test_a_joint_of_an_arm_is_at_home_within_its_limits(
    position: float, problem: str | None
) -> None:
    if problem is None:
        _check_home(joint(), position, {"j"})
    else:
        with pytest.raises(RobotError, match=problem):
            _check_home(joint(), position, {"j"})
    with pytest.raises(RobotError, match="moves no arm: name a joint of an arm, or hold it"):
        _check_home(joint(), position, {"k"})


@pytest.mark.parametrize(
    ("mass", "moments", "problem"),
    [
        (1.0, (1, 1, 1), ""),
        (0.0, (0, 0, 0), ""),
        (None, None, ""),
        (-0.1, (1, 1, 1), "the mass -0.1 kg"),
        (1.0, (-1e-3, 1, 1), "an inertia of -0.001 kg m² about one of its axes"),
        (1.0, (-0.9e-6, 1, 1), ""),  # which is rounding
        (1.0, (1, 1, 1e6), ""),
        (
            1.0,
            (1, 1, 1.1e6),
            "an inertia of 1.1e+06 kg m² about one of its axes, which is above 1e+06",
        ),
        (1.0, (-0.9e-12, 0, 0), ""),
        (1.0, (-1.1e-12, 0, 0), "an inertia of -1.1e-12 kg m² about one of its axes"),
    ],
)
def test_an_impossible_inertia_is_told(
    mass: float | None, moments: tuple[float, ...] | None, problem: str
) -> None:
    inertia = None if moments is None else np.diag(np.array(moments, float))
    link = SimpleNamespace(inertial=SimpleNamespace(mass=mass, inertia=inertia))
    assert inertial_problem(link) == problem
    assert inertial_problem(SimpleNamespace(inertial=None)) == ""
