"""What a URDF leaves out of a solid body: collision shapes, masses and inertias."""

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from lxml import etree

from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, checked_urdf, inertial_problem
from cgtorch.tabletop.robot_folder.structure import Structure

DENSITY = 500.0  # kg/m³ of a link's box whose mass is not known
SMALL = 0.03  # m: sides of the box of a link without shapes
FAR_OUT = 1000  # times the largest moment that a link's mass can have within its shapes
UNBALANCED = 1.01  # of one moment of inertia to the sum of the two others


def solid(urdf: Urdf) -> tuple[Urdf, tuple[str, ...]]:
    """A URDF of which nothing collides with what is seen of it as what collides, and a note."""
    root = etree.fromstring(urdf.xml)
    if root.find("link/visual") is None or root.find("link/collision") is not None:
        return urdf, ()
    note = "the URDF has no collision shapes, so that its visual shapes are taken for them"
    return _seen_as_solid(urdf, [link.name for link in urdf.model.robot.links]), (note,)


def solid_arms(
    structure: Structure, chains: Sequence[Sequence[Any]], hands: Sequence[str], notes: list[str]
) -> Urdf:
    """The URDF with what is seen of arms and hands, of which nothing collides, as what collides.

    A camera or gripper that collides, and is fixed to an arm of which nothing else does, remains.
    """
    bare = [structure.hanging(chain[0].child) for chain in chains if _bare(structure, chain)]
    without = [structure.hanging(hand) for hand in hands]
    bare += [links for links in without if not any(map(structure.shapes, links))]
    seen = [
        name
        for name in dict.fromkeys(name for links in bare for name in links)
        if structure.urdf.link(name).visuals and not structure.shapes(name)
    ]
    if not seen:
        return structure.urdf
    have, their = ("has", "its") if len(seen) == 1 else ("have", "their")
    notes.append(
        f"{', '.join(seen)} {have} no collision shapes, so that {their} visual ones are taken"
    )
    return _seen_as_solid(structure.urdf, seen)


def _bare(structure: Structure, chain: Sequence[Any]) -> bool:
    """Whether nothing that the joints of an arm carry collides, but what is fixed to few of it."""
    bodies = [structure.rigid(joint.child) for joint in chain]
    collide = [any(map(structure.shapes, links)) for links in bodies]
    itself = any(structure.shapes(links[0]) for links in bodies)
    return not itself and 2 * sum(collide) < len(collide)


def _seen_as_solid(urdf: Urdf, links: Sequence[str]) -> Urdf:
    root = etree.fromstring(urdf.xml)
    for link in root.findall("link"):
        for visual in link.findall("visual") if link.get("name") in links else ():
            part = etree.SubElement(link, "collision")
            part.extend(
                copy.deepcopy(each) for each in visual if each.tag in ("origin", "geometry")
            )
    return checked_urdf(urdf.path, root)


def sound_inertials(urdf: Urdf) -> tuple[Urdf, tuple[str, ...]]:
    """A URDF, without meshes, whose moving links have possible masses and inertias.

    An impossible one, or one that is missing where a joint moves a link and all that is fixed to
    it, becomes that of the box around the link's shapes, with the given mass if there is one. Also
    returned are the names of these links.
    """
    structure = Structure(urdf, urdf.model.base_link)
    massless = {
        joint.child
        for joint in urdf.model.robot.joints
        if joint.type in MOVING
        and not any(_mass(structure, n) for n in structure.rigid(joint.child))
    }
    links = urdf.model.robot.links
    odd = (
        link
        for link in links
        if inertial_problem(link) or _unbalanced(link) or _far_out(structure, link)
    )
    unsound = {*massless, *(link.name for link in odd)}
    if not unsound:
        return urdf, ()
    names = [link.name for link in links if link.name in unsound]
    root = etree.fromstring(urdf.xml)
    elements = {element.get("name"): element for element in root.findall("link")}
    for name in names:
        for old in elements[name].findall("inertial"):
            elements[name].remove(old)
        elements[name].append(_inertial_of_box(structure, name))
    return checked_urdf(urdf.path, root), tuple(names)


def _mass(structure: Structure, link: str) -> float:
    inertial = structure.urdf.link(link).inertial
    return 0.0 if inertial is None or inertial.mass is None else float(inertial.mass)


def _unbalanced(link: Any) -> bool:
    """Whether one moment is more than the sum of the others, which is impossible."""
    if link.inertial is None or link.inertial.inertia is None:
        return False
    low, middle, high = np.linalg.eigvalsh(link.inertial.inertia)
    return bool(high > UNBALANCED * (low + middle))


def _far_out(structure: Structure, link: Any) -> bool:
    """Whether a link's moments are those of a mass far outside its shapes, as in a wrong unit."""
    points, mass = structure.seen([link.name], link.name), _mass(structure, link.name)
    if not len(points) or mass <= 0 or link.inertial.inertia is None:
        return False
    centre = np.zeros(3) if link.inertial.origin is None else link.inertial.origin[:3, 3]
    most = mass * float((np.linalg.norm(points - centre, axis=1) ** 2).max())
    return bool(np.linalg.eigvalsh(link.inertial.inertia)[-1] > FAR_OUT * most)


def _inertial_of_box(structure: Structure, link: str) -> Any:
    points = structure.points(link, link)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3),) * 2
    sides = np.maximum(high - low, SMALL)
    mass = _mass(structure, link)
    mass = mass if mass > 0 else DENSITY * float(sides.prod())
    squares = sides**2
    moments = mass / 12 * (squares.sum() - squares)
    element = etree.Element("inertial")
    xyz = " ".join(repr(round(float(x), 9)) for x in (low + high) / 2)
    etree.SubElement(element, "origin", xyz=xyz, rpy="0 0 0")
    etree.SubElement(element, "mass", value=repr(mass))
    zero = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    named = zip(("ixx", "iyy", "izz"), moments, strict=True)
    etree.SubElement(element, "inertia", {n: repr(float(x)) for n, x in named} | zero)
    return element
