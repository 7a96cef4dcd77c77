"""Reading a URDF: parsed safely, checked, and completed where URDF readers differ."""

import io
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import networkx
import numpy as np
import yourdfpy
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes
from cgtorch.tabletop.kinematics.dialects import bounded, completed

MAX_BYTES = 8_000_000
MAX_LINKS, MAX_DEPTH = 500, 100
LISTED = 4  # lines or links that an error names
REASON = 100  # characters of what another library says that an error repeats
MOST = 1e6  # m or rad: what is computed from such numbers is finite, too
MOVING = ("revolute", "continuous", "prismatic")
_JOINT_TYPES = (*MOVING, "fixed", "floating", "planar")
XACRO = "{http://www.ros.org/wiki/xacro}"
ROUNDING = 1e-6  # of moments of inertia
_HUGE = sys.float_info.max  # which is written where no limit is meant
_SAFE = {
    "resolve_entities": False, "no_network": True, "load_dtd": False, "remove_comments": True,
    "remove_pis": True, "remove_blank_text": True,
}  # fmt: skip
"""How XML is parsed, so that nothing that it names is read."""
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


@dataclass(frozen=True)
class Urdf:
    """A URDF that has passed all checks.

    Attributes:
        path: The path of its file.
        xml: The text, with an explicit unit axis at every moving joint.
        model: The same as a `yourdfpy.URDF`, whose scene graph gives transforms between links.
    """

    path: Path
    xml: bytes
    model: Any

    def joint(self, name: str) -> Any:
        """The `yourdfpy` joint with a name; RobotError if there is none."""
        return self._named("joint", name, self.model.joint_map)

    def link(self, name: str) -> Any:
        """The `yourdfpy` link with a name; RobotError if there is none."""
        return self._named("link", name, self.model.link_map)

    def _named(self, kind: str, name: str, known: Mapping[str, Any]) -> Any:
        if name not in known:
            raise RobotError(
                f"URDF {str(self.path)!r} has no {kind} {name!r}: correct the name in the robot "
                f"description or add the {kind}"
            )
        return known[name]

    def joints_above(self, link: str, base: str) -> tuple[Any, ...]:
        """The joints from a link up to another, or up to the root if it does not hang from it."""
        parents = {joint.child: joint for joint in self.model.robot.joints}
        path = []
        while link != base and link in parents:
            path.append(parents[link])
            link = parents[link].parent
        return tuple(path)

    def joints_between(self, base: str, tip: str) -> tuple[Any, ...]:
        """Joints from one link down to another; RobotError if it is missing or hangs elsewhere."""
        self.link(base)
        path = self.joints_above(self.link(tip).name, base)
        if tip != base and (not path or path[-1].parent != base):
            raise RobotError(
                f"URDF {str(self.path)!r}: link {tip!r} does not hang from {base!r}: "
                "name two links that joints connect"
            )
        return path[::-1]


def load_urdf(path: Path | str) -> Urdf:
    """Read and check a URDF; meshes are not loaded.

    RobotError if it cannot be read, is not well-formed XML, has a document type (which can name
    entities), is not one connected tree of links with valid numbers, or a link has an impossible
    inertia.
    """
    urdf = checked_urdf(Path(path), read_urdf(Path(path)))
    for link in urdf.model.robot.links:
        problem = inertial_problem(link)
        if problem:
            raise RobotError(
                f"URDF {str(urdf.path)!r}: link {link.name!r} has {problem}: correct it, or let "
                "cgtorch-robot make a robot folder with one made up"
            )
    return urdf


def read_urdf(path: Path, notes: list[str] | None = None) -> Any:
    """The elements of a valid URDF, whose inertias are not checked.

    With notes, limits whose lower one is above the upper one are turned round, which is noted, and
    so is a joint that turns without end as its limit has no ends.
    """
    where = f"URDF {str(path)!r}"
    data = read_bytes(path, MAX_BYTES, RobotError)
    root = parsed(data, where)
    if root.tag != "robot":
        raise RobotError(f"{where} starts with <{root.tag}>: give a file that starts with <robot>")
    unfilled = root.find("link") is None or b"${" in data
    if unfilled and any(str(element.tag).startswith(XACRO) for element in root.iter()):
        raise RobotError(f"{where} is a xacro file: make a URDF of it by `xacro FILE > robot.urdf`")
    unlimited = bounded(root)
    if notes is not None:
        notes.extend(
            f"joint {each!r} has no limits and is taken for continuous" for each in unlimited
        )
    _check_numbers(root, where)
    _check_tree(root, where)
    completed(root, where)
    for joint in root.findall("joint"):
        _check_joint(joint, f"{where}, line {joint.sourceline}: joint {joint.get('name')!r}", notes)
    return root


