"""Mesh files: where packages have them, what is in them, and one RobotError about what is wrong."""

import io
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import trimesh
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import meshes
from cgtorch.tabletop.kinematics.meshes import file_named, package_places, read_mesh

BOX = trimesh.creation.box((0.3, 0.2, 0.1))
PLY = BOX.export(file_type="ply")[:-1]


def test_a_ply_alone_has_a_limit_on_lines(tmp_path, monkeypatch):
    text = BOX.export(file_type="ply", encoding="ascii")
    monkeypatch.setattr(meshes, "MAX_LINES", text.count(b"\n"))
    for name, data in (("a.ply", text), ("a.obj", BOX.export(file_type="obj") + "\n" * 99)):
        path = tmp_path / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        assert len(read_mesh(path).faces) == 12
    assert "write it as a binary PLY" in refused(tmp_path / "b.ply", text + b"\n")


def test_a_texture_that_a_ply_names_is_not_looked_for(tmp_path, caplog):
    data = BOX.export(file_type="ply").replace(b"comment", b"comment TextureFile a.png\ncomment", 1)
    (tmp_path / "a.ply").write_bytes(data)
    assert len(read_mesh(tmp_path / "a.ply").faces) == 12
    assert not caplog.records


def refused(path, data):
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(RobotError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("box.stl", {}),
        ("BOX.STL", {}),
        ("text.stl", {"file_type": "stl_ascii"}),
        ("box.obj", {}),
        ("box.dae", {}),
        ("box.ply", {}),
        ("box.glb", {}),
        ("text.ply", {"encoding": "ascii"}),
    ],
)
def test_each_format_and_its_scale(tmp_path, name, options):
    data = BOX.export(**{"file_type": name[-3:].lower(), **options})
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    mesh = read_mesh(tmp_path / name, (2.0, 1.0, -0.5))
    np.testing.assert_allclose(mesh.extents, [0.6, 0.2, 0.05], atol=1e-7)
    assert len(mesh.faces) == 12


def test_the_unit_of_a_dae_counts_and_its_upward_axis_does_not(tmp_path):
    text = BOX.export(file_type="dae").decode()
    unit = '<unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis>'
    assert "<up_axis>Y_UP</up_axis>" in text
    (tmp_path / "box.dae").write_text(text.replace("<up_axis>Y_UP</up_axis>", unit))
    mesh = read_mesh(tmp_path / "box.dae")
    np.testing.assert_allclose(mesh.extents, [0.003, 0.002, 0.001], atol=1e-9)


def test_points_that_no_triangle_has_do_not_count(tmp_path):
    (tmp_path / "box.obj").write_text("v 99 99 99\n" + "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 2 3 4\n")
    np.testing.assert_allclose(read_mesh(tmp_path / "box.obj").extents, [1, 1, 0])


def test_materials_and_their_files_are_not_read(tmp_path):
    (tmp_path / "secret.mtl").write_text("newmtl m\nmap_Kd secret.png\n")
    text = "mtllib secret.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(text)
    assert len(read_mesh(tmp_path / "a.obj").faces) == 1


NODES = "".join(
    f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>'
    for i in range(40)
)
COLLADA = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>{}'
    '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
)
BOMB = COLLADA.format(
    f'<library_nodes>{NODES}<node id="n40"/></library_nodes><library_visual_scenes>'
    '<visual_scene id="s"><node><instance_node url="#n0"/></node></visual_scene>'
    "</library_visual_scenes>"
)
LOOP = COLLADA.format(
    '<library_nodes><node id="a"><instance_node url="#a"/></node></library_nodes>'
    '<library_visual_scenes><visual_scene id="s"><node><instance_node url="#a"/></node>'
    "</visual_scene></library_visual_scenes>"
)


