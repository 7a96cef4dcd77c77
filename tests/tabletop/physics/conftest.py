"""One robot and its compiled models for all tests of physics."""

import pytest

from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.physics import Physics


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot()


@pytest.fixture(scope="session")
def physics(robot: Robot) -> Physics:
    return Physics(robot)
