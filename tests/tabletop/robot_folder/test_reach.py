"""Why a robot grasps nothing on a usual table, in a sentence whose numbers can be checked."""

import json
import math
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mesh_robot
import pytest
import torch
from small_urdfs import LIMIT, box, joint, link, urdf_of
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot, graspable, load_robot, load_urdf
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.robot_folder import reach
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.reach import (
    AHEAD,
    ASIDE,
    DEPTH,
    DEPTHS,
    HEIGHT,
    OTHERS,
    SIDEWAYS,
    TURNED,
    _better,
    _better_height,
    _hindered,
    _lacking,
    objects,
    reached,
)

LENGTH = 0.1 + 0.4 + 0.32 + 0.17  # m: the arm of `mesh_robot`, and its tool frame before the hand
PAN = 0.3  # m: the first joint above the link that carries it
SHOULDER = 1.0  # m: the same above the floor


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a robot that reaches a usual table."""
    place = tmp_path_factory.mktemp("reach")
    make_robot_folder(mesh_robot.write_package(place / "ws"), place / "mine")
    return place / "mine"


def robot_with(
    folder: Path, place: Path, shoulder: float, turn: float = 0.0, **words: object
) -> Robot:
    """The robot with its shoulder at another height (m), turned (rad), and described otherwise."""
    shutil.copytree(folder, place)
    text = (place / "robot.urdf").read_text()
    pan = text.index('<joint name="pan')
    begin = text.index("<origin", pan)
    end = text.index(">", begin) + 1
    assert "0.3" in text[begin:end]
    origin = f'<origin xyz="0.15 0 {PAN + shoulder - SHOULDER}" rpy="0 0 {turn}"/>'
    (place / "robot.urdf").write_text(text[:begin] + origin + text[end:])
    about = json.loads((place / "robot.json").read_text())
    (place / "robot.json").write_text(json.dumps({**about, **words}))
    return load_robot(description=place)


def test_objects_stand_on_a_table_right_before_the_footprint(folder: Path) -> None:
    robot = load_robot(description=folder)
    at, table = objects(robot, 0.6)
    edge = robot.description.footprint[1] + AHEAD
    assert at.shape == (9, 3)
    assert table[0].tolist() == pytest.approx([edge + 0.4, 0, 0, 0.8, 1.6, 0.6])
    assert (at[:, 2] == table[:, 5]).all()
    assert {round(x - edge, 3) for x in at[:, 0].tolist()} == {0.1, 0.2, 0.3}
    assert {round(y, 3) for y in at[:, 1].tolist()} == {-0.3, 0.0, 0.3}
    found = reached(robot)
    assert found.grasps.tolist() == graspable(robot, *objects(robot, 0.75)).tolist()
    assert found.grasps.any()
    assert found.why == ""


def test_an_arm_that_reaches_some_objects_is_told_nothing(folder: Path, tmp_path: Path) -> None:
    found = reached(robot_with(folder, tmp_path / "rather_high", 1.6))
    assert 0 < int(found.grasps.sum()) < len(found.grasps)
    assert found.why == ""


def test_an_arm_that_is_too_high_is_told_a_table_that_suits(folder: Path, tmp_path: Path) -> None:
    robot = robot_with(folder, tmp_path / "high", 1.74)
    found = reached(robot, 0.1)
    assert not found.grasps.any()
    edge = robot.description.footprint[1] + AHEAD
    away = math.hypot(edge + 0.1 - shoulder_x(robot), 1.74 - 0.75)
    assert found.why == (
        f"arm 'arm' is {LENGTH:.2f} m long from its shoulder, 1.74 m high, and the nearest object "
        f"{away:.2f} m away from that; at 1.2 m it can grasp 9 of 9, so make tables of that height"
    )


def shoulder_x(robot: Robot) -> float:
    robot.urdf.model.update_cfg({})
    pose = robot.urdf.model.get_transform(
        robot.urdf.joint(robot.arms[0].joint_names[0]).child, robot.description.base_frame
    )
    return float(pose[0, 3])


@pytest.mark.parametrize("stand", [0.0, 0.1])
def test_an_arm_that_is_too_low_is_told_a_stand(stand: float, folder: Path, tmp_path: Path) -> None:
    """Of the height of the present one, and what the table is too high."""
    found = reached(robot_with(folder, tmp_path / "low", 0.35), stand)
    assert not found.grasps.any()
    (height, put) = map(
        float, re.findall(r"; at ([\d.]+) m it can .* --stand ([\d.]+)$", found.why)[0]
    )
    assert put == pytest.approx(stand + 0.75 - height)
    assert height in (0.45, 0.3, 0.15, 0.05)
    assert "0.35 m high; " in found.why


@pytest.mark.parametrize(
    ("turn", "told"), [(0.0, None), (math.pi / 2, 90), (-math.pi / 2, -90), (math.pi / 4, None)]
)
def test_an_arm_that_points_elsewhere_at_rest_is_told_so(
    turn: float, told: int | None, folder: Path, tmp_path: Path
) -> None:
    why = reached(robot_with(folder, tmp_path / "turned", 1.74, turn)).why
    said = f"at rest it points {told} degrees away from x"
    assert (said in why) if told is not None else "at rest" not in why


def test_where_no_height_helps_it_is_told_what_hinders_at_the_one_of_the_shoulder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the hand is in the base while it drives, from where hardly a way is clear."""
    monkeypatch.setattr(reach, "_heights_of_tools", lambda robot: (HEIGHT,))
    home = dict(json.loads((folder / "robot.json").read_text())["home"])
    inside = dict.fromkeys(home, 0.0) | {n: 1.4 for n in home if n.startswith("lift")}
    found = reached(robot_with(folder, tmp_path / "blocked", SHOULDER, home=inside))
    assert not found.grasps.any()
    assert "; nor can it at any height that was tried, from 0.05 to 1.2 m; " in found.why
    counts = re.search(
        r"has a posture at (\d+) of 225 approaches at 0.9 m, clear ones at (\d+), and follows "
        r"(\d+) of them, but no clear way leads there from home: give another one by --home$",
        found.why,
    )
    assert counts is not None, found.why
    posed, clear, follows = map(int, counts.groups())
    assert 225 >= posed >= clear >= follows > 0


