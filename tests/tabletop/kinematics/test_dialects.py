"""What URDFs write that the format does not have, and what they leave out."""

import pytest

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.urdf import read_urdf

ROBOT = (
    '<robot><link name="a"><visual><geometry><box size="1 1 1"/></geometry>{}</visual></link>'
    '<link name="b"/><joint name="j" type="{}"><parent link="a"/><child link="b"/>{}</joint>'
    "</robot>"
)


def read(tmp_path, colour="", kind="revolute", limit='<limit lower="0" upper="1"/>'):
    (tmp_path / "a.urdf").write_text(ROBOT.format(colour, kind, limit))
    return load_urdf(tmp_path / "a.urdf").model


@pytest.mark.parametrize(
    ("rgba", "read_as"),
    [
        ("0 0.5 1 1", [0, 0.5, 1, 1]),
        ("255 0 0 1", None),
        ("-0.1 0 0 1", None),
        ("1 1 1", None),
        ("1 1 1 1 1", None),
        ("1,1,1,1", None),
        ("a b c d", None),
        ("nan 0 0 1", None),
        ("", None),
        (None, None),
    ],
)
def test_what_is_no_colour_is_left_out(tmp_path, rgba, read_as):
    given = "" if rgba is None else f'rgba="{rgba}"'
    colour = f'<material name="m"><color {given}/></material>'
    found = read(tmp_path, colour).robot.links[0].visuals[0].material.color
    assert (found if found is None else found.rgba.tolist()) == read_as


@pytest.mark.parametrize(
    ("shape", "kept"),
    [
        ('<box size="0 0 0"/>', False),
        ('<box size="0 0 0.1"/>', True),
        ('<sphere radius="0.0"/>', False),
        ('<cylinder radius="0" length="0"/>', False),
        ('<cylinder radius="0.1" length="0"/>', True),
        ('<mesh filename="a.stl"/>', True),
    ],
)
def test_a_shape_without_any_size_is_left_out(tmp_path, shape, kept):
    parts = f"</visual><collision><geometry>{shape}</geometry></collision><visual>"
    parts += f"<geometry>{shape}</geometry>"
    link = read(tmp_path, parts).robot.links[0]
    assert (len(link.collisions), len(link.visuals)) == (kept, 1 + kept)


def test_limits_are_nought_where_they_are_not_given(tmp_path):
    def limit(*words):
        found = read(tmp_path, "", *words).joint_map["j"].limit
        return found.lower, found.upper, found.effort, found.velocity

    assert limit() == (0, 1, 0, 0)
    assert limit("prismatic", '<limit upper="2" velocity="3"/>') == (0, 2, 0, 3)
    assert limit("continuous", '<limit effort="4"/>') == (None, None, 4, 0)


def test_a_joint_that_turns_and_whose_limit_has_no_ends_is_continuous(tmp_path):
    def joint(kind):
        return read(tmp_path, "", kind, '<limit effort="4" velocity="3"/>').joint_map["j"]

    turning, sliding = joint("revolute"), joint("prismatic")
    assert (turning.type, turning.limit.effort) == ("continuous", 4)
    assert (sliding.type, sliding.limit.lower, sliding.limit.upper) == ("prismatic", 0, 0)
    joint("revolute")
    notes = list[str]()
    read_urdf(tmp_path / "a.urdf", notes)
    assert notes == ["joint 'j' has no limits and is taken for continuous"]


def test_limits_that_are_infinite_are_none(tmp_path):
    every = '<limit lower="-inf" upper="inf" effort="inf" velocity="2"/>'
    for kind in ("revolute", "continuous"):
        joint = read(tmp_path, "", kind, every).joint_map["j"]
        assert joint.type == "continuous"
        limit = joint.limit
        assert (limit.lower, limit.upper, limit.effort, limit.velocity) == (None, None, 0, 2)
    for kind, ends in (("revolute", 'lower="0" upper="inf"'), ("prismatic", every[7:32])):
        with pytest.raises(RobotError, match="give a finite number"):
            read(tmp_path, "", kind, f"<limit {ends}/>")


@pytest.mark.parametrize("name", ["", ' name=""'])
def test_a_robot_without_a_name_is_called_robot(tmp_path, name):
    (tmp_path / "a.urdf").write_text(f'<robot{name}><link name="a"/></robot>')
    assert load_urdf(tmp_path / "a.urdf").model.robot.name == "robot"


def test_a_default_namespace_is_no_part_of_the_names(tmp_path):
    text = ROBOT.format("", "revolute", '<limit lower="0" upper="1"/>')
    named = text.replace("<robot>", '<robot xmlns="http://ros.org" xmlns:g="http://g"><g:own/>')
    (tmp_path / "a.urdf").write_text(named)
    read = load_urdf(tmp_path / "a.urdf")
    assert [link.name for link in read.model.robot.links] == ["a", "b"]
    assert b"<link " in read.xml
    (tmp_path / "a.urdf").write_text('<sdf xmlns="http://ros.org"/>')
    with pytest.raises(RobotError, match="give a file that starts with <robot>"):
        load_urdf(tmp_path / "a.urdf")
