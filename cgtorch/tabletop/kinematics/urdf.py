"""Reading a URDF: parsed safely, checked, and completed where readers of URDF differ."""

import io
import math
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yourdfpy
from lxml import etree

from cgtorch.ground.errors import RobotError

MAX_BYTES = 8_000_000
MAX_LINKS = 500
MOST = 1e6  # m or rad: what is computed from such numbers is finite, too
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_VECTORS = (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz"), ("box", "size"))
_SCALARS = (
    ("limit", ("lower", "upper", "effort", "velocity")),
    ("safety_controller", ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")),
    ("mimic", ("multiplier", "offset")),
    ("cylinder", ("radius", "length")),
    ("sphere", ("radius",)),
    ("mass", ("value",)),
)
_LENGTHS = ("mimic", "cylinder", "sphere")


@dataclass(frozen=True)
class Urdf:
    """A URDF that has passed every check.

    Attributes:
        path: Where it was read from.
        xml: The text, with an explicit unit axis on every moving joint.
        model: The same as a `yourdfpy.URDF`, whose scene graph gives transforms between links.
    """

    path: Path
    xml: bytes
    model: Any

    def joint(self, name: str) -> Any:
        """The `yourdfpy` joint of a name.

        Raises:
            RobotError: There is no such joint.
        """
        try:
            return self.model.joint_map[name]
        except KeyError:
            raise RobotError(
                f"URDF {str(self.path)!r} has no joint {name!r}: correct the name in the robot "
                "description or add the joint"
            ) from None

    def link(self, name: str) -> Any:
        """The `yourdfpy` link of a name.

        Raises:
            RobotError: There is no such link.
        """
        try:
            return self.model.link_map[name]
        except KeyError:
            raise RobotError(
                f"URDF {str(self.path)!r} has no link {name!r}: correct the name in the robot "
                "description or add the link"
            ) from None

    def joints_between(self, base: str, tip: str) -> tuple[Any, ...]:
        """The joints that lead from one link down to another, in that order.

        Raises:
            RobotError: A link is missing, or the second does not hang from the first.
        """
        self.link(base)
        link = self.link(tip).name
        parents = {joint.child: joint for joint in self.model.robot.joints}
        path = []
        while link != base:
            if link not in parents:
                raise RobotError(
                    f"URDF {str(self.path)!r}: link {tip!r} does not hang from {base!r}: "
                    "name two links that joints connect"
                )
            path.append(parents[link])
            link = parents[link].parent
        return tuple(reversed(path))


def load_urdf(path: Path | str) -> Urdf:
    """Read and check a URDF; meshes are not loaded.

    Args:
        path: The file.

    Returns:
        The URDF.

    Raises:
        RobotError: The file cannot be read, is not well-formed XML, has a document type (which can
            name entities), or does not describe one connected tree of links with sound numbers.
    """
    path = Path(path)
    where = f"URDF {str(path)!r}"
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise RobotError(
            f"{where} cannot be read ({error.strerror}): give the path of a URDF file"
        ) from None
    if len(data) > MAX_BYTES:
        raise RobotError(f"{where} is longer than {MAX_BYTES} bytes: give a smaller file")
    root = _parse(data, where)
    _check_numbers(root, where)
    _check_tree(root, where)
    _check_joints(root, where)
    xml: bytes = etree.tostring(root)
    try:
        model = yourdfpy.URDF.load(io.BytesIO(xml), build_scene_graph=True, load_meshes=False)
        sound = model.validate()
    except Exception as error:  # yourdfpy lets through whatever its parts raise
        raise RobotError(f"{where} is refused by yourdfpy ({_line(error)}): correct it") from None
    if not sound:
        raise RobotError(f"{where} is refused by yourdfpy ({_line(model.errors[0])}): correct it")
    return Urdf(path, xml, model)


def _line(error: object) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _parse(data: bytes, where: str) -> Any:
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
        remove_comments=True, remove_pis=True, remove_blank_text=True,
    )  # fmt: skip
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(f"{where} is not well-formed XML ({_line(error)}): correct it") from None
    if root.getroottree().docinfo.doctype or root.getroottree().docinfo.internalDTD is not None:
        raise RobotError(
            f"{where} has a document type ({root.getroottree().docinfo.doctype!r}), which can "
            "name entities and files: remove the <!DOCTYPE ...> declaration"
        )
    if root.tag != "robot":
        raise RobotError(f"{where} starts with <{root.tag}>: give a file that starts with <robot>")
    return root


def _number(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        return math.nan


def _check_numbers(root: Any, where: str) -> None:
    for tag, attribute in _VECTORS:
        for element in root.iter(tag):
            text = element.get(attribute)
            if text is None:
                continue
            parts = text.replace(",", " ").split()
            if len(parts) != 3 or not all(abs(_number(part)) <= MOST for part in parts):
                raise RobotError(
                    f"{where}, line {element.sourceline}: {tag} {attribute} is {text!r}: "
                    f"give three finite numbers, of {MOST:.0e} at most"
                )
    for tag, attributes in _SCALARS:
        # Limits that are not meant are written as huge numbers.
        most = MOST if tag in _LENGTHS else sys.float_info.max
        for element in root.iter(tag):
            for attribute in attributes:
                text = element.get(attribute)
                if text is not None and not abs(_number(text)) <= most:
                    raise RobotError(
                        f"{where}, line {element.sourceline}: {tag} {attribute} is {text!r}: "
                        f"give a finite number, of {most:.0e} at most"
                    )


def _check_tree(root: Any, where: str) -> None:
    """Every name once, every link reached from one root by exactly one joint."""
    links = [link.get("name") for link in root.findall("link")]
    joints = root.findall("joint")
    if len(links) > MAX_LINKS:
        raise RobotError(f"{where} has {len(links)} links: give a robot of {MAX_LINKS} at most")
    for what, names in (("link", links), ("joint", [joint.get("name") for joint in joints])):
        for name, count in Counter(names).items():
            if not name:
                raise RobotError(f"{where}: a {what} has no name: give it one")
            if count > 1:
                raise RobotError(f"{where}: {what} {name!r} is there {count} times: keep one")
    known, parents = set(links), dict[Any, Any]()
    for joint in joints:
        name = joint.get("name")
        ends = {}
        for role in ("parent", "child"):
            element = joint.find(role)
            ends[role] = None if element is None else element.get("link")
            if ends[role] not in known:
                raise RobotError(
                    f"{where}: joint {name!r} has the {role} link {ends[role]!r}, which is not "
                    "there: name an existing link"
                )
        if ends["child"] in parents:
            raise RobotError(
                f"{where}: link {ends['child']!r} is the child of more than one joint: keep one"
            )
        parents[ends["child"]] = ends["parent"]
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise RobotError(
            f"{where} has {len(roots)} root links {roots[:4]}: connect all links to one by joints"
        )
    children: dict[Any, list[Any]] = {}
    for child, parent in parents.items():
        children.setdefault(parent, []).append(child)
    reached, front = 0, roots
    while front:
        reached += len(front)
        front = [child for link in front for child in children.get(link, ())]
    if reached < len(links):
        raise RobotError(f"{where}: some links hang from each other in a loop: break the loop")


def _check_joints(root: Any, where: str) -> None:
    """Joint types, axes and limits; a missing axis becomes the URDF's default, x."""
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if kind not in _JOINT_TYPES:
            raise RobotError(
                f"{where}: joint {name!r} has the type {kind!r}: give one of "
                f"{', '.join(_JOINT_TYPES)}"
            )
        if kind not in ("revolute", "continuous", "prismatic"):
            continue
        axis = joint.find("axis")
        if axis is None:
            axis = etree.SubElement(joint, "axis")
        text = axis.get("xyz", "1 0 0")
        values = [float(part) for part in text.replace(",", " ").split()]
        length = math.hypot(*values)
        if length < 1e-9:
            raise RobotError(f"{where}: joint {name!r} has the axis {text!r}: give it a direction")
        axis.set("xyz", " ".join(repr(value / length) for value in values))
        if kind != "continuous":
            _check_limits(joint, where)


def _check_limits(joint: Any, where: str) -> None:
    name, kind, limit = joint.get("name"), joint.get("type"), joint.find("limit")
    lower, upper = (None, None) if limit is None else (limit.get("lower"), limit.get("upper"))
    if lower is None or upper is None:
        raise RobotError(
            f"{where}: {kind} joint {name!r} has the limits ({lower}, {upper}): give "
            "<limit> a lower and an upper one, or make the joint continuous"
        )
    if float(lower) > float(upper):
        raise RobotError(
            f"{where}: joint {name!r} has the limits ({lower}, {upper}): give lower <= upper"
        )