@pytest.mark.parametrize(("slide", "drawn"), [((-0.1, 0.4), 0.4), ((-0.6, 0.4), 0.6)])
@pytest.mark.parametrize("turn", [0, 59, 61, -61, 120])
@pytest.mark.parametrize("aside", [0.0, 0.6])
def test_an_arm_is_as_long_as_its_links_and_what_it_draws_out(
    slide: tuple[float, float], drawn: float, turn: float, aside: float, tmp_path: Path
) -> None:
    """A lift that belongs to it does not count, as it moves its shoulder alone."""
    limit = LIMIT.replace('"-1"', f'"{slide[0]}"').replace('"1"', f'"{slide[1]}"', 1)
    x, y = 0.3 * math.cos(math.radians(turn)), 0.3 * math.sin(math.radians(turn))
    parts = (
        link("base", box("0.4 0.4 0.8", "0 0 0.4")), link("lift"),
        joint("lift", "base", "0 0 1", kind="prismatic"), link("pan"),
        joint("pan", "lift", f"{x} {y} {aside}"), link("drawn"),
        joint("drawn", "pan", "0 0 0", "1 0 0", "prismatic", limit), link("tool", ""),
        joint("tool", "drawn", "0 0 0.1", kind="fixed", more=""),
    )  # fmt: skip
    robot: Any = SimpleNamespace(
        urdf=load_urdf(urdf_of(tmp_path, *parts)),
        description=SimpleNamespace(
            base_frame="base", footprint=(-0.2, 0.2, -0.2, 0.2), arms=[Arm("a", "base", "tool")]
        ),
    )
    far, about, shoulder = _lacking(robot, 0)
    length = math.hypot(0.3, aside) + 0.1 + drawn
    near = math.hypot(0.2 + AHEAD + DEPTHS[0], 1 - HEIGHT)
    assert shoulder == pytest.approx(1.0)
    assert far == pytest.approx(max(near - length, 0.0))
    said = f"arm 'a' is {length:.2f} m long from its shoulder, 1.00 m high"
    if SIDEWAYS * length < 0.3 and abs(turn) > TURNED:
        said += f", and at rest it points {turn} degrees away from x"
    assert about == said + (f", and the nearest object {near:.2f} m away from that" * bool(far))


