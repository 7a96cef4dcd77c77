"""The simulated robot carries out an exported skill through plain commands alone."""

import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from cgtorch.export import to_state_machine
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.arm_command import arm_command
from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.world import percept_of, stage_scenarios
from examples.robot_driver import SimulatedRobot, module_of, states_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot()


def test_an_exported_skill_on_the_simulated_robot(robot: Robot, tmp_path: Path) -> None:
    path = tmp_path / "skill.py"
    path.write_bytes(to_state_machine(last_skill(ROOT / "runs" / "reference")[1]))
    skill = module_of(path)
    scenarios, ends = stage_scenarios("near", 3), []
    for row in range(3):
        machine = SimulatedRobot(robot, scenarios[row : row + 1])
        ends.append(skill.run(machine.look(), states_of(skill, machine)))
    assert ends.count("success") >= 2


def test_an_arm_command_is_plain_and_within_limits(robot: Robot) -> None:
    pose = torch.tensor([-0.95, 0.0, 0.0])
    table = torch.tensor([0.0, 0, 0, 0.8, 1.2, 0.74])
    command = arm_command(robot, percept_of(pose, table, torch.tensor([-0.3, 0.1])))
    assert command is not None
    arm = next(a for a in robot.arms if a.name == command["arm"])
    assert command["joints"] == list(arm.joint_names)
    times, rows = torch.tensor(command["times"]), torch.tensor(command["positions"]).double()
    assert (times.diff() > 0).all()
    assert len(times) == len(rows) == len(command["openings"])
    limited = ~arm.continuous
    assert (rows[:, limited] >= arm.lower[limited] - 1e-6).all()
    assert (rows[:, limited] <= arm.upper[limited] + 1e-6).all()
    fastest = (rows.diff(dim=0).abs() / times.diff()[:, None]).amax(0)
    urdf = [robot.urdf.joint(name).limit.velocity for name in arm.joint_names]
    assert (fastest <= torch.tensor(urdf) / 2 + 0.01).all()
    assert command["openings"][0] == [pytest.approx(0.4)]
    assert command["openings"][-1] == [pytest.approx(0.0)]


def test_there_is_no_command_for_what_is_out_of_reach(robot: Robot) -> None:
    table = torch.tensor([0.0, 0, 0, 0.8, 1.2, 0.74])
    far = percept_of(torch.tensor([-3.0, 0, 0]), table, torch.tensor([0.0, 0]))
    assert arm_command(robot, far) is None
