"""Reading an SRDF, which says of a URDF what its arms, hands and named states are."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import read_bytes
from cgtorch.tabletop.kinematics.description import Arm
from cgtorch.tabletop.kinematics.urdf import MAX_BYTES, MOVING, Urdf, parsed
from cgtorch.tabletop.kinematics.valid import number
from cgtorch.tabletop.robot_folder.chains import FEW_JOINTS

ARMS = {"arm", "larm", "rarm", "manipulator"}
"""Words in names of groups that are arms, where no end effector says so."""
OTHERS = {"leg", "legs", "foot", "feet", "head", "neck", "wheel"}
"""Words in names of groups that are no arms, though they have an end effector."""
HOME, OPEN = ("home", "ready"), ("open", "opened")
"""Names of the states that are used, first of all."""
LISTED = 4  # names that a note tells


@dataclass(frozen=True)
class Semantics:
    """The part of an SRDF that is used.

    Attributes:
        arms: From the link that carries an arm to the last link that its joints move.
        home: Positions of joints of arms in the state home, rad or m; empty unless all have one.
        opened: Positions of other joints in the state open, rad or m.
        apart: Pairs of links that never collide.
        notes: What is used, and what names something that the URDF lacks.
    """

    arms: tuple[Arm, ...] = ()
    home: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    opened: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    apart: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


def srdf_beside(urdf: Path) -> Path | None:
    """The SRDF with the name of a URDF in its folder, if there is one."""
    beside = urdf.with_suffix(".srdf")
    return beside if beside.is_file() else None


def read_srdf(path: Path, urdf: Urdf) -> Semantics:
    """What an SRDF says of a URDF.

    Names that the URDF lacks are left out, with a note. RobotError if the file cannot be read, is
    not well-formed XML, has a document type or another root than <robot>, or its groups contain
    each other in a circle.
    """
    where = f"SRDF {str(path)!r}"
    root = parsed(read_bytes(path, MAX_BYTES, RobotError), where)
    if root.tag != "robot":
        raise RobotError(f"{where} starts with <{root.tag}>: give a file that starts with <robot>")
    reader = _Reader(where, urdf, {each.get("name"): each for each in root.findall("group")}, [])
    groups = {name: reader.joints(name, ()) for name in reader.groups if name}
    serial = {name: arm for name in groups if (arm := reader.arm(name, groups[name])) is not None}
    arms = _arms(root, reader, serial)
    inside = {joint for arm in arms for joint in groups[arm.name]}
    states = reader.states(root)
    home = _first(states, HOME, inside)
    home = home if inside <= home.keys() else {}
    opened = _first(states, OPEN, set(urdf.model.joint_map) - inside)
    notes = (
        [f"the arms are those of {where}: {', '.join(arm.name for arm in arms)}"] if arms else []
    )
    if home:
        notes.append(f"home is that of {where}")
    apart = reader.apart(root)
    if reader.missing:
        names = list(dict.fromkeys(reader.missing))
        more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
        listed = ", ".join(map(repr, names[:LISTED]))
        notes.append(f"{where} names {listed}{more}, which the URDF lacks, so that is left out")
    return Semantics(arms, home, opened, apart, tuple(notes))


@dataclass(frozen=True)
class _Reader:
    """Reads elements, and collects names that the URDF lacks.

    Attributes:
        where: The name of the file, for errors.
        urdf: The URDF.
        groups: The elements of groups, by name.
        missing: Names that the URDF or the groups lack.
    """

    where: str
    urdf: Urdf
    groups: Mapping[str | None, Any]
    missing: list[str]

    def joints(self, name: str, within: tuple[str, ...]) -> dict[str, Any]:
        """The independent moving joints of a group, by name; RobotError for a circle of groups."""
        if name in within:
            circle = " in ".join(map(repr, (*within[within.index(name) :], name)))
            raise RobotError(f"{self.where} has groups in a circle, {circle}: break it")
        model, element = self.urdf.model, self.groups[name]
        found: list[Any] = []
        for part in element.findall("joint"):
            found += self.known(part.get("name"), model.joint_map)
        for part in element.findall("link"):
            for link in self.known(part.get("name"), model.link_map):
                found += self.urdf.joints_above(link.name, "")[:1]
        for part in element.findall("chain"):
            ends = [self.known(part.get(key), model.link_map) for key in ("base_link", "tip_link")]
            if all(ends):
                found += self.urdf.joints_above(ends[1][0].name, ends[0][0].name)
        every = {joint.name: joint for joint in found}
        for part in element.findall("group"):
            for other in self.known(part.get("name"), self.groups):
                every |= self.joints(other.get("name"), (*within, name))
        return {
            key: joint
            for key, joint in every.items()
            if joint.type in MOVING and joint.mimic is None
        }

    def known(self, name: str | None, names: Mapping[Any, Any]) -> list[Any]:
        """What has a name, or nothing, with a note."""
        if name in names:
            return [names[name]]
        self.missing.append(str(name))
        return []

    def arm(self, name: str, joints: Mapping[str, Any]) -> Arm | None:
        """A group as an arm, if its joints follow each other and are enough."""
        paths = {key: self.path(joint.child) for key, joint in joints.items()}
        if len(joints) < FEW_JOINTS:
            return None
        last = max(joints, key=lambda key: len(paths[key]))
        mine = [joint for joint in paths[last] if joint.name in joints]
        if len(mine) < len(joints):
            return None
        return Arm(name, str(mine[-1].parent), str(mine[0].child))

    def path(self, link: str) -> list[Any]:
        """The independent moving joints above a link, the nearest first."""
        joints = self.urdf.joints_above(link, "")
        return [joint for joint in joints if joint.type in MOVING and joint.mimic is None]

    def states(self, root: Any) -> dict[str, dict[str, float]]:
        """Positions of joints within their limits in named states, in lower case, rad or m."""
        found: dict[str, dict[str, float]] = {}
        for state in root.findall("group_state"):
            at = found.setdefault(str(state.get("name")).lower(), {})
            for part in state.findall("joint"):
                for joint in self.known(part.get("name"), self.urdf.model.joint_map):
                    position = number(part.get("value", ""))
                    if joint.type in MOVING and joint.mimic is None and _within(joint, position):
                        at[joint.name] = position
        return found

    def apart(self, root: Any) -> tuple[tuple[str, str], ...]:
        """The pairs of links whose collisions are disabled."""
        found: dict[tuple[str, str], None] = {}
        for part in root.findall("disable_collisions"):
            both = (self.known(part.get(key), self.urdf.model.link_map) for key in _PAIR)
            one, other = ([link.name for link in each] for each in both)
            if one and other and one != other:
                found[min(one[0], other[0]), max(one[0], other[0])] = None
        return tuple(found)


_PAIR = "link1", "link2"


def _within(joint: Any, position: float) -> bool:
    """Whether a position, which may be no number, is within a joint's limits."""
    if joint.type == "continuous":
        return abs(position) < float("inf")
    return bool(joint.limit.lower <= position <= joint.limit.upper)


