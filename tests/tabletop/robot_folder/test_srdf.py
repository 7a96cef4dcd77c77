"""What an SRDF says of a robot: arms, states and pairs that never collide; and broken ones."""

from types import SimpleNamespace

import pytest
from small_urdfs import box, chain, fingers, joint, link, urdf_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_robot, load_urdf
from cgtorch.tabletop.kinematics.clear_ways import OWN
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.robot_folder.make import make_robot_folder
from cgtorch.tabletop.robot_folder.srdf import _within, read_srdf

BASE = link("base", box("0.3 0.3 1", "0 0 0.5"))
ROBOT = (
    BASE, link("lift"), joint("lift", "base", "0 0 1", kind="prismatic"),
    chain("arm", 6, "lift", "0.1 0 0", "0.1 0 0.1"), fingers("hand", "arm5", "0.05 {} 0"),
    chain("head", 5, "lift", first="0 0 0.3"),
)  # fmt: skip


def read(tmp_path, *parts):
    urdf = load_urdf(urdf_of(tmp_path, *ROBOT))
    path = tmp_path / "robot.srdf"
    path.write_text(f"<robot name='x'>{''.join(parts)}</robot>")
    return read_srdf(path, urdf)


def group(name, *parts):
    return f'<group name="{name}">{"".join(parts)}</group>'


def joints(*names):
    return "".join(f'<joint name="{name}_joint"/>' for name in names)


def state(name, group, **positions):
    inside = "".join(f'<joint name="{k}_joint" value="{v}"/>' for k, v in positions.items())
    return f'<group_state name="{name}" group="{group}">{inside}</group_state>'


CHAIN = '<chain base_link="lift" tip_link="arm5"/>'
NAMES = [f"arm{i}" for i in range(6)]
ARM = Arm("right_arm", "lift", "arm5")
EFFECTOR = '<end_effector name="e" parent_link="arm5" group="hand"/>'


@pytest.mark.parametrize(
    "parts",
    [
        [group("right_arm", CHAIN)],
        [group("right_arm", joints(*NAMES))],
        [group("right_arm", *(f'<link name="{name}"/>' for name in NAMES))],
        [group("right_arm", CHAIN), group("lift_arm", joints("lift"), '<group name="right_arm"/>')],
        [group("right_arm", CHAIN), group("all", '<group name="right_arm"/>', joints("head0"))],
        [group("right_arm", CHAIN), group("head_arm", joints("head0", "head1", "head2", "arm0"))],
        [group("right_arm", CHAIN), group("short_arm", joints("arm3", "arm4", "arm5"))],
    ],
)  # fmt: skip
def test_a_group_with_the_name_of_an_arm_is_one(tmp_path, parts):
    assert read(tmp_path, *parts).arms == (ARM,)


def test_an_end_effector_says_which_group_is_an_arm(tmp_path):
    head = group("head_arm", *(f'<link name="head{i}"/>' for i in range(5)))
    one, whole = group("a", CHAIN), group("b", joints("lift", *NAMES))
    assert read(tmp_path, head, whole, one, EFFECTOR).arms == (Arm("a", "lift", "arm5"),)
    given = EFFECTOR.replace("/>", ' parent_group="b"/>')
    assert read(tmp_path, head, one, whole, given).arms == (Arm("b", "base", "arm5"),)
    legs = group("left_leg", CHAIN), group("x", "")
    assert read(tmp_path, *legs, EFFECTOR).arms == ()


