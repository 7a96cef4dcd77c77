"""Whatever is wrong with a robot's files ends in one RobotError of one line."""

import json
import math
import re

import pytest

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_description, load_robot, load_urdf, robots_folder
from cgtorch.tabletop.kinematics.urdf import at_rest, one_line, parsed

PR2 = robots_folder() / "pr2"
TEXT = (PR2 / "pr2.urdf").read_text()
WORDS = json.loads((PR2 / "robot.json").read_text())

LINKS = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'
LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'


def joined(kind, inside, ends=ENDS):
    return f'<robot>{LINKS}<joint name="j" type="{kind}">{ends}{inside}</joint></robot>'


BOMB = (
    '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    '<robot name="&b;"><link name="a"/></robot>'
)


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
CIRCLE = (
    f'<robot>{LINKS}<joint name="j" type="fixed">{ENDS}</joint>'
    '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint></robot>'
)
LONG = "".join(
    f'<link name="l{i + 1}"/><joint name="j{i}" type="fixed"><parent link="l{i}"/>'
    f'<child link="l{i + 1}"/></joint>'
    for i in range(101)
)
LONG = f'<robot><link name="l0"/>{LONG}</robot>'


def fails(call, *arguments, **keywords):
    with pytest.raises(RobotError) as caught:
        call(*arguments, **keywords)
    message = str(caught.value)
    assert "\n" not in message
    return message


def robot(tmp_path, urdf=TEXT, words=WORDS):
    path = tmp_path / "robot.urdf"
    path.write_text(urdf)
    (tmp_path / "robot.json").write_text(words if isinstance(words, str) else json.dumps(words))
    return path


def test_the_files_are_sound_before_they_are_broken(tmp_path):
    assert [arm.name for arm in load_robot(robot(tmp_path)).arms] == ["left", "right"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot", "not well-formed XML (Couldn't find end of Start Tag robot line 1"),
        ("<robot><link name='a'></robot>", "not well-formed XML"),
        ("<sdf/>", "starts with <sdf>"),
        (f'<robot {XACRO}><xacro:include filename="x"/></robot>', "is a xacro file"),
        (f'<robot {XACRO}>{LINKS}<link name="${{x}}"/><xacro:a/></robot>', "is a xacro file"),
        (CIRCLE, "all links hang from each other in a loop"),
        (LONG, "has 101 joints in a row: give a robot of 100 at most"),
        (BOMB, "document type"),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot/>', "document type"),
        ('<robot><link name="a"/><link name="a"/></robot>', "'a' is there 2 times, in lines 1, 1"),
        ("<robot><link/></robot>", ", line 1: a link has no name"),
        (f"<robot>{LINKS}</robot>", "2 root links"),
        ("<robot/>", "0 root links"),
        (joined("fixed", "", '<parent link="a"/>'), "joint 'j' has the child link None"),
        (joined("fixed", "", '<parent link="a"/><child link="c"/>'), "has the child link 'c'"),
        (joined("hinge", ""), "type 'hinge'"),
        (f'<robot>{LINKS}<link name="c"/><joint name="j" type="fixed">{ENDS}</joint>'
         '<joint name="k" type="fixed"><parent link="c"/><child link="b"/></joint></robot>',
         "line 1: link 'b' is the child of more than one joint: keep one"),
        ('<robot><link name="a"><inertial><mass value="1"/><inertia ixx="-1" ixy="0" ixz="0" '
         'iyy="1" iyz="0" izz="1"/></inertial></link></robot>', "'a' has an inertia of -1 kg"),
        (joined("revolute", ""), "joint 'j', which is revolute, has no limits: give it a <limit>"),
        (joined("revolute", LIMIT.format(1, -1)), "limits (1, -1)"),
        (joined("revolute", LIMIT.format(-1, "inf")), "limit upper is 'inf'"),
        (joined("revolute", '<axis xyz="0 0 0"/>' + LIMIT.format(-1, 1)), "axis '0 0 0'"),
        (joined("fixed", '<origin xyz="0 nan 0"/>'), "origin xyz is '0 nan 0'"),
        (joined("fixed", '<origin rpy="0 0"/>'), "origin rpy is '0 0'"),
        (joined("fixed", '<origin xyz="0 1e300 0"/>'), "origin xyz is '0 1e300 0'"),
        ('<robot><link name="a"><collision><geometry><sphere radius="1e300"/></geometry>'
         "</collision></link></robot>", "sphere radius is '1e300'"),
        (joined("revolute", LIMIT.format("-1,", 1)), "limit lower is '-1,'"),
        (joined("revolute", LIMIT.format("-1 0", 1)), "give a finite number, of 2e+308 at most"),
        (joined("revolute", LIMIT.format("-2,17", 1)), "2e+308 at most, with a point"),
        (joined("fixed", '<origin xyz="0 0 0 0"/>'), "give three finite numbers, of 1e+06 at most"),
        ("<robot>" + "".join(f'<link name="l{i}"/>' for i in range(501)) + "</robot>",
         "has 501 links"),
        ('<robot><link name="root"/><link name="a"/><link name="b"/>'
         f'<joint name="i" type="fixed">{ENDS}</joint><joint name="j" type="fixed">'
         '<parent link="b"/><child link="a"/></joint></robot>', "loop"),
        ('<robot><link name="a"><collision><geometry><cone/></geometry></collision></link></robot>',
         "line 1: link 'a' has a collision with cone: give one of box, cylinder, sphere, capsule"),
        ('<robot><link name="a"><visual><geometry/></visual></link></robot>',
         "line 1: link 'a' has a visual with no shape: give one of"),
    ],
)  # fmt: skip
def test_broken_urdf(tmp_path, text, message):
    assert message in fails(load_urdf, robot(tmp_path, text))