def _first(
    states: Mapping[str, Mapping[str, float]], names: tuple[str, ...], joints: set[str]
) -> dict[str, float]:
    """The positions of some joints in the first of the named states that has any."""
    for name in names:
        found = {key: at for key, at in states.get(name, {}).items() if key in joints}
        if found:
            return found
    return {}


def _arms(root: Any, reader: _Reader, serial: Mapping[str, Arm]) -> tuple[Arm, ...]:
    """The groups that are arms: those with an end effector, or with the name of an arm.

    Of groups with the same last joint, the one with the fewest joints is taken.
    """
    chosen: list[Arm] = []
    for effector in root.findall("end_effector"):
        for link in reader.known(effector.get("parent_link"), reader.urdf.model.link_map):
            path = reader.path(link.name)
            ends = [arm for arm in serial.values() if path and arm.tool_frame == path[0].child]
            given = [arm for arm in ends if arm.name == effector.get("parent_group")]
            chosen += (given or _shortest(reader, ends))[:1]
    chosen = [arm for arm in chosen if not OTHERS & _words(arm.name)]
    if not chosen:
        chosen = [arm for arm in serial.values() if ARMS & _words(arm.name)]
    tips = dict.fromkeys(arm.tool_frame for arm in chosen)
    each = (_shortest(reader, [arm for arm in chosen if arm.tool_frame == tip])[0] for tip in tips)
    return tuple(each)


def _shortest(reader: _Reader, arms: list[Arm]) -> list[Arm]:
    return sorted(arms, key=lambda arm: -len(reader.path(arm.base_link)))


def _words(name: str) -> set[str]:
    return set(re.findall(r"[a-z]+", name.lower()))