FOOTPRINT = {"description": SimpleNamespace(footprint=(-0.3, 0.3, -0.2, 0.2), torso_joint=None)}
ROBOT: Any = SimpleNamespace(
    arms=[SimpleNamespace(name="left", freedom=6), SimpleNamespace(name="right", freedom=6)],
    **FOOTPRINT,
)
"""One of which no kinematics are asked."""


@pytest.mark.parametrize(
    ("came", "told"),
    [
        ((0, 0, 0), "no posture within the limits of the joints brings the tool frame to an obj"),
        ((5, 0, 0), "posture at 5 of 225 approaches at 0.6 m, but all touch the table or the ro"),
        ((5, 3, 0), "0.6 m, clear ones at 3, but from none of these it can move 0.10 m back"),
        ((5, 3, 2), "clear ones at 3, and follows 2 of them, but no clear way leads there from"),
    ],
)
def test_what_hinders_is_what_no_approach_gets_beyond(
    came: tuple[int, int, int], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reach, "progress", lambda *about: came)
    said = _hindered(ROBOT, 1, 0.6)
    assert told in said
    assert said.startswith("arm 'right' has a posture" if came[0] else "no posture")


@pytest.mark.parametrize(("freedom", "few"), [(4, True), (5, False)])
@pytest.mark.parametrize("came", [(0, 0, 0), (5, 3, 0)])
def test_an_arm_that_moves_its_tool_in_few_ways_is_told(
    came: tuple[int, int, int], freedom: int, few: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reach, "progress", lambda *about: came)
    robot: Any = SimpleNamespace(arms=[SimpleNamespace(name="arm", freedom=freedom)], **FOOTPRINT)
    told = "; it moves its tool in 4 ways only, so it can approach from few sides"
    assert _hindered(robot, 0, 0.6).endswith(told) == few


def test_an_arm_that_works_below_its_base_needs_a_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _better(-0.2, 3, 0.1) == (
        "below its base it can grasp 3 of 9, so put it on a stand by --stand 1.05"
    )
    monkeypatch.setattr(reach, "_heights_of_tools", lambda robot: (HEIGHT,))
    monkeypatch.setattr(reach, "graspable", lambda robot, position, table: table[:, 5] < -0.15)
    assert _better_height(ROBOT) == -0.2


def test_a_table_may_become_higher_and_lower_ones_are_a_stand() -> None:
    assert _better(0.9, 4, 0.1).endswith("it can grasp 4 of 9, so make tables of that height")
    assert _better(0.45, 2, 0.1).endswith("height, or put it on a stand by --stand 0.4")


def graspable_at(*heights: float) -> Any:
    """What says that objects on tables of these heights are grasped, and one aside at others."""

    def found(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
        assert (position[:, 2] == table[:, 5]).all()
        near = (table[:, 5:] - torch.tensor(heights)).abs().amin(1) < 1e-6
        aside = position[:, 1] == torch.tensor(ASIDE[2])
        return near | (aside & (position[:, 0] > 0.3 + AHEAD + DEPTHS[0] + 0.01))

    return found


def test_a_better_height_is_that_of_most_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reach, "graspable", graspable_at(0.45))
    assert _better_height(ROBOT) == 0.45
    monkeypatch.setattr(reach, "_heights_of_tools", lambda robot: (HEIGHT,))
    monkeypatch.setattr(reach, "graspable", lambda robot, position, table: table[:, 5] < -1)
    assert _better_height(ROBOT) is None