def test_states_are_home_and_open_fingers_within_limits(tmp_path):
    home = dict.fromkeys(NAMES, 0.5)
    arm = group("arm", CHAIN)
    found = read(tmp_path, arm, state("Home", "arm", lift=0.1, **home),
                 state("open", "hand", hand_a=0.25, hand_b=7, arm0=0.1))  # fmt: skip
    assert found.home == {f"{name}_joint": 0.5 for name in NAMES}
    assert found.opened == {"hand_a_joint": 0.25}
    ready = state("ready", "arm", **home)
    assert read(tmp_path, arm, ready).home == found.home
    assert read(tmp_path, arm, state("opened", "hand", hand_a=0.25)).opened == found.opened
    first = state("home", "arm", **dict.fromkeys(NAMES, 0.2))
    assert set(read(tmp_path, arm, ready, first).home.values()) == {0.2}
    assert f"home is that of SRDF '{tmp_path / 'robot.srdf'}'" in found.notes
    for wrong in (3, "nan", "x"):  # beyond a limit, or no number: home is incomplete
        assert read(tmp_path, arm, state("home", "arm", **{**home, "arm3": wrong})).home == {}


def test_positions_are_within_limits_if_there_are_any():
    turning = SimpleNamespace(type="continuous")
    assert [_within(turning, at) for at in (1e9, -1e9, float("inf"), float("nan"))] == [
        True, True, False, False,
    ]  # fmt: skip
    limited = SimpleNamespace(type="revolute", limit=SimpleNamespace(lower=-1.0, upper=2.0))
    found = [_within(limited, at) for at in (-1.0, 2.0, -1.1, 2.1, float("nan"))]
    assert found == [True, True, False, False, False]


def test_what_the_urdf_lacks_is_left_out_and_told(tmp_path):
    gone = (f'<disable_collisions link1="gone{i}" link2="arm1"/>' for i in range(6))
    parts = group("an_arm", '<chain base_link="lift" tip_link="nowhere"/>'), group("arm", CHAIN)
    found = read(tmp_path, *parts, '<disable_collisions link1="arm3" link2="arm1"/>', *gone)
    assert [arm.name for arm in found.arms] == ["arm"]
    assert found.apart == (("arm1", "arm3"),)
    assert found.notes[-1].endswith(
        "names 'nowhere', 'gone0', 'gone1', 'gone2' and 3 more, which the URDF lacks, so that is "
        "left out"
    )


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (["<group"], "is not well-formed XML"),
        ([group("a", '<group name="b"/>'), group("b", '<group name="a"/>')], "'a' in 'b' in 'a'"),
        ([group("a", '<group name="a"/>')], "'a' in 'a': break it"),
    ],
)
def test_a_broken_srdf_is_one_error(tmp_path, parts, message):
    with pytest.raises(RobotError, match=message):
        read(tmp_path, *parts)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<srdf/>", "starts with <srdf>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>', "document type"),
        ("", "not well-formed"),
    ],
)
def test_a_file_that_is_no_srdf(tmp_path, text, message):
    urdf = load_urdf(urdf_of(tmp_path, *ROBOT))
    path = tmp_path / "robot.srdf"
    path.write_text(text)
    with pytest.raises(RobotError, match=message):
        read_srdf(path, urdf)
    with pytest.raises(RobotError, match=r"none\.srdf"):
        read_srdf(tmp_path / "none.srdf", urdf)


def test_the_srdf_beside_a_urdf_is_used(tmp_path):
    names = [f"head{i}" for i in range(5)]
    home = state("home", "x", **dict.fromkeys(names, 0.3))
    apart = '<disable_collisions link1="head4" link2="head1"/>'
    read(tmp_path, group("head_arm", joints(*names)), home, apart)
    made = make_robot_folder(tmp_path / "robot.urdf", tmp_path / "made")
    robot = load_robot(description=tmp_path / "made")
    assert [arm.base_link for arm in robot.description.arms] == ["lift"]
    assert robot.arms[0].joint_names == tuple(f"{name}_joint" for name in names)
    assert set(robot.description.home.values()) == {0.3}
    assert robot.description.excludes == (("head1", "head4"),)
    assert "the arms are those of SRDF" in made.notes[0]
    links = [*[""] * OWN, *robot.arms[0].solid_links, *robot.body_links]
    pairs = {frozenset((links[a], links[b])) for a, b, _ in robot.scenes[0].pairs.tolist()}
    assert len(robot.arms[0].solid_links) == 5
    assert frozenset(("head0", "head4")) in pairs
    assert frozenset(("head1", "head4")) not in pairs
