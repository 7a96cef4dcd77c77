"""Reading a URDF: parsed safely, checked, and completed where URDF readers differ."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yourdfpy
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes
from cgtorch.tabletop.kinematics.dialects import bounded, completed, without_namespace
from cgtorch.tabletop.kinematics.followers import first_leads, led
from cgtorch.tabletop.kinematics.valid import MOST, check_joint, check_numbers, check_tree
from cgtorch.tabletop.kinematics.valid import MOVING as MOVING

MAX_BYTES = 8_000_000
REASON = 100  # characters of what another library says that an error repeats
XACRO = "{http://www.ros.org/wiki/xacro}"
ROUNDING = 1e-6  # of moments of inertia
_SAFE = {
    "resolve_entities": False, "no_network": True, "load_dtd": False, "remove_comments": True,
    "remove_pis": True, "remove_blank_text": True,
}  # fmt: skip
"""How XML is parsed, so that nothing that it names is read."""


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
    so is a joint that turns without end as its limit has no ends, is held still as what it follows
    is, or leads what it followed, as that is farther out.
    """
    where = f"URDF {str(path)!r}"
    data = read_bytes(path, MAX_BYTES, RobotError)
    root = parsed(data, where)
    is_xacro = any(str(element.tag).startswith(XACRO) for element in root.iter())
    without_namespace(root)
    if root.tag != "robot":
        raise RobotError(f"{where} starts with <{root.tag}>: give a file that starts with <robot>")
    unfilled = root.find("link") is None or b"${" in data
    if unfilled and is_xacro:
        raise RobotError(f"{where} is a xacro file: make a URDF of it by `xacro FILE > robot.urdf`")
    unlimited = bounded(root)
    if notes is not None:
        notes.extend(
            f"joint {each!r} has no limits and is taken for continuous" for each in unlimited
        )
    check_numbers(root, where)
    check_tree(root, where)
    completed(root, where)
    for joint in root.findall("joint"):
        check_joint(joint, f"{where}, line {joint.sourceline}: joint {joint.get('name')!r}", notes)
    still = led(root)
    if notes is not None and still:
        notes.append(
            f"{', '.join(still)}: held still, as what they follow does not move, is not there, or "
            "follows them in a circle; correct <mimic> if they should move"
        )
    if notes is not None:
        notes.extend(
            f"{first!r} leads {last!r} now, which it followed in the URDF, as it is before that"
            for first, last in first_leads(root).items()
        )
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
