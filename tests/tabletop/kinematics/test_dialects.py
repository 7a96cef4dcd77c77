"""What URDFs write that the format does not have, and what they leave out."""

import pytest

from cgtorch.tabletop.kinematics import load_urdf

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
    ],
)
def test_what_is_no_colour_is_left_out(tmp_path, rgba, read_as):
    colour = f'<material name="m"><color rgba="{rgba}"/></material>'
    found = read(tmp_path, colour).robot.links[0].visuals[0].material.color
    assert (found if found is None else found.rgba.tolist()) == read_as


def test_limits_are_nought_where_they_are_not_given(tmp_path):
    def limit(*words):
        found = read(tmp_path, "", *words).joint_map["j"].limit
        return found.lower, found.upper, found.effort, found.velocity

    assert limit() == (0, 1, 0, 0)
    assert limit("prismatic", '<limit upper="2" velocity="3"/>') == (0, 2, 0, 3)
    assert limit("continuous", '<limit effort="4"/>') == (None, None, 4, 0)