def checked_urdf(path: Path, root: Any) -> Urdf:
    """The URDF of a valid tree of elements; RobotError if yourdfpy refuses it."""
    where = f"URDF {str(path)!r}"
    xml: bytes = etree.tostring(root)
    try:
        model = yourdfpy.URDF.load(io.BytesIO(xml), build_scene_graph=True, load_meshes=False)
        refused = None if model.validate() else model.errors[0]
    except Exception as error:  # yourdfpy lets through whatever its parts raise
        refused = error
    if refused is not None:
        raise RobotError(f"{where} is refused by yourdfpy ({one_line(refused)}): correct it")
    return Urdf(path, xml, model)


def inertial_problem(link: Any) -> str:
    """The physical fault of a link's inertia, "" if there is none."""
    inertial = link.inertial
    if inertial is None:
        return ""
    if inertial.mass is not None and inertial.mass < 0:
        return f"the mass {inertial.mass} kg"
    if inertial.inertia is not None:
        least, _, most = np.linalg.eigvalsh(inertial.inertia)
        if least < -ROUNDING * max(abs(most), ROUNDING):
            return f"an inertia of {least:.3g} kg m² about one of its axes"
        if most > MOST:
            return (
                f"an inertia of {most:.3g} kg m² about one of its axes, which is above {MOST:.0e}"
            )
    return ""


def one_line(error: object) -> str:
    """The words of an error in one line; the name of its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def parsed(data: bytes, where: str, huge: bool = False) -> Any:
    """The root element of XML, without comments; nothing that it names is read.

    RobotError if it is not well-formed or has a document type, which can name entities and files.
    `huge` is whether it may be deep and have long texts.
    """
    options = {**_SAFE, "huge_tree": huge}
    try:
        root = _tree(data, options)
    except (etree.XMLSyntaxError, ValueError) as error:
        reason = one_line(error)[:REASON]
        raise RobotError(f"{where} is not well-formed XML ({reason}): correct it") from None
    info = root.getroottree().docinfo
    if info.internalDTD is not None:
        raise RobotError(
            f"{where} has a document type ({info.doctype!r:.100}), which can name entities and "
            "files: remove the <!DOCTYPE ...> declaration"
        )
    return root


def _tree(data: bytes, options: dict[str, bool]) -> Any:
    """The root element, also where a name has a prefix that nothing declares, as ROS reads it."""
    parser = etree.XMLParser(**options)
    try:
        return etree.fromstring(data, parser)
    except etree.XMLSyntaxError:
        kinds = {entry.type for entry in parser.error_log}
        if kinds != {etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE}:
            raise
    root = etree.fromstring(data, etree.XMLParser(**options, recover=True))
    for element in list(root.iter("*")):
        for name in [name for name in element.attrib if ":" in name]:
            del element.attrib[name]
        if ":" in element.tag and element is not root:
            element.getparent().remove(element)
    return root


def at_rest(joint: Any) -> float:
    """The position of a moving joint that is nearest to 0 within its limits, rad or m."""
    if joint.type == "continuous" or joint.limit is None:
        return 0.0
    return float(min(max(0.0, joint.limit.lower), joint.limit.upper))


def mimic_of(joint: Any) -> tuple[float, float]:
    """Offset and factor of a joint that follows another."""
    factor = joint.mimic.multiplier
    return joint.mimic.offset or 0.0, 1.0 if factor is None else factor


def _check_numbers(root: Any, where: str) -> None:
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
                raise RobotError(
                    f"{where}, line {element.sourceline}: {element.tag} {name} is {text!r}: "
                    f"give {wanted}, of {most:.0e} at most"
                )


def number(text: str) -> float:
    """The number that a text is, or NaN."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _check_tree(root: Any, where: str) -> None:
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
                    f"{', '.join(at[:LISTED])}: keep one"
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


def _check_joint(joint: Any, where: str, notes: list[str] | None) -> None:
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
