"""Whether the elements of a URDF are a robot: numbers, one tree of links, joints that can move."""

import math
import sys
from typing import Any

import networkx
from lxml import etree

from cgtorch.ground.errors import RobotError

MAX_LINKS, MAX_DEPTH = 500, 100
LISTED = 4  # lines or links that an error names
MOST = 1e6  # m or rad: what is computed from such numbers is finite, too
MOVING = ("revolute", "continuous", "prismatic")
_JOINT_TYPES = (*MOVING, "fixed", "floating", "planar")
_HUGE = sys.float_info.max  # which is written where no limit is meant
_NUMBERS = {
    "origin": (3, MOST, ("xyz", "rpy")),
    "axis": (3, MOST, ("xyz",)),
    "box": (3, MOST, ("size",)),
    "mimic": (1, MOST, ("multiplier", "offset")),
    "capsule": (1, MOST, ("radius", "length")),
    "cylinder": (1, MOST, ("radius", "length")),
    "sphere": (1, MOST, ("radius",)),
    "limit": (1, _HUGE, ("lower", "upper", "effort", "velocity")),
    "safety_controller": (
        1, _HUGE, ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
    ),
    "mass": (1, MOST, ("value",)),
    "inertia": (1, MOST**2, ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
}  # fmt: skip
"""How many numbers, with which upper bound, the attributes of an element contain."""


def check_numbers(root: Any, where: str) -> None:
    """Check that attributes have the right number of finite, bounded numbers."""
    for element in root.iter(*_NUMBERS):
        count, most, names = _NUMBERS[element.tag]
        for name in names:
            text = element.get(name)
            if text is None:
                continue
            parts = text.replace(",", " ").split() if count > 1 else [text]
            if len(parts) != count or not all(abs(number(part)) <= most for part in parts):
                wanted = "three finite numbers" if count > 1 else "a finite number"
                comma = count == 1 and math.isfinite(number(text.replace(",", ".")))
                raise RobotError(
                    f"{where}, line {element.sourceline}: {element.tag} {name} is {text!r}: "
                    f"give {wanted}, of {most:.0e} at most{', with a point' if comma else ''}"
                )


def number(text: str) -> float:
    """The number that a text is, or NaN."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def check_tree(root: Any, where: str) -> None:
    """Check that names are unique, and every link is reached from one root by exactly one joint."""
    named, joints = root.findall("link"), root.findall("joint")
    links = [link.get("name") for link in named]
    if len(links) > MAX_LINKS:
        raise RobotError(f"{where} has {len(links)} links: give a robot of {MAX_LINKS} at most")
    for what, elements in (("link", named), ("joint", joints)):
        lines: dict[str, list[str]] = {}
        for element in elements:
            if not (name := element.get("name")):
                raise RobotError(
                    f"{where}, line {element.sourceline}: a {what} has no name: give it one"
                )
            lines.setdefault(name, []).append(str(element.sourceline))
        for name, at in lines.items():
            if len(at) > 1:
                raise RobotError(
                    f"{where}: {what} {name!r} is there {len(at)} times, in lines "
                    f"{', '.join(at[:LISTED])}: keep one, or rename the others"
                )
    tree: networkx.DiGraph[Any] = networkx.DiGraph()
    tree.add_nodes_from(links)
    for joint in joints:
        ends = [next((e.get("link") for e in joint.iterfind(r)), None) for r in ("parent", "child")]
        for role, link in zip(("parent", "child"), ends, strict=True):
            if link not in links:
                raise RobotError(
                    f"{where}, line {joint.sourceline}: joint {joint.get('name')!r} has the {role} "
                    f"link {link!r}, which is not there: name an existing link"
                )
        if tree.in_degree(ends[1]):
            raise RobotError(
                f"{where}, line {joint.sourceline}: link {ends[1]!r} is the child of more than one "
                "joint: keep one"
            )
        tree.add_edge(*ends)
    roots = [link for link in links if not tree.in_degree(link)]
    if links and not roots:
        raise RobotError(f"{where}: all links hang from each other in a loop: break the loop")
    if len(roots) != 1:
        raise RobotError(
            f"{where} has {len(roots)} root links {roots[:LISTED]}: connect all links to one by "
            "joints"
        )
    if not networkx.is_arborescence(tree):
        raise RobotError(f"{where}: some links hang from each other in a loop: break the loop")
    depth = networkx.dag_longest_path_length(tree)
    if depth > MAX_DEPTH:
        raise RobotError(
            f"{where} has {depth} joints in a row: give a robot of {MAX_DEPTH} at most"
        )


def check_joint(joint: Any, where: str, notes: list[str] | None) -> None:
    """Check a joint's type, axis and limits; a missing axis becomes the URDF's default, x."""
    kind = joint.get("type")
    if kind not in _JOINT_TYPES:
        raise RobotError(f"{where} has the type {kind!r}: give one of {', '.join(_JOINT_TYPES)}")
    if kind not in MOVING:
        return
    axis = joint.find("axis")
    if axis is None:
        axis = etree.SubElement(joint, "axis")
    text = axis.get("xyz", "1 0 0")
    values = [float(part) for part in text.split()]
    length = math.hypot(*values)
    if length < 1e-9:
        raise RobotError(f"{where} has the axis {text!r}: give it a direction")
    axis.set("xyz", " ".join(repr(value / length) for value in values))
    if kind == "continuous":
        return
    limit = joint.find("limit")
    if limit is None:
        raise RobotError(
            f"{where}, which is {kind}, has no limits: give it a <limit> with a lower and an upper "
            "one, or make the joint continuous"
        )
    lower, upper = limit.get("lower"), limit.get("upper")
    if float(lower) > float(upper):
        if notes is None:
            raise RobotError(f"{where} has the limits ({lower}, {upper}): give lower <= upper")
        limit.set("lower", upper)
        limit.set("upper", lower)
        notes.append(
            f"joint {joint.get('name')!r} has the limits ({lower}, {upper}), which are turned round"
        )