def test_an_entity_is_never_read(tmp_path):
    (tmp_path / "secret").write_text("secret words")
    text = f'<!DOCTYPE r [<!ENTITY x SYSTEM "file://{tmp_path}/secret">]><robot name="&x;"/>'
    assert "secret words" not in fails(load_urdf, robot(tmp_path, text))


def test_binary_noise_and_too_long_a_file(tmp_path):
    path = tmp_path / "noise.urdf"
    path.write_bytes(bytes(range(256)))
    assert "not well-formed XML" in fails(load_urdf, path)
    path.write_bytes(b" " * 8_000_001)
    assert "larger than 8000000 bytes" in fails(load_urdf, path)


def test_no_file_and_a_folder(tmp_path):
    for load in (load_urdf, load_description):
        for path in (tmp_path / "none", tmp_path):
            assert f"{str(path)!r}, which is not a file" in fails(load, path)
    (tmp_path / "alone.urdf").write_text(TEXT)
    assert "robot.json" in fails(load_robot, tmp_path / "alone.urdf")


def test_a_joint_or_link_that_the_description_names_is_missing(tmp_path):
    message = fails(load_robot, robot(tmp_path, TEXT.replace('"torso_lift_joint"', '"lift"')))
    assert "no joint 'torso_lift_joint'" in message
    message = fails(load_robot, robot(tmp_path, TEXT.replace("l_gripper_tool_frame", "hand")))
    assert "no link 'l_gripper_tool_frame'" in message


def changed(**changes):
    return {**WORDS, **changes}


