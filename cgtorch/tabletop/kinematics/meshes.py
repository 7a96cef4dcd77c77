"""Meshes of a URDF from STL, DAE and OBJ files, read by trimesh with limits on their size."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes
from cgtorch.tabletop.kinematics.urdf import MOST

KINDS = (".stl", ".dae", ".obj")
MAX_BYTES = 32 * 2**20
MAX_TRIANGLES = 500_000
MAX_TAGS = 400_000  # of a DAE; each is an object of a hundred bytes or more
MAX_INSTANCES = 10_000  # of a DAE's nodes, which may stand for one another
_REFERENCES = "{*}instance_node", "{*}instance_geometry"


def read_mesh(path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> trimesh.Trimesh:
    """The triangles of a mesh file as one mesh, in m, scaled along x, y and z.

    The unit of length of a DAE is used and its upward axis is not, as in ROS. Neither materials nor
    other files are read.

    RobotError if it is of another kind, cannot be read, is too large, or has no triangle or a
    number that is not finite.
    """
    where, kind = f"mesh {str(path)!r}", path.suffix.lower()
    if kind not in KINDS:
        raise RobotError(f"{where} is none of {', '.join(KINDS)}: convert it to one of these")
    data, unit = read_bytes(path, MAX_BYTES, RobotError), 1.0
    if kind == ".obj":
        _check_corners(data, where)
    if kind == ".dae":
        data, unit = _checked_collada(data, where)
    try:
        mesh = trimesh.load(
            io.BytesIO(data), file_type=kind[1:], force="mesh", process=False, skip_materials=True
        )
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        used, index = np.unique(faces, return_inverse=True)
        vertices = vertices[used]
    except Exception as error:  # trimesh lets through whatever its parts raise
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise RobotError(f"{where} cannot be read ({reason}): export it again") from None
    if not 0 < len(faces) <= MAX_TRIANGLES:
        raise RobotError(
            f"{where} has {len(faces)} triangles: give from 1 to {MAX_TRIANGLES}, as many as show "
            "its form"
        )
    with np.errstate(all="ignore"):
        vertices = vertices * (unit * np.asarray(scale))
    if not bool((np.abs(vertices) <= MOST).all()):
        raise RobotError(
            f"{where} has, times the scale {list(scale)}, a number that is not finite or larger "
            f"than {MOST:.0e}: correct it"
        )
    return trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)


def _check_corners(data: bytes, where: str) -> None:
    """RobotError if an OBJ's faces have far more corners than is allowed, before they are read."""
    # A face may go on in the next line, which begins with a number then.
    faces = (line for line in io.BytesIO(data) if not line.lstrip().startswith((b"v", b"#")))
    corners = sum(line.count(b" ") + line.count(b"\t") for line in faces)
    if corners > 6 * MAX_TRIANGLES:  # twice as many as triangles need, as blanks may be doubled
        raise RobotError(
            f"{where} has faces with {corners} corners: give from 1 to {MAX_TRIANGLES} triangles, "
            "as many as show its form"
        )


def _checked_collada(data: bytes, where: str) -> tuple[bytes, float]:
    """A DAE without anything that could name other files, and its unit, m."""
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=True,
        remove_comments=True, remove_pis=True,
    )  # fmt: skip
    if data.count(b"<") > 2 * MAX_TAGS:
        raise RobotError(f"{where} has more than {MAX_TAGS} elements: give fewer")
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        reason = " ".join(str(error).split())[:100]
        raise RobotError(f"{where} is not well-formed XML ({reason}): export it again") from None
    info = root.getroottree().docinfo
    if info.doctype or info.internalDTD is not None:
        raise RobotError(f"{where} has a document type, which can name entities: remove it")
    _check_instances(root, where)
    element = root.find("{*}asset/{*}unit")
    text = "1" if element is None else element.get("meter", "1")
    try:
        unit = float(text)
    except ValueError:
        unit = 0.0
    if not 0 < unit <= MOST:
        raise RobotError(f"{where} has the unit {text!r} m: give a number above 0")
    return etree.tostring(root), unit


def _check_instances(root: Any, where: str) -> None:
    """Refuse nodes whose instances would have an excessive number of triangles."""
    named = {e.get("id"): e for e in root.iter("{*}node", "{*}geometry") if e.get("id")}
    triangles = {
        name: sum(len((p.text or "").split()) for p in element.iter("{*}p")) / 3
        for name, element in named.items()
        if etree.QName(element).localname == "geometry"
    }
    known: dict[Any, tuple[float, float]] = {}

    def size(node: Any, above: tuple[Any, ...]) -> tuple[float, float]:
        """How many nodes and triangles a node makes."""
        if node in above or len(above) > 100:
            raise RobotError(f"{where} has nodes that stand for each other in a loop: break it")
        if node not in known:
            nodes, faces = 1.0, 0.0
            for child in node.iterchildren("{*}node", *_REFERENCES):
                name = (child.get("url") or "").removeprefix("#")
                if name in triangles:
                    nodes, faces = nodes + 1, faces + triangles[name]
                elif etree.QName(child).localname == "node" or name in named:
                    more = size(named.get(name, child), (*above, node))
                    nodes, faces = nodes + more[0], faces + more[1]
            known[node] = nodes, faces
        return known[node]

    sizes = [size(scene, ()) for scene in root.iter("{*}visual_scene")]
    nodes, faces = (sum(each[i] for each in sizes) for i in range(2))
    if nodes > MAX_INSTANCES or faces > 3 * MAX_TRIANGLES:
        raise RobotError(
            f"{where} has {nodes:.3g} nodes of {faces:.3g} triangles: give a mesh of at most "
            f"{MAX_INSTANCES} and {MAX_TRIANGLES}"
        )
