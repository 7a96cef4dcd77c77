"""`cgtorch-robot`: from a URDF with meshes to a robot that is trained."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mesh_robot
import pytest
import torch
from command_line import ROBOT, Shell, listing

from cgtorch.commands.robot import _summary
from cgtorch.tabletop.kinematics.description import Arm


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """A URDF outside its package."""
    path = mesh_robot.write_package(tmp_path / "ws")
    return Path(shutil.move(path, tmp_path / "robot.urdf"))


def test_a_folder_and_what_to_check(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    out = shell.does(ROBOT, urdf, "--package-path", "ws", "--output", "mine").out
    assert "mesh robot: mine\nbase frame base_link, footprint 0.500 by 0.460 m" in out
    assert "torso torso_joint at" in out
    assert "arm arm: 7 joints from torso_link to arm_tool_frame, solved in closed form" in out
    assert "8 meshes are" in out
    assert "Please check:\n- " in out
    assert "objects on a table right before the robot it can grasp" in out
    names = {"mine", *(f"mine/robot.{e}" for e in ("json", "png", "urdf")), "mine/shapes.json"}
    assert {name for name in listing(tmp_path) if name.startswith("mine")} == names
    assert "'mine' exists; choose another" in shell.refuses(ROBOT, urdf, "--output", "mine")


def test_every_proposal_can_be_overridden(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    shell.does(
        ROBOT, urdf, "--package-path", tmp_path / "ws", "--output", "mine", "--name", "me",
        "--base-frame", "base_link", "--footprint", "-0.3", "0.3", "-0.25", "0.25",
        "--torso-joint", "torso_joint", "--torso-position", "0.2",
        "--arm", "one=torso_link:hand_link", "--body", "base_link", "--body", "torso_link",
        "--hold", "left_joint=0.01", "--home", "elbow_joint=-1",
    )  # fmt: skip
    found = json.loads((tmp_path / "mine" / "robot.json").read_text())
    assert found["gripper_joints"]["left_joint"] == 0.01
    wanted = {
        "name": "me",
        "footprint": [-0.3, 0.3, -0.25, 0.25],
        "torso_position": 0.2,
        "arms": [{"name": "one", "base_link": "torso_link", "tool_frame": "hand_link"}],
        "body": ["base_link", "torso_link"],
        "home": {"elbow_joint": -1},
    }
    assert found == {**found, **wanted}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([], "in none of 'none', '"),
        (["--hold", "neck"], "--hold is 'neck'; give JOINT=POSITION"),
        (["--hold", "neck=1"], "has no joint 'neck'"),
        (["--arm", "one"], "--arm is 'one'; give NAME=BASE_LINK:TOOL"),
        (["--arm", "a=base_link:x"], "has no link 'x'"),
        (["--torso-position", "7"], "within its limits 0.0 to 0.3"),
        (["--torso-position", "nan"], "give plain finite data"),
        (["--home", "pan_joint=9"], "'pan_joint' cannot be at 9.0"),
        (["--footprint", "1", "0", "0", "1"], "footprint is [1.0, 0.0"),
        (["--footprint", "1"], "requires 4 arguments"),
    ],
)
def test_bad_input(shell: Shell, urdf: Path, tmp_path: Path, more: list[str], message: str) -> None:
    before = listing(tmp_path)
    words = ["--package-path", "ws" if more else "none", "--output", "mine", *more]
    assert message in shell.refuses(ROBOT, urdf, *words)
    assert listing(tmp_path) == before


def test_files_that_cannot_be_read(shell: Shell, urdf: Path) -> None:
    message = shell.refuses(ROBOT, urdf, "--output", "mine")
    assert "which is missing: the package 'mesh_robot' is in none of" in message
    urdf.write_text(urdf.read_text().replace("meshes/palm.stl", "../../../../etc/passwd"))
    message = shell.refuses(ROBOT, urdf, "--package-path", "ws", "--output", "mine")
    assert "which leads out of the package 'mesh_robot'" in message
    assert "not a file" in shell.refuses(ROBOT, "none.urdf", "--output", "other")


def a_robot(**more: Any) -> Any:
    """What a robot's folder was made of, as far as it is told."""
    arms = [Arm("left", "torso", "left_tool"), Arm("right", "torso", "right_tool")]
    words = SimpleNamespace(
        name="me", footprint=(-0.25, 0.35, -0.2, 0.3), base_frame="base", arms=arms,
        torso_joint="lift", torso_position=0.2,
    )  # fmt: skip
    models = [
        SimpleNamespace(joint_names=["a"] * 7, closed_form=object()),
        SimpleNamespace(joint_names=["a"] * 6, closed_form=None),
    ]
    about = {
        "robot": SimpleNamespace(description=words, arms=models), "meshes": [], "notes": [],
        "inertials": [], "reached": SimpleNamespace(grasps=torch.tensor([True, False]), why=""),
    }  # fmt: skip
    return SimpleNamespace(**{**about, **more})


def test_the_summary_of_a_robot() -> None:
    checks = [
        "- x leads forward in mine/robot.png, and the dashed footprint holds the body",
        "- tool frames lie between the finger tips: red (x) along the approach, green (y) across",
    ]
    lines = [
        "me: mine",
        "base frame base, footprint 0.600 by 0.500 m, x from -0.25 to 0.35, y from -0.2 to 0.3",
        "torso lift at 0.2",
        "arm left: 7 joints from torso to left_tool, solved in closed form",
        "arm right: 6 joints from torso to right_tool, solved numerically, which is slow",
    ]
    reached = "- of 2 objects on a table right before the robot it can grasp 1"
    plain = a_robot()
    assert list(_summary(plain, Path("mine"))) == [*lines, "", "Please check:", *checks, reached]
    plain.robot.description.torso_joint = ""
    assert list(_summary(plain, Path("mine")))[2] == "no torso joint"
    shapes = [SimpleNamespace(ratio=ratio, shapes=["box"] * n) for ratio, n in ((1.5, 2), (2.5, 1))]
    more = a_robot(
        meshes=[
            *(SimpleNamespace(fit=fit, link=f"link {i}") for i, fit in enumerate(shapes)),
            SimpleNamespace(fit=None, link="hand", problem="its file is empty"),
        ],
        notes=["the stand is a guess"], inertials=["wheel", "hand"],
        reached=SimpleNamespace(grasps=torch.zeros(3), why="too far"),
    )  # fmt: skip
    assert list(_summary(more, Path("mine"))) == [
        *lines,
        "2 meshes are 3 shapes, of 2.00 times the volume of convex hulls (mean; 2.50 of link 1)",
        "", "Please check:", *checks, "- the stand is a guess",
        "- masses or inertias were made up for wheel, hand",
        "- link hand is not drawn: its file is empty",
        "- of 3 objects on a table right before the robot it can grasp 0: too far",
    ]  # fmt: skip