def arms(**changes):
    return changed(arms=[{**WORDS["arms"][0], **changes}])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("{", "not proper JSON"),
        ('{"name": "a", "name": "b"}', "key 'name' comes twice"),
        ("[" * 100_000, "not proper JSON"),
        ("[]", "the file is []"),
        ({k: v for k, v in WORDS.items() if k != "arms"}, "lacks the key 'arms'"),
        (changed(colour="red"), "unknown key 'colour'"),
        (changed(name=3), "name is 3"),
        (changed(footprint=[0, 1]), "footprint is [0, 1]"),
        (changed(footprint=[0, math.nan, 0, 1]), "number NaN is not finite"),
        (changed(footprint=[1, 0, 0, 1]), "footprint is [1, 0, 0, 1]"),
        (changed(footprint=[1, 1, 0, 1]), "footprint is [1, 1, 0, 1]"),
        (changed(footprint=[0, 1, 1, 0]), "footprint is [0, 1, 1, 0]"),
        (changed(footprint=[0, 1, 1, 1]), "footprint is [0, 1, 1, 1]"),
        (changed(torso_position=math.nan), "number NaN is not finite"),
        (changed(torso_position="high"), "torso_position is 'high'"),
        (changed(torso_position=True), "torso_position is True"),
        (changed(torso_position=10**400), "torso_position is 1"),
        (changed(torso_position=None), "torso_position is None"),
        (changed(torso_position=1e300), "of 1e+06 at most"),
        (changed(footprint=[-1e300, 1, -1, 1]), "of 1e+06 at most"),
        (changed(torso_position=0.5), "within its limits 0.0 to 0.33"),
        (changed(torso_joint="base_footprint_joint"), "fixed or follows another joint"),
        (changed(torso_joint="l_elbow_flex_joint", torso_position=-1.0), "moves an arm"),
        (changed(torso_joint=None, torso_position=None), "'torso_lift_joint' can move"),
        (changed(base_frame="floor"), "no link 'floor'"),
        (changed(base_frame="l_forearm_link"), "does not hang from 'l_forearm_link'"),
        (changed(arms=[]), "arms is []"),
        (changed(arms=[WORDS["arms"][0]] * 2), "each with its own name"),
        (changed(arms=["left"]), "arms[0] is 'left'"),
        (arms(reach=1), "arms[0] has the unknown key 'reach'"),
        (arms(tool_frame=""), "arms[0].tool_frame is ''"),
        (arms(tool_frame="head_pan_link", base_link="l_forearm_link"), "does not hang from"),
        (arms(tool_frame="torso_lift_link"), "has no joint between"),
        (arms(tool_frame="l_gripper_r_finger_link"),
         "mimic joint 'l_gripper_r_finger_joint', which follows 'l_gripper_l_finger_joint'"),
        (arms(base_link="l_shoulder_pan_link"), "'l_shoulder_pan_joint' can move"),
        (changed(body=["wheel"]), "no link 'wheel'"),
        (changed(body=["l_forearm_link"]), "body: joint 'l_shoulder_pan_joint' can move"),
        (changed(body="base_link"), "body is 'base_link'"),
        (changed(gripper_joints={"l_gripper_r_finger_joint": 0.1}), "follows another joint"),
        (changed(gripper_joints={"finger": 0.1}), "no joint 'finger'"),
        (changed(gripper_joints=[]), "gripper_joints is []"),
        (changed(home={"finger": 0.1}), "no joint 'finger'"),
        (changed(home={"torso_lift_joint": 0.1}), "moves no arm"),
        (changed(home={"l_elbow_flex_joint": 0.5}), "cannot be at 0.5 at home"),
        (changed(home={"l_elbow_flex_joint": "up"}), "home['l_elbow_flex_joint'] is 'up'"),
        (changed(home=[1.0]), "home is [1.0]"),
        (changed(capsules={"wing": [[0, 0, 0, 1, 0, 0, 0.1]]}), "no link 'wing'"),
        (changed(capsules={"l_forearm_link": [[0, 0, 0, 1, 0, 0, 0]]}), "radius above 0"),
        (changed(capsules={"l_forearm_link": [[0, 0, 0, 1]]}), "a list of 7 numbers"),
    ],
)  # fmt: skip
def test_bad_description(tmp_path, words, message):
    assert message in fails(load_robot, robot(tmp_path, words=words))


def test_a_mesh_needs_capsules(tmp_path):
    shape = '<cylinder radius="0.066" length="0.321"/>'
    text = TEXT.replace(shape, '<mesh filename="forearm.stl"/>')
    assert text != TEXT
    assert "forearm.stl', which is missing" in fails(load_robot, robot(tmp_path, text))
    capsules = {f"{s}_forearm_link": [[0.066, 0, 0, 0.255, 0, 0, 0.066]] for s in ("l", "r")}
    loaded = load_robot(robot(tmp_path, text, changed(capsules=capsules)))
    assert len(loaded.arms[0].solids) == len(load_robot().arms[0].solids)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        *(
            (f'<box size="{s}"/>', "of size 0.0 m: give it some")
            for s in ("0.3 0.2 0", "0 0.1 0.1")
        ),
        ('<cylinder radius="0.066" length="-0.321"/>', "a shape of size -0.321 m"),
    ],
)
def test_a_shape_of_an_impossible_size(tmp_path, shape, message):
    text = TEXT.replace('<cylinder radius="0.066" length="0.321"/>', shape)
    assert message in fails(load_robot, robot(tmp_path, text))


def test_limits_without_end_are_read_at_once(tmp_path):
    limits = 'lower="-0.8" upper="3.9"'
    text = re.sub("<safety_controller[^>]*/>", "", TEXT)
    assert limits in text
    text = text.replace(limits, 'lower="-1e300" upper="1e300"')
    assert load_robot(robot(tmp_path, text)).arms[0].closed_form is not None


def test_a_description_that_is_too_long_or_names_a_key_twice_among_many(tmp_path):
    path = tmp_path / "robot.json"
    path.write_text("x" * 1_000_001)
    assert "larger than 1000000 bytes" in fails(load_description, path)
    path.write_text(json.dumps({str(i): 0 for i in range(70_000)})[:-1] + ', "69999": 1}')
    assert "key '69999' comes twice" in fails(load_description, path)