@pytest.mark.parametrize("far", [0.5, 0.0])
def test_the_nearest_arm_is_told_of_and_what_suits_it(
    far: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacks = [(0.7, "the left one", 0.3), (far, "the right one", 1.0)]
    monkeypatch.setattr(reach, "_lacking", lambda robot, number: lacks[number])
    monkeypatch.setattr(reach, "_hindered", lambda robot, *about: f"hindered {about}")
    monkeypatch.setattr(reach, "_beside_footprint", lambda *about: "")
    monkeypatch.setattr(reach, "graspable", lambda robot, position, table: table[:, 5] == 0.6)
    monkeypatch.setattr(reach, "_better_height", lambda robot: None)
    monkeypatch.setattr(reach, "_approached", lambda *about: True)
    found = reached(ROBOT)
    assert found.grasps.tolist() == [False] * 9
    heights = f"{min(OTHERS):g} to {max(OTHERS):g} m"
    assert found.why == (
        f"the right one; nor can it at any height that was tried, from {heights}; hindered (1, 0.9)"
    )
    monkeypatch.setattr(reach, "_better_height", lambda robot: 0.6)
    why = "" if far else f"; hindered (1, {HEIGHT})"
    stand = "at 0.6 m it can grasp 9 of 9, so make tables of that height, or put it on a stand by"
    table = torch.tensor(0.6)
    monkeypatch.setattr(reach, "graspable", lambda robot, position, of: of[:, 5] == table)
    assert reached(ROBOT, 0.2).why == f"the right one{why}; {stand} --stand 0.35"


def test_heights_between_are_tried_before_none_is_said_to_suit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A band of 8 cm in which no usual height lies."""

    def in_band(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
        return (table[:, 5] > 0.49) & (table[:, 5] < 0.57)

    monkeypatch.setattr(reach, "graspable", in_band)
    monkeypatch.setattr(reach, "_heights_of_tools", lambda robot: (0.48, 0.5, 0.58))
    assert _better_height(ROBOT) == 0.5
    monkeypatch.setattr(reach, "_heights_of_tools", lambda robot: (0.48, 0.58))
    assert _better_height(ROBOT) is None


def test_heights_of_tools_are_those_to_which_the_arm_comes(folder: Path, tmp_path: Path) -> None:
    heights = reach._heights_of_tools(robot_with(folder, tmp_path / "high", SHOULDER))
    assert len(heights) == reach.BETWEEN
    assert list(heights) == sorted(heights)
    assert min(OTHERS) <= heights[0] < SHOULDER - LENGTH / 2 < heights[-1] <= max(OTHERS)


@pytest.mark.parametrize(
    ("axis", "at", "height", "said"),
    [
        ("0 0 1", 0.2, 0.6, ", or move its torso by --torso-position 0.35"),
        ("0 0 -1", 0.2, 0.6, ", or move its torso by --torso-position 0.05"),
        ("0 0 1", 0.2, 0.9, ", or move its torso by --torso-position 0.05"),
        ("0 0 1", 0.5, 0.6, ""),
        ("0 0 1", None, 0.6, ""),
    ],
)
def test_a_torso_makes_up_for_a_height_within_its_limits(
    tmp_path: Path, axis: str, at: float | None, height: float, said: str
) -> None:
    limit = LIMIT.replace('"-1"', '"0"').replace('"1"', '"0.6"', 1)
    lift = joint("lift", "base", axis=axis, kind="prismatic", more=limit)
    urdf = load_urdf(urdf_of(tmp_path, link("base"), link("lift"), lift))
    words = SimpleNamespace(
        base_frame="base", torso_joint=None if at is None else "lift_joint", torso_position=at
    )
    robot: Any = SimpleNamespace(urdf=urdf, description=words)
    assert reach._lifted(robot, height) == said


def test_an_arm_that_is_long_when_retracted_is_told_from_where_it_reaches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def beyond(robot: Robot, position: Tensor, table: Tensor) -> Tensor:
        far = (position[:, 0] > 0.3 + 0.5) & (table[:, 0] > 0.3 + DEPTH / 2 + 0.49)
        return far & (position[:, 1] == 0) & (table[:, 5] == HEIGHT)

    monkeypatch.setattr(reach, "_lacking", lambda robot, number: (0.0, "the arm", 1.0))
    monkeypatch.setattr(reach, "_better_height", lambda robot: None)
    monkeypatch.setattr(reach, "graspable", beyond)
    monkeypatch.setattr(reach, "progress", lambda *about: (3, 2, 0))
    found = reached(ROBOT)
    assert found.somewhere
    assert found.why == (
        "the arm; it does not reach nearer than about 0.90 m from its base frame: from 0.5 m "
        "before the table it can grasp 3 of 9"
    )
    monkeypatch.setattr(reach, "_hindered", lambda *about: "hindered by its home")
    monkeypatch.setattr(reach, "_beside_footprint", lambda *about: "")
    monkeypatch.setattr(reach, "progress", lambda *about: (3, 2, 1))
    assert reached(ROBOT).why.endswith("hindered by its home")
    monkeypatch.setattr(reach, "progress", lambda *about: (3, 2, 0))
    monkeypatch.setattr(reach, "graspable", lambda robot, position, table: table[:, 5] < 0)
    assert not reached(ROBOT).somewhere