def zipped():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.dae", b" " * 10_000_000)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.stl", b"", "cannot be read|0 triangles"),
        ("a.stl", b"solid\nendsolid\n", "cannot be read|0 triangles"),
        ("a.stl", BOX.export(file_type="stl")[:-7], "cannot be read|0 triangles"),
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\xff", "cannot be read|0 triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "cannot be read|0 triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "not finite"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 1e300 1 0\nf 1 2 3\n", "not finite or larger than 1e.06"),
        ("a.obj", "v 0 0 0\nf 1 2 3\n", "cannot be read"),
        ("a.dae", "<COLLADA", "not well-formed XML"),
        ("a.dae", '<!DOCTYPE x [<!ENTITY a "b">]><COLLADA>&a;</COLLADA>', "document type"),
        ("a.dae", "<COLLADA/>", "cannot be read"),
        ("a.dae", BOMB, "nodes of"),
        ("a.dae", LOOP, "loop"),
        ("a.dae", zipped(), "not well-formed XML"),
        ("a.dae", COLLADA.replace("<asset/>", '<asset><unit meter="0"/></asset>').format(""),
         "unit '0' m"),
        ("a.ply", b"ply", "cannot be read"),
        ("a.ply", PLY, "cannot be read"),
        ("a.ply", PLY.replace(b"element face 12", b"element face 9000000000000"), "cannot be read"),
        ("a.glb", b"glTF", "cannot be read"),
        ("a.gltf", b"{}", "none of .stl, .dae, .obj, .ply, .glb"),
        ("a", b"", "none of .stl"),
        ("a.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
    ],
)  # fmt: skip
def test_bad_meshes(tmp_path, name, data, message):
    assert re.search(message, refused(tmp_path / name, data))


def test_files_and_meshes_that_are_too_large(tmp_path, monkeypatch):
    data = BOX.export(file_type="stl")
    monkeypatch.setattr(meshes, "MAX_TRIANGLES", 11)
    assert "has 12 triangles: give from 1 to 11" in refused(tmp_path / "a.stl", data)
    monkeypatch.setattr(meshes, "MAX_BYTES", len(data) - 1)
    assert f"larger than {len(data) - 1} bytes" in refused(tmp_path / "a.stl", data)


def test_nodes_and_triangles_of_a_dae_are_counted_as_often_as_they_are_shown(monkeypatch):
    """Two triangles in a node that stands for two, one of which has another in it: in all four."""
    geometry = '<geometry id="g"><mesh><triangles><p>0 1 2 2 1 0</p></triangles></mesh></geometry>'
    shown = '<node id="n"><node><instance_geometry url="#g"/></node></node>'
    text = COLLADA.format(
        f"<library_geometries>{geometry}</library_geometries><library_nodes>{shown}</library_nodes>"
        '<library_visual_scenes><visual_scene id="s"><node><instance_node url="#n"/></node>'
        '<node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
    )
    root, nodes, faces = etree.fromstring(text), 1 + 4 + 2, 4
    for most, triangles, refused in ((nodes, 2, False), (nodes - 1, 2, True), (nodes, 1, True)):
        monkeypatch.setattr(meshes, "MAX_INSTANCES", most)
        monkeypatch.setattr(meshes, "MAX_TRIANGLES", triangles)
        if refused:
            message = f"^it has {nodes} nodes of {faces} triangles: give a mesh of at most {most}"
            with pytest.raises(RobotError, match=message):
                meshes._check_instances(root, "it")
        else:
            meshes._check_instances(root, "it")


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("0.01", 0.01), ("1e6", 1e6), ("1000001", None), ("-1", None), ("x", None), ("nan", None)],
)
def test_a_unit_is_a_number_above_nought(unit, metres):
    data = COLLADA.replace("<asset/>", f'<asset><unit meter="{unit}"/></asset>').format("").encode()
    if metres is None:
        with pytest.raises(RobotError, match=f"it has the unit '{unit}' m: give a number above 0"):
            meshes._checked_collada(data, "it")
    else:
        assert meshes._checked_collada(data, "it")[1] == metres


