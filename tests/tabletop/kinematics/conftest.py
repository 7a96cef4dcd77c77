import math

import pytest
import torch

from cgtorch.tabletop.kinematics import ArmModel, Robot, load_robot


@pytest.fixture(scope="session")
def pr2() -> Robot:
    return load_robot()


@pytest.fixture(scope="session")
def fetch() -> Robot:
    return load_robot(description="fetch")


@pytest.fixture(params=["pr2 left", "pr2 right", "fetch arm"])
def robot_and_arm(request: pytest.FixtureRequest) -> tuple[Robot, ArmModel]:
    """Each arm of each built-in robot."""
    robot, name = request.param.split()
    found: Robot = request.getfixturevalue(robot)
    (arm,) = (arm for arm in found.arms if arm.name == name)
    return found, arm


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def _random_joints(arm, count, generator):
    lower = torch.where(arm.continuous, -math.pi, arm.lower)
    upper = torch.where(arm.continuous, math.pi, arm.upper)
    share = torch.rand(count, len(lower), generator=generator, dtype=torch.float64)
    return lower + (upper - lower) * share


@pytest.fixture(scope="session")
def random_joints():
    """Joint positions (count, n) within an arm's limits, float64."""
    return _random_joints
