"""`cgtorch-robot`: from a URDF with meshes to a robot that is trained."""

import json
import shutil
from pathlib import Path
from typing import Any

import mesh_robot
import pytest
from command_line import Shell, listing

ROBOT = "cgtorch-robot"


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """A URDF outside its package."""
    path = mesh_robot.write_package(tmp_path / "ws")
    return Path(shutil.move(path, tmp_path / "robot.urdf"))


def words(tmp_path: Path) -> Any:
    return json.loads((tmp_path / "mine" / "robot.json").read_text())


def test_a_folder_and_what_to_check(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    ended = shell(ROBOT, urdf, "--package-path", "ws", "--output", "mine")
    assert ended.code == 0, ended.err
    assert "mesh robot: mine\nbase frame base_link, footprint 0.500 by 0.460 m" in ended.out
    assert "torso torso_joint at" in ended.out
    assert "arm arm: 7 joints from torso_link to arm_tool_frame, solved in closed form" in ended.out
    assert "8 meshes are" in ended.out
    assert "Please check:\n- " in ended.out
    assert "objects on a table right before the robot it can grasp" in ended.out
    names = {"mine", *(f"mine/robot.{e}" for e in ("json", "png", "urdf")), "mine/shapes.json"}
    assert {name for name in listing(tmp_path) if name.startswith("mine")} == names


def test_every_proposal_can_be_overridden(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    ended = shell(
        ROBOT, urdf, "--package-path", tmp_path / "ws", "--output", "mine", "--name", "me",
        "--base-frame", "base_link", "--footprint", "-0.3", "0.3", "-0.25", "0.25",
        "--torso-joint", "torso_joint", "--torso-position", "0.2",
        "--arm", "one=torso_link:hand_link", "--body", "base_link", "--body", "torso_link",
        "--hold", "left_joint=0.01", "--home", "elbow_joint=-1",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    found = words(tmp_path)
    assert found["name"] == "me"
    assert found["footprint"] == [-0.3, 0.3, -0.25, 0.25]
    assert found["torso_position"] == 0.2
    assert found["arms"] == [{"name": "one", "base_link": "torso_link", "tool_frame": "hand_link"}]
    assert found["body"] == ["base_link", "torso_link"]
    assert found["gripper_joints"]["left_joint"] == 0.01
    assert found["home"] == {"elbow_joint": -1}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([], "which is missing: the package 'mesh_robot' is in none of"),
        (["--package-path", "none"], "in none of 'none', '"),
        (["--package-path", "ws", "--hold", "neck"], "--hold is 'neck'; give JOINT=POSITION"),
        (["--package-path", "ws", "--hold", "neck=1"], "has no joint 'neck'"),
        (["--package-path", "ws", "--arm", "one"], "--arm is 'one'; give NAME=BASE_LINK:TOOL"),
        (["--package-path", "ws", "--arm", "a=base_link:x"], "has no link 'x'"),
        (["--package-path", "ws", "--torso-position", "7"], "within its limits 0.0 to 0.3"),
        (["--package-path", "ws", "--torso-position", "nan"], "give plain finite data"),
        (["--package-path", "ws", "--home", "pan_joint=9"], "'pan_joint' cannot be at 9.0"),
        (["--package-path", "ws", "--footprint", "1", "0", "0", "1"], "footprint is [1.0, 0.0"),
        (["--footprint", "1"], "requires 4 arguments"),
    ],
)
def test_bad_input(shell: Shell, urdf: Path, tmp_path: Path, more: list[str], message: str) -> None:
    before = listing(tmp_path)
    assert message in shell.refuses(ROBOT, urdf, "--output", "mine", *more)
    assert listing(tmp_path) == before


def test_a_name_that_leads_out_of_its_package(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    text = urdf.read_text().replace("meshes/palm.stl", "../../../../etc/passwd")
    urdf.write_text(text)
    message = shell.refuses(ROBOT, urdf, "--package-path", "ws", "--output", "mine")
    assert "which leads out of the package 'mesh_robot'" in message


def test_what_is_there_is_not_replaced(shell: Shell, urdf: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    assert "'mine' exists; choose another" in shell.refuses(ROBOT, urdf, "--output", "mine")
    assert "not a file" in shell.refuses(ROBOT, "none.urdf", "--output", "other")