LARGE = {
    "one.obj": ("v 0 0 0\n" * 3 + "f" + " 1 2 3" * 5_000_000, "15000000 corners: give from"),
    "lines.obj": ("v 0 0 0\n" * 3 + "f" + " 1 2 3 \\\n" * 3_000_000, "corners: give from"),
    "faces.obj": ("v 0 0 0\n" * 3 + "f 1 2 3\n" * 4_000_000, "corners: give from 1 to 500000"),
    "tags.dae": (COLLADA.format("<a/>" * 7_000_000), "more than 400000 elements"),
    "lines.ply": ("ply\n" + "1\n" * 16_000_000, "more than 1000000 lines"),
    "a.stl": ("\0" * 80 + "\xc0\x27\x09\0" + "\0" * 50 * 600_000, "600000 tri"),
}
READ = """
import resource, sys; from pathlib import Path
from cgtorch.tabletop.kinematics.meshes import read_mesh
def most(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
before = most()
for name in sys.argv[1:]:
    try: read_mesh(Path(name))
    except Exception as error: print(error)
print(most() - before)
"""


@pytest.mark.hostile
def test_memory_is_bounded(tmp_path):
    """Files of up to 32 MiB are refused before they take a gigabyte."""
    for name, (text, _) in LARGE.items():
        (tmp_path / name).write_bytes(text.encode("latin-1"))
    words = [sys.executable, "-c", READ, *(str(tmp_path / name) for name in LARGE)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    *said, more = done.stdout.splitlines()
    for line, (name, (_, message)) in zip(said, LARGE.items(), strict=True):
        assert name in line
        assert message in line
    assert int(more) < 2**20  # KiB


def test_no_file(tmp_path):
    with pytest.raises(RobotError, match="not a file"):
        read_mesh(tmp_path / "none.stl")


@pytest.fixture
def world(tmp_path):
    """A package in a repository in a workspace, a URDF elsewhere, and a secret beside all."""
    package = tmp_path / "ws" / "repo" / "arm_description"
    (package / "meshes").mkdir(parents=True)
    (package / "meshes" / "a.stl").write_text("mesh")
    (package / "package.xml").write_text("<package><name>arm_description</name></package>")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "secret.stl").write_text("secret")
    return tmp_path


NAME = "package://arm_description/meshes/a.stl"


def found(world, name=NAME, places=(), urdf="elsewhere/r.urdf"):
    return file_named(name, world / urdf, [world / place for place in places])


@pytest.mark.parametrize("place", ["ws", "ws/repo", "ws/repo/arm_description"])
def test_a_place_is_around_a_package_or_it_is_one(world, place):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    assert found(world, places=[place]) == mesh
    assert found(world, "package:///arm_description/meshes/./a.stl", [place]) == mesh


def test_the_package_in_which_the_urdf_lies(world):
    urdf = "ws/repo/arm_description/urdf/r.urdf"
    assert found(world, urdf=urdf).read_text() == "mesh"
    (world / "ws/repo/arm_description").rename(world / "ws/repo/checkout")
    assert found(world, urdf="ws/repo/checkout/urdf/r.urdf").read_text() == "mesh"
    assert (
        found(world, "../meshes/a.stl", urdf="ws/repo/checkout/urdf/r.urdf").read_text() == "mesh"
    )


def test_a_package_beside_the_urdf(world):
    beside = world / "elsewhere/hand/meshes/b.stl"
    beside.parent.mkdir(parents=True)
    beside.write_text("beside")
    for urdf in ("r.urdf", "robot/r.urdf", "robot/urdf/r.urdf"):
        assert found(world, "package://meshes/b.stl", urdf=f"elsewhere/hand/{urdf}") == beside
    with pytest.raises(RobotError, match="the package 'meshes' is in none of"):
        found(world, "package://meshes/b.stl", urdf="elsewhere/hand/a/b/c/r.urdf")


def test_a_package_that_was_renamed_is_that_of_the_urdf(world):
    own = world / "ws/repo/arm_description"
    (own / "package.xml").write_text("<package><name>new_name</name></package>")
    urdf = "ws/repo/arm_description/urdf/r.urdf"
    assert found(world, "package://old_name/meshes/a.stl", urdf=urdf) == own / "meshes/a.stl"
    with pytest.raises(RobotError, match="the package 'old_name' is in none of"):
        found(world, "package://old_name/meshes/b.stl", urdf=urdf)
    (world / "ws/old_name").mkdir()  # which is the one, if it is there
    with pytest.raises(RobotError, match="it is not in"):
        found(world, "package://old_name/meshes/a.stl", ["ws"], urdf)


