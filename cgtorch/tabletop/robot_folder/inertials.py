"""Plausible masses and inertias in place of missing or impossible ones in a URDF."""

from typing import Any

import numpy as np
from lxml import etree

from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, checked_urdf, inertial_problem
from cgtorch.tabletop.robot_folder.structure import Structure

DENSITY = 500.0  # kg/m³ of a link's box whose mass is not known
LIGHT = 0.01  # minimum mass of a moving link, kg
SMALL = 0.03  # m: sides of the box of a link without shapes
UNBALANCED = 1.01  # of one moment of inertia to the sum of the two others


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
    names = [
        link.name
        for link in urdf.model.robot.links
        if link.name in massless or inertial_problem(link) or _unbalanced(link)
    ]
    if not names:
        return urdf, ()
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


def _inertial_of_box(structure: Structure, link: str) -> Any:
    points = structure.points(link, link)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3),) * 2
    sides = np.maximum(high - low, SMALL)
    mass = _mass(structure, link)
    mass = mass if mass > 0 else max(LIGHT, DENSITY * float(sides.prod()))
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
