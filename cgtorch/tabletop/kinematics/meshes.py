"""Meshes of a URDF: found within given folders only, and read with limits on their size."""

import io
import itertools
import os
import posixpath
import re
from collections.abc import Iterator, Mapping, Sequence
from os.path import isdir, isfile  # which take any text for a path
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes
from cgtorch.tabletop.kinematics.glb import glb_triangles
from cgtorch.tabletop.kinematics.urdf import REASON, one_line, parsed
from cgtorch.tabletop.kinematics.valid import MOST

KINDS = (".stl", ".dae", ".obj", ".ply", ".glb")
MAX_BYTES = 32 * 2**20
MAX_TRIANGLES = 500_000
MAX_LINES = 1_000_000  # of a PLY; each is an object of a hundred bytes
MAX_TAGS = 400_000  # of a DAE; each is an object of a hundred bytes or more
MAX_INSTANCES = 10_000  # of a DAE's nodes, which may stand for one another
_REFERENCES = "{*}instance_node", "{*}instance_geometry"
_FOLDER = "urdf"  # of a package, beside that of its meshes
_SLASHES = re.compile(r"^/+")
_BESIDE = 3  # folders around a URDF in which a package may be
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)
_PACKAGE_BYTES = 1_000_000  # of a package.xml
_POINTER = b"version https://git-lfs"
_LISTED = 8  # places that an error names


class NoGeometryError(RobotError):
    """A mesh file is good and has no geometry, as of a link that is not seen."""


def read_mesh(path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> trimesh.Trimesh:
    """The triangles of a mesh file as one mesh, in m, scaled along x, y and z.

    The unit of length of a DAE is used; its upward axis and that of a GLB are not, as in ROS.
    Neither materials nor other files are read.

    RobotError if it is of another kind, cannot be read, is too large, or has no triangle or a
    number that is not finite; `NoGeometryError` if it is a DAE that describes nothing.
    """
    where, kind = f"mesh {str(path)!r}", path.suffix.lower()
    if kind not in KINDS:
        raise RobotError(f"{where} is none of {', '.join(KINDS)}: convert it to one of these")
    data, unit = read_bytes(path, MAX_BYTES, RobotError), 1.0
    if data.startswith(_POINTER):
        raise RobotError(f"{where} only points to a file in Git LFS: get that by `git lfs pull`")
    if kind == ".obj":
        _check_corners(data, where)
    if kind == ".ply" and data.count(b"\n") > MAX_LINES:
        raise RobotError(f"{where} has more than {MAX_LINES} lines: write it as a binary PLY")
    if kind == ".dae":
        data, unit = _checked_collada(data, where)
    try:
        vertices, faces = _triangles(data, kind)
        used, index = np.unique(faces, return_inverse=True)
        vertices = vertices[used]
    except Exception as error:  # trimesh lets through whatever its parts raise
        reason = one_line(error)[:REASON]
        raise RobotError(f"{where} cannot be read ({reason}): export it again") from None
    if kind == ".dae" and not len(faces) and b"geometry" not in data:
        raise NoGeometryError(f"{where} has no geometry")
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


def _triangles(data: bytes, kind: str) -> tuple[Any, Any]:
    """Vertices (V, 3) and faces (F, 3) of a file of a kind."""
    if kind == ".glb":
        return glb_triangles(data, MAX_TRIANGLES)
    mesh = trimesh.load(
        io.BytesIO(data), file_type=kind[1:], force="mesh", process=False, skip_materials=True
    )
    return np.reshape(mesh.vertices, (-1, 3)), np.reshape(mesh.faces, (-1, 3))


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
    """A DAE without anything that could name other files, and its unit, m.

    Nor does it name materials that are not there, as their geometry would not be read.
    """
    if data.count(b"<") > 2 * MAX_TAGS:
        raise RobotError(f"{where} has more than {MAX_TAGS} elements: give fewer")
    root = parsed(data, where, huge=True)
    _check_instances(root, where)
    element = root.find("{*}asset/{*}unit")
    text = "1" if element is None else element.get("meter", "1")
    try:
        unit = float(text)
    except ValueError:
        unit = 0.0
    if not 0 < unit <= MOST:
        raise RobotError(f"{where} has the unit {text!r} m: give a number above 0")
    known = {f"#{material.get('id')}" for material in root.iter("{*}material")}
    for use in list(root.iter("{*}instance_material")):
        if use.get("target") not in known:
            use.getparent().remove(use)
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


def package_places(
    given: Sequence[Path | str] = (), environment: Mapping[str, str] = os.environ
) -> tuple[Path, ...]:
    """Folders in which packages are searched, the given ones first.

    After them come those of the variable ROS_PACKAGE_PATH, and `share` in those of
    AMENT_PREFIX_PATH.
    """
    ros, ament = (
        [Path(place) for place in environment.get(name, "").split(os.pathsep) if place]
        for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
    )
    return (*map(Path, given), *ros, *(prefix / "share" for prefix in ament))


def file_named(name: str, urdf: Path, places: Sequence[Path]) -> Path:
    """The file that a URDF names: `package://PACKAGE/PATH`, `file://PATH`, or a path.

    `model://` stands for `package://`. A package is a folder with its name: in one of the places,
    up to three levels deep, a place itself, a folder around the URDF, or in one of the three
    nearest of these. If none has the name, it is the URDF's own package, which was renamed. Any
    other path is relative to the URDF, and so is `package://FILE`; it must stay in its folder, its
    package or one of the places. If it is absolute and there is no such file, as on another
    machine than its author's, it is the one in a place that has the most of the end of its path.
    Only the text of the path is checked; links in a package may lead anywhere, as in a workspace of
    links. A file may be written with other capitals than its name, as some file systems do not tell
    them apart.

    RobotError if there is no such file, or the name leads out of the permitted folders.
    """
    scheme, colon, rest = name.partition("://")
    if not colon:
        return _near(name, name, urdf, places)
    if scheme == "file":
        return _near(_SLASHES.sub("/", rest), name, urdf, places)
    if scheme not in ("package", "model"):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}: give a path, package://PACKAGE/PATH or "
            "file://PATH"
        )
    package, slash, inside = rest.lstrip("/").partition("/")
    inside = posixpath.normpath(inside)
    if not _NAME.fullmatch(package):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which says no package: write "
            "package://PACKAGE/PATH"
        )
    if not slash:
        return _near(package, name, urdf, places)
    if inside.startswith(("/", "..")):
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which leads out of the package "
            f"{package!r}: name a file in it"
        )
    folders = list(_packages(package, urdf, places))
    for folder in folders or _own_package(urdf):
        if (found := _spelt(folder / inside)) is not None:
            return found
    looked = folders or [*places, *_around(urdf)[:1]]
    what = "it is not in" if folders else f"the package {package!r} is in none of"
    raise RobotError(
        f"URDF {str(urdf)!r} names the file {name!r}, which is missing: {what} {_listed(looked)}; "
        "give the folder that holds the package as packages (--package-path) or in ROS_PACKAGE_PATH"
    )