def test_a_capsule_is_a_cylinder_and_two_spheres(tmp_path):
    origin = '<origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/>'
    shape = '<geometry><capsule radius="0.1" length="0.4"/></geometry>'
    parts = f"<collision>{origin}{shape}</collision><visual>{shape}</visual>"
    urdf = load_urdf(robot(tmp_path, f'<robot><link name="a">{parts}</link></robot>'))
    link = urdf.link("a")
    kinds = [
        next(k for k in ("sphere", "cylinder") if getattr(c.geometry, k)) for c in link.collisions
    ]
    assert kinds == ["sphere", "cylinder", "sphere"]
    places = [c.origin[:3, 3].round(9).tolist() for c in link.collisions]
    assert places == [[1, 2.2, 3], [1, 2, 3], [1, 1.8, 3]]
    assert (link.collisions[1].geometry.cylinder.length, len(link.visuals)) == (0.4, 3)
    bad = shape.replace("0.4", "nan")
    text = f'<robot><link name="a"><collision>{bad}</collision></link></robot>'
    assert "line 1: capsule length is 'nan'" in fails(load_urdf, robot(tmp_path, text))


def test_a_limit_with_one_number_has_nought_as_the_other_as_the_format_says(tmp_path):
    for given, wanted in (('upper="2"', (0, 2)), ('lower="-1"', (-1, 0)), ("", (None, None))):
        text = joined("revolute", f'<limit {given} effort="1" velocity="1"/>')
        limit = load_urdf(robot(tmp_path, text)).joint("j").limit
        assert (limit.lower, limit.upper) == wanted


def test_prefixes_that_nothing_declares_and_commas_are_read_as_ros_reads_them(tmp_path):
    inside = '<origin xyz="1, 2,3" rpy="0, 0, 0"/><a:b/>' + LIMIT.format(-1, 1)
    text = joined("revolute", inside.replace("effort", 'drake:acceleration="9" effort'))
    urdf = load_urdf(robot(tmp_path, text.replace("<robot>", f"<robot {XACRO}><xacro:old/>")))
    assert urdf.joint("j").origin[:3, 3].tolist() == [1, 2, 3]
    assert b":b" not in urdf.xml
    assert b"drake" not in urdf.xml
    assert "not well-formed" in fails(load_urdf, robot(tmp_path, text.replace("</robot>", "")))


def test_an_axis_may_be_short_but_needs_a_direction(tmp_path):
    limits = LIMIT.format(-1, 1)
    urdf = load_urdf(robot(tmp_path, joined("revolute", f'<axis xyz="0 6e-9 -8e-9"/>{limits}')))
    assert urdf.joint("j").axis.tolist() == pytest.approx([0, 0.6, -0.8])
    urdf = load_urdf(robot(tmp_path, joined("revolute", f'<axis xyz="1.1e-9 0 0"/>{limits}')))
    assert urdf.joint("j").axis.tolist() == [1, 0, 0]
    short = joined("revolute", f'<axis xyz="0 9e-10 0"/>{limits}')
    assert "has the axis '0 9e-10 0': give it" in fails(load_urdf, robot(tmp_path, short))


def test_lines_are_told(tmp_path):
    for text, message in (
        (
            f"<robot>\n{LINKS}\n" + '<joint name="j" type="fixed"/></robot>',
            "line 3: joint 'j' has the",
        ),
        ('<robot>\n<link name="a"/>\n<link name="a"/></robot>', "lines 2, 3: keep one, or rename"),
    ):
        assert message in fails(load_urdf, robot(tmp_path, text))


def test_what_says_nothing_is_left_out(tmp_path):
    text = '<robot name="x">\n  <!-- a robot --><?made by="hand"?>\n  <link name="a"/>\n</robot>'
    assert load_urdf(robot(tmp_path, text)).xml == b'<robot name="x"><link name="a"/></robot>'


def test_an_error_without_words_is_told_by_its_name():
    assert one_line(ValueError("two\n words")) == "two words"
    assert one_line(ValueError()) == "ValueError"


@pytest.mark.parametrize(
    ("limits", "rest"), [((0.5, 1), 0.5), ((-1, -0.2), -0.2), ((-1, 1), 0.0), ((0, 0), 0.0)]
)
def test_a_joint_rests_as_near_to_nought_as_it_can(tmp_path, limits, rest):
    urdf = load_urdf(robot(tmp_path, joined("prismatic", LIMIT.format(*limits))))
    assert at_rest(urdf.joint("j")) == rest
    turning = load_urdf(robot(tmp_path, joined("continuous", LIMIT.format(1, 2))))
    assert at_rest(turning.joint("j")) == 0.0
    free = load_urdf(robot(tmp_path, joined("floating", "")))
    assert at_rest(free.joint("j")) == 0.0


def test_only_what_may_be_deep_is_read_if_it_is() -> None:
    deep = b"<a>" * 300 + b"</a>" * 300
    with pytest.raises(RobotError, match="file is not well-formed XML"):
        parsed(deep, "file")
    assert parsed(deep, "file", huge=True).tag == "a"
