"""What URDFs have beyond the format, or leave out: capsules, colours, limits that are not given."""

import copy
import math
from typing import Any

import numpy as np
from lxml import etree
from trimesh import transformations

from cgtorch.ground.errors import RobotError

LIMITED = ("revolute", "prismatic")
ENDS = ("lower", "upper")
TRIPLES = {"xyz", "rpy", "size", "scale"}
SIZES = ("size", "radius", "length")
SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")


def without_namespace(root: Any) -> None:
    """Take the names of elements, in place, out of the namespace of a root <robot xmlns="...">."""
    if not root.nsmap.get(None) or etree.QName(root).localname != "robot":
        return
    before = f"{{{root.nsmap[None]}}}"
    for element in root.iter(f"{before}*"):
        element.tag = etree.QName(element).localname
    etree.cleanup_namespaces(root)


def completed(root: Any, where: str) -> None:
    """Turn a checked tree of elements, in place, into one that every reader understands.

    A capsule becomes a cylinder and two spheres, and commas between numbers become blanks. A limit
    without a number is 0, as the format says, an effort or velocity of 0 is no limit, and a robot
    without a name is called robot. What is no colour, as 255 in place of 1, is left out, and so is
    a shape without any size.
    RobotError for a shape that is none of `SHAPES`.
    """
    root.set("name", root.get("name") or "robot")
    for element in root.iter("origin", "axis", "box", "mesh"):
        for name in TRIPLES.intersection(element.attrib):
            element.set(name, element.get(name).replace(",", " "))
    for link in root.findall("link"):
        for part in [*link.findall("collision"), *link.findall("visual")]:
            shapes = part.findall("geometry/*")
            names = [shape.tag for shape in shapes]
            if len(names) != 1 or names[0] not in SHAPES:
                raise RobotError(
                    f"{where}, line {part.sourceline}: link {link.get('name')!r} has a {part.tag} "
                    f"with {' and '.join(map(str, names)) or 'no shape'}: give one of "
                    f"{', '.join(SHAPES)}"
                )
            if names == ["capsule"]:
                _replace(part, shapes[0])
            elif names != ["mesh"] and not any(map(float, _sizes(shapes[0]))):
                link.remove(part)
    for joint in root.findall("joint"):
        ends = ENDS if joint.get("type") in LIMITED else ()
        for limit in joint.findall("limit"):
            for name in (*ends, "effort", "velocity"):
                limit.set(name, limit.get(name, "0"))
    for colour in [each for each in root.iter("color") if not _is_colour(each.get("rgba", ""))]:
        colour.getparent().remove(colour)


def bounded(root: Any) -> list[str]:
    """Take out limits that are infinite, in place: they are none.

    A joint that turns, and both of whose ends are infinite or not given, is continuous. Returns the
    names of those that have no end given.
    """
    unlimited = []
    for joint in root.findall("joint"):
        for limit in joint.findall("limit"):
            none = {name for name, text in limit.attrib.items() if _is_infinite(text)}
            given = none.symmetric_difference(limit.attrib)
            if joint.get("type") == "revolute" and given.isdisjoint(ENDS):
                joint.set("type", "continuous")
                if not none.intersection(ENDS):
                    unlimited.append(str(joint.get("name")))
            if joint.get("type") in LIMITED:
                none -= set(ENDS)
            for name in none:
                del limit.attrib[name]
    return unlimited


def _is_infinite(text: str) -> bool:
    try:
        return math.isinf(float(text))
    except ValueError:
        return False


def _sizes(shape: Any) -> list[str]:
    """The numbers of a box, cylinder or sphere."""
    return [part for name in SIZES for part in shape.get(name, "").split()]


def _is_colour(text: str) -> bool:
    """Whether a text is four numbers from 0 to 1."""
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        return False
    return len(values) == 4 and all(0 <= value <= 1 for value in values)


def _replace(part: Any, shape: Any) -> None:
    """A cylinder and two spheres in place of a capsule along z, whose length is between these."""
    radius, length = shape.get("radius", "0"), float(shape.get("length", "0"))
    origin = part.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = (
        [float(number) for number in given.get(name, "0 0 0").replace(",", " ").split()]
        for name in ("xyz", "rpy")
    )
    turn = transformations.euler_matrix(*rpy, "sxyz")[:3, :3]
    for end in (-length / 2, 0.0, length / 2):
        made = copy.deepcopy(part)
        for old in [*made.findall("origin"), *made.findall("geometry")]:
            made.remove(old)
        place = np.asarray(xyz) + turn @ [0, 0, end]
        words = (" ".join(repr(float(x)) for x in numbers) for numbers in (place, rpy))
        made.insert(0, etree.Element("origin", dict(zip(("xyz", "rpy"), words, strict=True))))
        geometry = etree.SubElement(made, "geometry")
        if end:
            etree.SubElement(geometry, "sphere", radius=radius)
        else:
            etree.SubElement(geometry, "cylinder", radius=radius, length=repr(length))
        part.addprevious(made)
    part.getparent().remove(part)
