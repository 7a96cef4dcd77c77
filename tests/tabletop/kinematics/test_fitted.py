"""A URDF without its meshes: shapes that hold them, in files that need no other."""

import shutil

import mesh_robot
import numpy as np
import pytest
import trimesh
from points_outside import outside, shapes_of

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.fitted import without_meshes

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
