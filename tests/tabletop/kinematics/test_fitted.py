"""A URDF without its meshes: shapes that hold them, in files that need no other."""

import shutil

import mesh_robot
import numpy as np
import pytest
import trimesh
from lxml import etree
from points_outside import outside, shapes_of
from trimesh import transformations

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.fitted import _elements, _Reader, without_meshes
from cgtorch.tabletop.kinematics.origins import pose_of
from cgtorch.tabletop.kinematics.shapes import Shape

MESHES = mesh_robot.meshes()


@pytest.fixture
def urdf(tmp_path):
    return mesh_robot.write_package(tmp_path)


def test_every_mesh_lies_inside_the_shapes_of_its_link(urdf):
    read = load_urdf(urdf)
    plain, fits = without_meshes(read)
    assert b"mesh filename" not in plain.xml
    assert {fit.link for fit in fits} == {
        link.name for link in read.model.robot.links if link.collisions
    }
    for fit in fits:
        mesh = MESHES[fit.file.rpartition("/")[2]]
        points = [mesh.vertices, trimesh.sample.sample_surface(mesh, 2000, seed=0)[0]]
        shapes = list(shapes_of(plain.link(fit.link)))
        for each in points:
            away = np.min([outside(shape, each) for shape in shapes], axis=0)
            assert away.max() < 1e-6  # STL has single precision
        assert 0.4 < fit.fit.ratio < 1.35
    assert fits[1].fit.ratio < 0.9  # the torso, which is a corner
    assert [v.geometry.mesh for link in plain.model.robot.links for v in link.visuals].count(
        None
    ) == sum(len(link.visuals) for link in plain.model.robot.links)


def test_what_is_written_needs_no_mesh_and_stays_the_same(urdf, tmp_path):
    plain, _ = without_meshes(load_urdf(urdf))
    (tmp_path / "plain.urdf").write_bytes(plain.xml)
    shutil.rmtree(urdf.parents[1])
    again, fits = without_meshes(load_urdf(tmp_path / "plain.urdf"))
    assert again.xml == plain.xml
    assert fits == ()


def test_a_missing_mesh_is_one_error_that_names_it_and_the_places(urdf, tmp_path):
    (urdf.parents[1] / "meshes" / "upper.stl").unlink()
    with pytest.raises(RobotError) as caught:
        without_meshes(load_urdf(urdf), [tmp_path])
    assert "package://mesh_robot/meshes/upper.stl', which is missing" in str(caught.value)
    assert str(urdf.parents[1]) in str(caught.value)


def test_capsules_that_are_given_take_the_place_of_a_mesh(urdf):
    (urdf.parents[1] / "meshes" / "upper.stl").unlink()
    plain, fits = without_meshes(
        load_urdf(urdf), capsules={"roll_link": [(0.1, 0, 0, 0.3, 0, 0, 0.06)]}
    )
    assert "roll_link" not in {fit.link for fit in fits}
    kinds = [shape.kind for shape in shapes_of(plain.link("roll_link"))]
    assert kinds == ["cylinder", "sphere", "sphere"]


def test_what_only_is_seen_may_be_missing(urdf):
    text = urdf.read_text()
    start = text.index("<collision>")
    end = text.index("</collision>") + len("</collision>")
    urdf.write_text(text[:start] + text[end:])
    plain, fits = without_meshes(load_urdf(urdf))
    assert (fits[0].link, fits[0].kind, fits[0].problem) == ("base_link", "visual", "")
    assert plain.link("base_link").visuals[0].geometry.box is not None
    (urdf.parents[1] / "meshes" / "base.stl").unlink()
    plain, fits = without_meshes(load_urdf(urdf))
    assert fits[0].fit is None
    assert "which is missing" in fits[0].problem
    assert plain.link("base_link").visuals == []


def test_a_urdf_without_meshes_is_left_as_it_is(urdf):
    from cgtorch.tabletop.kinematics import robots_folder

    read = load_urdf(robots_folder() / "pr2" / "pr2.urdf")
    assert without_meshes(read) == (read, ())


@pytest.mark.parametrize("scale", ["nan nan nan", "1e300 1 1", "1 2", "a b c", "inf"])
def test_a_scale_that_is_none(urdf, scale):
    urdf.write_text(urdf.read_text().replace("0.001 0.001 0.001", scale))
    with pytest.raises(RobotError):
        without_meshes(load_urdf(urdf))


def test_a_shape_is_written_with_its_place_and_sizes():
    (box,) = _elements("collision", Shape("box", np.eye(4), (0.1, 0.2, 0.3)))
    assert (box.tag, box.find("geometry/box").get("size")) == ("collision", "0.1 0.2 0.3")
    pose = transformations.euler_matrix(0.1, -0.2, 0.3, "sxyz")
    pose[:3, 3] = 1, 2, 3
    (cylinder,) = _elements("visual", Shape("cylinder", pose, (0.1, 0.5)))
    read = cylinder.find("geometry/cylinder")
    assert (read.get("radius"), read.get("length")) == ("0.1", "0.5")
    np.testing.assert_allclose(pose_of(cylinder), pose, atol=1e-8)
    assert cylinder.find("origin").get("xyz") == "1.0 2.0 3.0"
    middle, *ends = _elements("collision", Shape("capsule", pose, (0.1, 0.5)))
    assert middle.find("geometry/cylinder").get("length") == "0.5"
    for end, z in zip(ends, (-0.25, 0.25), strict=True):
        assert end.find("geometry/sphere").get("radius") == "0.1"
        place = pose @ transformations.translation_matrix([0, 0, z])
        np.testing.assert_allclose(pose_of(end)[:3, 3], place[:3, 3], atol=1e-8)
    np.testing.assert_array_equal(pose_of(etree.Element("visual")), np.eye(4))


def test_a_file_is_fitted_once_for_each_scale(urdf, monkeypatch):
    fits = list[tuple[str, list[float]]]()

    def read(path, scale):
        fits.append((path.name, scale))
        return trimesh.creation.box((0.1, 0.1, 0.1))

    monkeypatch.setattr("cgtorch.tabletop.kinematics.fitted.read_mesh", read)
    reader = _Reader(urdf, (), {})
    mesh = [etree.Element("mesh", filename="package://mesh_robot/meshes/pan.obj") for _ in "abcd"]
    for each, scale in zip(mesh[1:], ("1 1 1", "0.5", "1, 2 3"), strict=True):
        each.set("scale", scale)
    one, same, half, odd = map(reader.fit, mesh)
    assert one is same
    assert len({id(one), id(half), id(odd)}) == 3
    assert fits == [("pan.obj", [1, 1, 1]), ("pan.obj", [0.5] * 3), ("pan.obj", [1, 2, 3])]


def test_more_meshes_than_a_robot_has_are_refused(urdf, monkeypatch):
    read = load_urdf(urdf)
    count = read.xml.count(b"<mesh ")
    monkeypatch.setattr("cgtorch.tabletop.kinematics.fitted.MAX_MESHES", count - 1)
    with pytest.raises(RobotError, match=f"has more than {count - 1} meshes: give fewer"):
        without_meshes(read)