def _near(path: str, name: str, urdf: Path, places: Sequence[Path]) -> Path:
    """A file by its path, absolute or relative to the URDF."""
    around = _around(urdf)
    found = Path(os.path.normpath(around[0] / path))
    roots = [around[0], *_own_package(urdf), *(Path(os.path.abspath(place)) for place in places)]
    if not any(found.is_relative_to(root) for root in roots):
        if os.path.isabs(path) and not isfile(found):
            return _of_another_machine(found, name, urdf, places)
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which leads out of {_listed(roots)}: "
            "move it there, or give its folder as packages (--package-path)"
        )
    if (spelt := _spelt(found)) is None:
        raise RobotError(
            f"URDF {str(urdf)!r} names the file {name!r}, which is missing: there is no "
            f"{str(found)!r}; put it there"
        )
    return spelt


def _of_another_machine(path: Path, name: str, urdf: Path, places: Sequence[Path]) -> Path:
    """The file in a place that has the most of the end of an absolute path, which is not here."""
    ends = (Path(*path.parts[i:]) for i in range(1, len(path.parts)))
    for end, place in itertools.product(ends, places):
        if (spelt := _spelt(place / end)) is not None:
            return spelt
    raise RobotError(
        f"URDF {str(urdf)!r} names the file {name!r}, which is not on this machine: change its "
        "path in the URDF, or give the folder where it is as packages (--package-path)"
    )


def _spelt(path: Path) -> Path | None:
    """A file, or the only one beside it whose name differs in capitals; None if there is none."""
    if isfile(path):
        return path
    beside = sorted(path.parent.glob("*")) if isdir(path.parent) else []
    alike = [each for each in beside if each.name.lower() == path.name.lower() and isfile(each)]
    return alike[0] if len(alike) == 1 else None


def _own_package(urdf: Path) -> list[Path]:
    """The nearest folder around a URDF that has a package.xml, else its own folder.

    The folder around a folder urdf comes before that.
    """
    around = _around(urdf)
    packages = [folder for folder in around if isfile(folder / "package.xml")]
    nearest = [folder.parent for folder in around[:1] if folder.name == _FOLDER]
    return packages[:1] or [*nearest, *around[:1]]


def _packages(package: str, urdf: Path, places: Sequence[Path]) -> Iterator[Path]:
    """Folders that are a package with that name."""
    for folder in (*places, *_around(urdf)):
        if folder.name == package or _says(folder) == package:
            yield folder
    yield from filter(isdir, (folder / package for folder in _around(urdf)[:_BESIDE]))
    for place in filter(isdir, places):
        for depth in ("", "*/", "*/*/"):
            yield from sorted(filter(isdir, place.glob(depth + package)))


def _says(folder: Path) -> str | None:
    """The package name in the package.xml of a folder, or None."""
    path = folder / "package.xml"
    if not isfile(path):
        return None
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        root = etree.fromstring(read_bytes(path, _PACKAGE_BYTES, RobotError), parser)
    except (etree.XMLSyntaxError, ValueError):
        return None
    return (root.findtext("name") or "").strip() or None


def _around(urdf: Path) -> tuple[Path, ...]:
    """The folders around a URDF, the innermost first."""
    return tuple(Path(os.path.abspath(urdf)).parents)


def _listed(folders: Sequence[Path]) -> str:
    names = list(dict.fromkeys(repr(str(folder)) for folder in folders))
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more
