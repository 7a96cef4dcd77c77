"""A URDF with simple shapes around its meshes in place of them, so that it needs no other file."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from trimesh import transformations

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.description import Capsule
from cgtorch.tabletop.kinematics.meshes import NoGeometryError, file_named, read_mesh
from cgtorch.tabletop.kinematics.origins import add_origin, pose_of, words
from cgtorch.tabletop.kinematics.shapes import Array, Fit, Shape, capsule, fitted
from cgtorch.tabletop.kinematics.urdf import Urdf, checked_urdf

MAX_MESHES = 500


@dataclass(frozen=True)
class MeshFit:
    """The result for one mesh.

    Attributes:
        link: The link of the mesh.
        file: The file as the URDF names it.
        kind: "collision" or "visual".
        pose: (4, 4) of the mesh in the link's frame, m.
        fit: The shapes in the mesh's own frame, or None for a mesh without geometry, or a visual
            one that cannot be read, of a link without collision shapes.
        problem: Why it cannot be read.
    """

    link: str
    file: str
    kind: str
    pose: Array
    fit: Fit | None
    problem: str = ""


def without_meshes(
    urdf: Urdf, places: Sequence[Path] = (), capsules: Mapping[str, Sequence[Capsule]] | None = None
) -> tuple[Urdf, tuple[MeshFit, ...]]:
    """The URDF with shapes in place of meshes, and the shapes fitted to them; see `fitted`.

    A collision mesh becomes the shapes around it, or the `capsules` of its link; one without any
    geometry is left out. A link with a
    visual mesh shows its collision shapes. Without any, it shows shapes around the visual mesh, or
    nothing if that cannot be read.

    RobotError if a collision mesh is missing or cannot be read; see `file_named` and `read_mesh`.
    """
    root = etree.fromstring(urdf.xml)
    if root.find("link//mesh") is None:
        return urdf, ()
    if len(root.findall("link//mesh")) > MAX_MESHES:
        raise RobotError(f"URDF {str(urdf.path)!r} has more than {MAX_MESHES} meshes: give fewer")
    reader = _Reader(urdf.path, places, {})
    found: list[MeshFit] = []
    for link in root.findall("link"):
        given = (capsules or {}).get(link.get("name"))
        if given is not None and link.find("collision//mesh") is not None:
            for element in link.findall("collision"):
                link.remove(element)
            for x0, y0, z0, x1, y1, z1, radius in given:
                shape = capsule(np.array([x0, y0, z0]), np.array([x1, y1, z1]), radius)
                link.extend(_elements("collision", shape))
        found.extend(_replace(link, "collision", reader))
        if link.find("visual//mesh") is not None:
            found.extend(_replace_visuals(link, reader))
    return checked_urdf(urdf.path, root), tuple(found)


@dataclass(frozen=True)
class _Reader:
    """Fits each file once."""

    urdf: Path
    places: Sequence[Path]
    known: dict[tuple[str, tuple[float, ...]], Fit]

    def fit(self, mesh: Any) -> Fit:
        name = mesh.get("filename") or ""
        scale = [float(part) for part in mesh.get("scale", "1").replace(",", " ").split()]
        scale = scale * 3 if len(scale) == 1 else scale
        if len(scale) != 3:
            raise RobotError(
                f"URDF {str(self.urdf)!r} scales the mesh {name!r} by {scale}: give one number or "
                "three"
            )
        key = name, tuple(scale)
        if key not in self.known:
            path = file_named(name, self.urdf, self.places)
            self.known[key] = fitted(read_mesh(path, scale))
        return self.known[key]


def _replace(link: Any, kind: str, reader: _Reader) -> list[MeshFit]:
    """Shapes in place of a link's elements of a kind that are meshes."""
    found = []
    for element in link.findall(kind):
        mesh = element.find("geometry/mesh")
        if mesh is None:
            continue
        fit, pose, problem = None, pose_of(element), ""
        try:
            fit = reader.fit(mesh)
        except NoGeometryError as error:
            problem = str(error)
        found.append(MeshFit(link.get("name"), mesh.get("filename"), kind, pose, fit, problem))
        for shape in fit.shapes if fit is not None else ():
            for part in _elements(kind, replace(shape, pose=pose @ shape.pose)):
                part.extend(map(copy.deepcopy, element.findall("material")))
                element.addprevious(part)
        link.remove(element)
    return found


def _replace_visuals(link: Any, reader: _Reader) -> list[MeshFit]:
    """Shapes in place of the visual meshes of a link."""
    visuals, collisions = link.findall("visual"), link.findall("collision")
    if not collisions:
        try:
            return _replace(link, "visual", reader)
        except RobotError as error:
            names = [mesh.get("filename") or "" for mesh in link.iterfind("visual//mesh")]
            problem = MeshFit(link.get("name"), names[0], "visual", np.eye(4), None, str(error))
        for element in visuals:
            link.remove(element)
        return [problem]
    materials = [each for visual in visuals for each in visual.findall("material")][:1]
    for element in visuals:
        link.remove(element)
    for element in collisions:
        etree.SubElement(link, "visual").extend(map(copy.deepcopy, (*element, *materials)))
    return []


def _elements(kind: str, shape: Shape) -> list[Any]:
    """A shape as URDF elements; a capsule becomes a cylinder and two spheres."""
    if shape.kind != "capsule":
        return [_element(kind, shape)]
    radius, length = shape.sizes
    parts = [Shape("cylinder", shape.pose, shape.sizes)]
    for end in (-length / 2, length / 2):
        ball = shape.pose @ transformations.translation_matrix([0, 0, end])
        parts.append(Shape("sphere", ball, (radius,)))
    return [_element(kind, part) for part in parts]


def _element(kind: str, shape: Shape) -> Any:
    element = etree.Element(kind)
    add_origin(element, shape.pose)
    geometry = etree.SubElement(element, "geometry")
    if shape.kind == "box":
        etree.SubElement(geometry, "box", size=words(shape.sizes))
    elif shape.kind == "cylinder":
        radius, length = map(repr, shape.sizes)
        etree.SubElement(geometry, "cylinder", radius=radius, length=length)
    else:
        etree.SubElement(geometry, "sphere", radius=repr(shape.sizes[0]))
    return element
