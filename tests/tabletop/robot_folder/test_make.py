"""A robot folder from the meshes of a package: it loads without them, and its robot can grasp."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import mesh_robot
import numpy as np
import pytest
import torch
from lxml import etree
from matplotlib.colors import to_hex

from cgtorch.ground.errors import RobotError, RunError
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import graspable, load_robot, load_urdf
from cgtorch.tabletop.kinematics.description import Arm, RobotDescription
from cgtorch.tabletop.kinematics.fitted import MeshFit
from cgtorch.tabletop.kinematics.shapes import Fit, Shape
from cgtorch.tabletop.kinematics.urdf import inertial_problem, read_urdf
from cgtorch.tabletop.robot_folder import make
from cgtorch.tabletop.robot_folder.make import (
    ARMS,
    AXIS,
    BODY,
    REST,
    _at_home,
    _with_semantics,
    make_robot_folder,
    robot_picture,
)
from cgtorch.tabletop.robot_folder.proposal import Wishes
from cgtorch.tabletop.robot_folder.srdf import Semantics
from cgtorch.tabletop.settings import TabletopSettings


@pytest.fixture
def urdf(tmp_path):
    return mesh_robot.write_package(tmp_path / "ws")


def listing(folder):
    return sorted(path.name for path in folder.iterdir())


def test_limits_in_the_wrong_order_are_turned_round_and_told(urdf, tmp_path):
    before = etree.tostring(read_urdf(urdf))
    text = urdf.read_text()
    urdf.write_text(text.replace('lower="-0.6" upper="1.4"', 'lower="1.4" upper="-0.6"'))
    with pytest.raises(RobotError, match="give lower <= upper"):
        read_urdf(urdf)
    notes = []
    assert etree.tostring(read_urdf(urdf, notes)) == before
    assert notes == ["joint 'lift_joint' has the limits (1.4, -0.6), which are turned round"]
    assert notes[0] in make_robot_folder(urdf, tmp_path / "mine").notes


def test_a_folder_is_made_and_serves_without_the_meshes(urdf, tmp_path):
    made = make_robot_folder(urdf, tmp_path / "mine")
    shutil.rmtree(tmp_path / "ws")
    assert listing(tmp_path / "mine") == ["robot.json", "robot.png", "robot.urdf", "shapes.json"]
    assert listing(tmp_path) == ["mine"]
    robot = load_robot(description=tmp_path / "mine")
    assert robot.meshes == ()
    assert robot.description == made.robot.description
    assert robot.arms[0].closed_form is not None
    assert set(robot.description.home) == set(robot.arms[0].joint_names)
    assert (tmp_path / "mine" / "robot.png").read_bytes().startswith(b"\x89PNG")
    told = json.loads((tmp_path / "mine" / "shapes.json").read_text())
    assert [each["link"] for each in told][:2] == ["base_link", "torso_link"]
    assert all(0.4 < each["ratio"] < 1.35 and each["shapes"] for each in told)
    x0, x1, y0, y1 = robot.description.footprint
    np.testing.assert_allclose([x0, x1, y0, y1], [-0.25, 0.25, -0.23, 0.23], atol=0.0015)
    edge = x1 + 0.05
    objects = torch.tensor(
        [[edge + 0.1, 0.0, 0.75], [edge + 0.2, 0.2, 0.75], [edge + 3, 0.0, 0.75]]
    )
    table = torch.tensor([edge + 2, 0.0, 0.0, 4.0, 2.0, 0.75]).expand(3, 6)
    assert graspable(robot, objects, table).tolist() == [True, True, False]
    assert int(made.reached.grasps.sum()) >= 6


@pytest.mark.hostile
def test_a_run_carries_the_robot_without_the_meshes(urdf, tmp_path, monkeypatch):
    make_robot_folder(urdf, tmp_path / "mine")
    words = tmp_path / "words.json"
    content = json.loads((tmp_path / "mine" / "robot.json").read_text())
    content["arms"][0]["tool_frame"] = "hand_link"
    words.write_text(json.dumps({**content, "base_frame": "base_link"}))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    elsewhere = shutil.copy(urdf, tmp_path / "elsewhere.urdf")
    settings = TabletopSettings(urdf=str(elsewhere), robot=str(words))
    domain = Tabletop(settings)
    assert domain.robot.meshes
    (tmp_path / "run").mkdir()
    domain.files(domain).write(tmp_path / "run")
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    shutil.rmtree(tmp_path / "ws")
    again = Tabletop.files.read(Tabletop, settings, tmp_path / "run").robot
    assert again.meshes == ()
    for name in ("pose", "size", "frame"):
        mine, other = (getattr(r.arms[0].solids, name) for r in (domain.robot, again))
        torch.testing.assert_close(mine, other, rtol=0, atol=0)
    with pytest.raises(RobotError, match=r"which is missing: the package 'mesh_robot' is in none"):
        Tabletop(settings)


def test_masses_that_no_body_has_are_made_up_and_told(urdf, tmp_path):
    text = urdf.read_text()
    text = text.replace('ixx="0.01"', 'ixx="-0.01"', 1)  # of the base
    head, tail = text.split('<link name="roll_link">')
    tail = tail.replace('<mass value="1"/>', '<mass value="0"/>', 1)
    first, last = tail.split('<link name="left_finger">')
    urdf.write_text(
        head + '<link name="roll_link">' + first + '<link name="left_finger">'
        + last.replace('izz="0.01"', 'izz="0.1"', 1)
    )  # fmt: skip
    with pytest.raises(RobotError, match=r"link 'base_link' has an inertia of -0.01 kg"):
        load_urdf(urdf)
    made = make_robot_folder(urdf, tmp_path / "mine")
    assert set(made.inertials) == {"base_link", "roll_link", "left_finger"}
    for link in made.robot.urdf.model.robot.links:
        assert not inertial_problem(link)
        if link.name in made.inertials:
            moments = np.linalg.eigvalsh(link.inertial.inertia)
            assert 0 < moments[0] <= moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)
            assert link.inertial.mass > 0


@pytest.mark.parametrize("mass", ["-1", "nan", "1e300"])
def test_a_mass_that_is_none(urdf, mass):
    urdf.write_text(urdf.read_text().replace('<mass value="1"/>', f'<mass value="{mass}"/>', 1))
    with pytest.raises(RobotError, match=f"mass (-1.0 kg|value is '{mass}')"):
        load_urdf(urdf)


def test_nothing_is_left_where_it_fails(urdf, tmp_path):
    with pytest.raises(RobotError) as caught:
        make_robot_folder(urdf, tmp_path / "mine", Wishes(footprint=(1.0, 0.0, 0.0, 1.0)))
    assert f"{str(tmp_path / 'mine' / 'robot.json')!r}" in str(caught.value)
    with pytest.raises(RunError, match="cannot write"):
        make_robot_folder(urdf, tmp_path / "none" / "mine")
    (urdf.parents[1] / "meshes" / "palm.stl").write_text("solid")
    with pytest.raises(RobotError, match=r"palm\.stl"):
        make_robot_folder(urdf, tmp_path / "mine")
    assert listing(tmp_path) == ["ws"]


def test_a_picture_shows_arms_footprint_and_tools_from_three_sides(monkeypatch):
    drawn = []

    class Canvas:
        def __init__(self, figure):
            drawn.append(figure)

        def print_png(self, file):
            file.write(b"drawn")

    monkeypatch.setattr(make, "FigureCanvasAgg", Canvas)
    robot = load_robot()
    assert robot_picture(robot) == b"drawn"
    right, front, above = drawn[0].axes
    assert drawn[0].get_suptitle() == "PR2"
    for axes, view, names in (
        (right, "from the right", "xz"), (front, "from the front", "yz"),
        (above, "from above", "xy"),
    ):  # fmt: skip
        assert axes.get_title() == view
        assert (axes.get_xlabel(), axes.get_ylabel()) == tuple(f"{name} [m]" for name in names)
        assert axes.get_aspect() == 1
        colours = {to_hex(patch.get_facecolor()) for patch in axes.patches}
        assert colours == {REST, BODY, *ARMS[:2]}
        assert {patch.get_alpha() for patch in axes.patches} == {0.35}
        assert {patch.get_linewidth() for patch in axes.patches} == {1}
        assert [line.get_linewidth() for line in axes.lines] == [1, *[2] * 3 * len(robot.arms)]
    x0, x1, y0, y1 = robot.description.footprint
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    assert above.lines[0].get_xydata().tolist() == ring
    assert set(right.lines[0].get_ydata().tolist()) == {0.0}
    model = robot.urdf.model
    after = model.cfg.copy()
    model.update_cfg(robot.description.held)
    np.testing.assert_array_equal(model.cfg, after)
    model.update_cfg(_at_home(robot))
    pose = model.get_transform(robot.description.arms[0].tool_frame, robot.description.base_frame)
    model.update_cfg(robot.description.held)
    for axis, colour in enumerate(("red", "green", "blue")):
        line = above.lines[1 + axis]
        assert line.get_color() == colour
        ends = pose[:2, 3], pose[:2, 3] + AXIS * pose[:2, axis]
        np.testing.assert_allclose(line.get_xydata(), ends, atol=1e-9)


def test_corners_are_those_of_meshes_of_links_that_collide_as_nothing_else():
    mesh, box = (SimpleNamespace(geometry=SimpleNamespace(mesh=m)) for m in ("a.stl", None))
    links = {"one": [mesh, mesh], "two": [mesh, box]}
    urdf = SimpleNamespace(link=lambda name: SimpleNamespace(collisions=links[name]))
    fit = SimpleNamespace(corners=np.array([[1.0, 2.0, 3.0]]))
    turned = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]])

    def found(link, kind="collision", fitted=fit):
        return SimpleNamespace(link=link, kind=kind, fit=fitted, pose=turned)

    meshes = (
        found("one"), found("one"), found("two"), found("one", "visual"), found("one", fitted=None)
    )  # fmt: skip
    corners = make._corners(urdf, meshes)
    assert corners.keys() == {"one"}
    assert [each.tolist() for each in corners["one"]] == [[[8, 21, 33]]] * 2


def test_shapes_are_recorded_in_their_links_frames_with_volumes():
    pose, own = np.eye(4), np.eye(4)
    pose[:3, :3], own[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3]
    shapes = Shape("box", own, (1.0, 2.0, 3.0)), Shape("box", own, (1.0, 1.0, 2.0))
    fit = Fit(shapes, np.zeros((8, 3)), 4.0)
    found = make._record(MeshFit("hand", "a.stl", "collision", pose, fit))
    assert {key: value for key, value in found.items() if key != "shapes"} == {
        "link": "hand", "file": "a.stl", "kind": "collision", "volume": 8.0,
        "convex_hull_volume": 4.0, "ratio": 2.0,
    }  # fmt: skip
    first, other = found["shapes"]
    assert (first["kind"], first["sizes"], other["sizes"]) == ("box", [1, 2, 3], [1, 1, 2])
    assert [row[3] for row in first["pose"]] == [-2, 1, 3, 1]
    lost = MeshFit("hand", "a.stl", "visual", pose, None, "it is missing")
    assert make._record(lost) == {
        "link": "hand", "file": "a.stl", "kind": "visual", "problem": "it is missing"
    }  # fmt: skip


def test_a_description_is_written_without_empty_parts_that_may_be_left_out():
    arm = Arm("a", "base", "tip")
    plain = RobotDescription("x", "base", (-1.0, 1.0, -1.0, 1.0), (arm,), None, None)
    assert make._as_json(plain) == {
        "name": "x", "base_frame": "base", "footprint": (-1.0, 1.0, -1.0, 1.0),
        "arms": [{"name": "a", "base_link": "base", "tool_frame": "tip"}], "torso_joint": None,
        "torso_position": None, "body": (), "excludes": (),
    }  # fmt: skip
    full = replace(plain, home={"j": 0.0}, gripper_joints={"f": 0.1}, body=("base",))
    found = make._as_json(full)
    assert (found["home"], found["gripper_joints"], found["body"]) == (
        {"j": 0.0}, {"f": 0.1}, ("base",)
    )  # fmt: skip
    assert "gains" not in found


def test_what_an_srdf_says_yields_to_wishes():
    arm, other = Arm("a", "base", "tip"), Arm("b", "base", "end")
    said = Semantics((arm,), {"j": 0.1}, {"f": 0.2, "g": 0.3}, (("p", "q"),))
    plain = _with_semantics(Wishes(stand=0.5), said)
    assert (plain.groups, plain.home, plain.held) == ((arm,), {"j": 0.1}, {"f": 0.2, "g": 0.3})
    assert (plain.excludes, plain.stand) == ((("p", "q"),), 0.5)
    wished = Wishes(home={"j": 1.0}, held={"f": 2.0}, excludes=(("r", "s"),))
    both = _with_semantics(wished, said)
    assert (both.home, both.held) == ({"j": 1.0}, {"f": 2.0, "g": 0.3})
    assert both.excludes == (("r", "s"),)
    named = _with_semantics(Wishes(arms=(other,)), said)
    assert named == Wishes(arms=(other,), excludes=(("p", "q"),))
    assert _with_semantics(Wishes(arms=(other,), excludes=(("r", "s"),)), said).excludes == (
        ("r", "s"),
    )
