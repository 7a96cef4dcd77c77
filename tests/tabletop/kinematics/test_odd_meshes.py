"""Meshes that a URDF names on another machine or as a model, or whose files lack something."""

import pytest
import trimesh

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import load_urdf
from cgtorch.tabletop.kinematics.fitted import without_meshes
from cgtorch.tabletop.kinematics.meshes import NoGeometryError, file_named, read_mesh

BOX = trimesh.creation.box((0.3, 0.2, 0.1))
ELSEWHERE = "/nowhere/at/all/src/hand/meshes/palm.stl"
EMPTY = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>'
    '<library_geometries/><library_visual_scenes><visual_scene id="s"><node id="n"/>'
    '</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
    "</COLLADA>"
)


def test_a_material_that_is_not_there_takes_no_triangles_away(tmp_path):
    text = BOX.export(file_type="dae").decode()
    begin = text.index('target="#')
    end = text.index('"', begin + 8)
    (tmp_path / "box.dae").write_text(f'{text[:begin]}target="#none{text[end:]}')
    assert len(read_mesh(tmp_path / "box.dae").faces) == 12


def test_a_mesh_without_geometry_is_left_out_and_told(tmp_path):
    (tmp_path / "a.dae").write_text(EMPTY)
    with pytest.raises(NoGeometryError, match="has no geometry"):
        read_mesh(tmp_path / "a.dae")
    mesh = '<{0}><geometry><mesh filename="a.dae"/></geometry></{0}>'
    path = tmp_path / "robot.urdf"
    shape = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    parts = f"{mesh.format('collision')}{mesh.format('visual')}{shape}"
    path.write_text(f'<robot name="x"><link name="one">{parts}</link></robot>')
    plain, fits = without_meshes(load_urdf(path))
    assert [(each.kind, each.fit) for each in fits] == [("collision", None)]
    assert fits[0].problem.endswith("a.dae' has no geometry")
    assert len(plain.link("one").collisions) == 1


def test_a_file_of_another_machine_is_said_not_to_be_on_this_one(tmp_path):
    with pytest.raises(RobotError, match=r"is not on this machine: change its path in the URDF"):
        file_named(ELSEWHERE, tmp_path / "robot.urdf", ())


@pytest.mark.parametrize("at", ["palm.stl", "meshes/palm.stl", "hand/meshes/Palm.STL"])
def test_a_file_of_another_machine_is_found_by_the_end_of_its_path(tmp_path, at):
    place = tmp_path / "place"
    (place / at).parent.mkdir(parents=True, exist_ok=True)
    (place / "palm.stl").write_bytes(b"")
    (place / at).write_bytes(b"")
    urdf = tmp_path / "urdf" / "robot.urdf"
    for name in (ELSEWHERE, f"file://{ELSEWHERE}"):
        assert file_named(name, urdf, [tmp_path / "other", place]) == place / at


def test_a_file_of_this_machine_is_not_read_unless_its_folder_is_given(tmp_path):
    for name in ("out/palm.stl", "place/palm.stl"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(RobotError, match="move it there, or give its folder"):
        file_named(str(tmp_path / "out/palm.stl"), tmp_path / "u/r.urdf", [tmp_path / "place"])


def test_a_model_is_a_package(tmp_path):
    (tmp_path / "hand" / "meshes").mkdir(parents=True)
    (tmp_path / "hand" / "meshes" / "a.stl").write_bytes(b"")
    found = file_named("model://hand/meshes/a.stl", tmp_path / "robot" / "m.urdf", [tmp_path])
    assert found == tmp_path / "hand" / "meshes" / "a.stl"