def test_the_folder_around_a_folder_urdf_is_a_package(world):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    (world / "ws/repo/arm_description/package.xml").unlink()
    urdf = "ws/repo/arm_description/urdf/r.urdf"
    assert found(world, "../meshes/a.stl", urdf=urdf) == mesh
    assert found(world, "package://old_name/meshes/a.stl", urdf=urdf) == mesh
    for name, place in (("../../a.stl", "urdf"), ("../meshes/a.stl", "other")):
        with pytest.raises(RobotError, match="leads out of"):
            found(world, name, urdf=f"ws/repo/arm_description/{place}/r.urdf")


def test_the_folder_of_a_urdf_is_its_package_where_there_is_no_other(world):
    mesh = world / "elsewhere/hand/meshes/a.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("beside")
    assert found(world, "package://old_name/meshes/a.stl", urdf="elsewhere/hand/r.urdf") == mesh


def test_capitals_of_a_file_may_differ_if_only_one_is_alike(world):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    assert found(world, NAME.replace("a.stl", "A.STL"), ["ws"]) == mesh
    assert found(world, "A.Stl", urdf="ws/repo/arm_description/meshes/r.urdf") == mesh
    mesh.with_name("a.STL").write_text("other")
    assert found(world, places=["ws"]) == mesh
    with pytest.raises(RobotError, match=r"A.STL', which is missing"):
        found(world, NAME.replace("a.stl", "A.STL"), ["ws"])


def test_the_environment(world):
    environment = {
        "ROS_PACKAGE_PATH": f"{world}/none:{world}/ws",
        "AMENT_PREFIX_PATH": f"{world}/install::",
    }
    places = package_places(["mine"], environment)
    ends = ["mine", "none", "ws", "install/share"]
    assert [str(place).removeprefix(f"{world}/") for place in places] == ends
    assert file_named(NAME, world / "r.urdf", places).read_text() == "mesh"
    (world / "ws").rename(world / "moved")
    (world / "install" / "share").mkdir(parents=True)
    (world / "moved/repo/arm_description").rename(world / "install/share/arm_description")
    assert file_named(NAME, world / "r.urdf", places).read_text() == "mesh"


def test_files_by_their_path(world):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    for name in (str(mesh), f"file://{mesh}", f"file:///{mesh}"):
        assert found(world, name, ["ws"]) == mesh
        with pytest.raises(RobotError, match="leads out of"):
            found(world, name)
    for name in ("a.stl", "package://a.stl"):
        assert found(world, name, urdf="ws/repo/arm_description/meshes/r.urdf") == mesh
    with pytest.raises(RobotError, match="which is missing: there is no"):
        found(world, "package://a.stl")


@pytest.mark.parametrize(
    "name",
    [
        "package://arm_description/../../../secret.stl",
        "package://arm_description/meshes/../../../../secret.stl",
        "package://arm_description//etc/../../../../secret.stl",
        "package://../secret.stl",
        "package://./secret.stl",
        "package://arm*/meshes/a.stl",
        "package://",
        "../secret.stl",
        "{world}/secret.stl",
        "file://{world}/secret.stl",
        "file:///etc/passwd",
        "/etc/passwd",
        "http://example.org/a.stl",
        "model://../secret.stl",
        "\0",
        "",
        "x" * 5000,
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(world, name):
    with pytest.raises(RobotError) as caught:
        found(world, name.format(world=world), ["ws"])
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_what_is_missing_is_named_with_the_places(world):
    with pytest.raises(RobotError) as caught:
        found(world, "package://arm_description/meshes/b.stl", ["ws"])
    assert "arm_description/meshes/b.stl', which is missing: it is not in" in str(caught.value)
    assert f"{world}/ws/repo/arm_description" in str(caught.value)
    with pytest.raises(RobotError) as caught:
        found(world, "package://leg/b.stl", ["ws"])
    assert "the package 'leg' is in none of" in str(caught.value)
    assert f"{world}/ws'" in str(caught.value)
    assert "--package-path" in str(caught.value)
