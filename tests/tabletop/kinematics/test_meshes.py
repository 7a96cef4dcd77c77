"""Mesh files: what is in them is read, and whatever is wrong with them is one RobotError."""

import io
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import trimesh

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics import meshes
from cgtorch.tabletop.kinematics.meshes import read_mesh

BOX = trimesh.creation.box((0.3, 0.2, 0.1))


def refused(path, data):
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    with pytest.raises(RobotError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


@pytest.mark.parametrize("name", ["box.stl", "BOX.STL", "text.stl", "box.obj", "box.dae"])
def test_each_format_and_its_scale(tmp_path, name):
    kind = "stl_ascii" if name == "text.stl" else name[-3:].lower()
    data = BOX.export(file_type=kind)
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
        ("a.ply", b"ply", "none of .stl, .dae, .obj"),
        ("a", b"", "none of .stl"),
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


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        (
            "a.obj",
            "v 0 0 0\n" * 3 + "f" + " 1 2 3" * 5_000_000 + "\n",
            "15000000 corners: give from",
        ),
        ("a.obj", "v 0 0 0\n" * 3 + "f" + " 1 2 3 \\\n" * 3_000_000, "corners: give from"),
        ("a.obj", "v 0 0 0\n" * 3 + "f 1 2 3\n" * 4_000_000, "corners: give from 1 to 500000"),
        ("a.dae", COLLADA.format("<a/>" * 7_000_000), "more than 400000 elements"),
        (
            "a.stl",
            b"\0" * 80 + (600_000).to_bytes(4, "little") + b"\0" * 50 * 600_000,
            "600000 tri",
        ),
    ],
    ids=("one face", "lines that go on", "faces", "elements", "triangles"),
)
def test_memory_is_bounded(tmp_path, name, data, message):
    """A file of up to 32 MiB is refused before it takes a gigabyte."""
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    program = (
        "import resource, sys; from pathlib import Path\n"
        "from cgtorch.tabletop.kinematics.meshes import read_mesh\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: read_mesh(Path(sys.argv[1]))\n"
        "except Exception as error: print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    words = [sys.executable, "-c", program, str(tmp_path / name)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    said, more = done.stdout.splitlines()
    assert message in said
    assert int(more) < 2**20  # KiB


def test_no_file(tmp_path):
    with pytest.raises(RobotError, match="not a file"):
        read_mesh(tmp_path / "none.stl")
