"""Proposing a robot description from a URDF: base, footprint, torso, arms, hands and body."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from lxml import etree

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.description import Arm, RobotDescription
from cgtorch.tabletop.kinematics.urdf import Urdf, checked_urdf
from cgtorch.tabletop.robot_folder.base import add_frame, base_of, placed_base, rest_positions
from cgtorch.tabletop.robot_folder.chains import (
    ARM,
    FEW_JOINTS,
    chains_of,
    slides_upright,
    told,
)
from cgtorch.tabletop.robot_folder.hands import BEYOND_END, Tool, open_fingers, tool_of
from cgtorch.tabletop.robot_folder.lying import lying
from cgtorch.tabletop.robot_folder.named import (
    chains_as_named,
    chains_of_groups,
    from_base,
    hand_of,
)
from cgtorch.tabletop.robot_folder.solid import solid_arms
from cgtorch.tabletop.robot_folder.structure import Array, Structure
from cgtorch.tabletop.robot_folder.turns import upright

WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
LEAST_SIDE = 10.0  # mm of a footprint
LOW = 0.5  # m: shapes that begin below are seen by the footprint
ABOVE_WHEELS = 0.3  # m: no arm reaches shapes that end below
SHOULDER = 1.0  # m above the floor, where a torso holds its arms


@dataclass(frozen=True)
class Wishes:
    """The user's part of a description; None or empty parts are proposed.

    Attributes:
        name: The name of the robot.
        base_frame, footprint, torso_position, arms, body: As in `RobotDescription`.
        torso_joint: As there; an empty text for none.
        groups: Arms from the link that carries each to the last link that its joints move, which
            an SRDF names; their tool frames are proposed.
        excludes: As in `RobotDescription`.
        stand: The height of a stand on which the robot is put, m; 0 for none.
        held: Positions of joints outside the arms, rad or m.
        home: Positions of the arms' joints while the robot drives, rad or m.
    """

    name: str | None = None
    base_frame: str | None = None
    footprint: tuple[float, float, float, float] | None = None
    torso_joint: str | None = None
    torso_position: float | None = None
    arms: tuple[Arm, ...] = ()
    body: tuple[str, ...] = ()
    groups: tuple[Arm, ...] = ()
    excludes: tuple[tuple[str, ...], ...] = ()
    stand: float = 0.0
    held: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    home: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True)
class Proposal:
    """A description of a robot, its URDF, and what a person should check."""

    urdf: Urdf
    words: RobotDescription
    notes: tuple[str, ...]


def propose(
    urdf: Urdf,
    wishes: Wishes,
    corners: Mapping[str, Sequence[Array]] = MappingProxyType({}),
    changes: Sequence[str] = (),
) -> Proposal:
    """A description of a robot whose URDF has no meshes, and the URDF with additional frames.

    `corners` are those of meshes that have been replaced; see `Structure`. `changes` is what was
    changed in the URDF's joints, which is told.

    RobotError if no arm is found or given, or a link or joint of a wish does not exist.
    """
    notes = list(changes)
    for name in wishes.held:
        urdf.joint(name)
    found = base_of(Structure(urdf, urdf.model.base_link, corners), wishes.base_frame, notes)
    structure = Structure(urdf, found.link, corners)
    urdf.model.update_cfg(rest_positions(urdf) | dict(wishes.held))
    given = wishes.arms or wishes.groups
    if given:
        hands = [hand_of(structure, arm) for arm in given]
        read = chains_as_named if wishes.arms else chains_of_groups
        shared, chains = read(structure, given, hands)
    else:
        hands, shared, chains = _found(structure, notes)
    structure = replace(structure, urdf=solid_arms(structure, chains, hands, notes))
    structure.urdf.model.update_cfg(rest_positions(urdf) | dict(wishes.held))
    notes += lying(structure, chains)
    urdf, base = placed_base(structure, found, chains, wishes.stand, notes)
    structure = Structure(urdf, base, corners)
    urdf.model.update_cfg(rest_positions(urdf) | dict(wishes.held))
    opened = {k: v for hand in hands for k, v in open_fingers(structure, hand).items()}
    torso = _torso(structure, shared, wishes)
    in_arms = {joint.name for chain in chains for joint in chain}
    held = rest_positions(urdf, tuple(in_arms)) | opened | dict(wishes.held)
    position = None if torso is None else held.pop(torso, None)
    position = wishes.torso_position if wishes.torso_position is not None else position
    urdf.model.update_cfg(held if torso is None else {**held, torso: position})
    below = [joint.name for hand in hands for joint in structure.path(hand)]
    notes += _held_below(held, [name for name in below if name not in wishes.held])
    if torso is not None and wishes.torso_position is None:
        position = _torso_position(structure, urdf.joint(torso), chains)
    arms = tuple(from_base(structure, arm) for arm in wishes.arms)
    if not arms:
        urdf, arms = _arms(structure, hands, chains, notes)
        structure = Structure(urdf, base, corners)
    urdf.model.update_cfg(held if torso is None else {**held, torso: position})
    for arm, chain in zip(arms, chains, strict=True):
        if not any(len(structure.points(name)) for name in structure.hanging(chain[0].child)):
            raise RobotError(
                f"URDF {str(urdf.path)!r}: nothing of arm {arm.name!r}, from joint "
                f"{chain[0].name!r} on, has a shape: add collision or visual shapes, by which it "
                "is seen what the arm touches"
            )
    moved = {name for chain in chains for name in structure.hanging(chain[0].child)}
    body = wishes.body or _body(structure, moved)
    words = RobotDescription(
        name=wishes.name or urdf.model.robot.name or urdf.path.stem,
        base_frame=base,
        footprint=wishes.footprint or _footprint(structure, moved, notes),
        arms=arms,
        torso_joint=torso,
        torso_position=position,
        body=body,
        gripper_joints=held,
        home=wishes.home,
        excludes=wishes.excludes,
    )
    return Proposal(urdf, words, tuple(notes))


def _found(structure: Structure, notes: list[str]) -> tuple[list[str], list[Any], list[list[Any]]]:
    """The hands of the arms that are found, the joints of their torso, and those of each arm."""
    every = chains_of(structure)
    arms = [chain for chain in every if chain.kind == ARM]
    others = told(every)
    if not arms:
        raise RobotError(
            f"URDF {str(structure.urdf.path)!r} has no chain of {FEW_JOINTS} joints or more from "
            f"a body or torso to a hand{f' (no arms: {others})' if others else ''}"
            f"{''.join(f'; {note}' for note in notes)}: name the arms by --arm "
            "NAME=BASE_LINK:TOOL_FRAME"
        )
    if others:
        notes.append(f"no arms: {others}; name them by --arm if that is wrong")
    before = [{joint.name: joint for joint in arm.joints[: arm.shared]} for arm in arms]
    shared = [joint for name, joint in before[0].items() if all(name in each for each in before)]
    return [arm.link for arm in arms], shared, [list(arm.own) for arm in arms]


def _torso(structure: Structure, shared: list[Any], wishes: Wishes) -> str | None:
    if wishes.torso_joint is not None:
        return str(structure.urdf.joint(wishes.torso_joint).name) if wishes.torso_joint else None
    slides = [joint.name for joint in shared if slides_upright(structure, joint)]
    return slides[-1] if slides else None


def _held_below(held: Mapping[str, float], names: Sequence[str]) -> list[str]:
    """A note on joints that are held although they move arms."""
    found = [f"{name!r} at {held[name]:g}" for name in dict.fromkeys(names) if name in held]
    if not found:
        return []
    return [
        f"what moves a whole arm is held, {', '.join(found)}: give other positions by --hold, or "
        "name an arm that has these joints by --arm NAME=BASE_LINK:TOOL_FRAME"
    ]


def _torso_position(structure: Structure, joint: Any, chains: list[list[Any]]) -> float:
    """The position at which the shoulders are nearest to one metre above the floor."""
    if joint.type == "continuous":
        return 0.0
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    room = 0.05 * (high - low)
    structure.urdf.model.update_cfg({joint.name: low})
    height = min(float(structure.pose(chain[0].child)[2, 3]) for chain in chains)
    return round(min(max(low + SHOULDER - height, low + room), high - room), 3)


def _arms(
    structure: Structure, hands: list[str], chains: list[list[Any]], notes: list[str]
) -> tuple[Urdf, tuple[Arm, ...]]:
    """The arms, and a URDF with the missing tool frames."""
    root, arms = etree.fromstring(structure.urdf.xml), []
    for name, hand, chain in zip(_names(structure, chains), hands, chains, strict=True):
        tool = tool_of(structure, hand)
        frame = tool.link
        if frame is None:
            frame = f"{name}_tool_frame"
            while frame in structure.below:
                frame += "_added"
            pose = upright(structure, chain, tool.parent, tool.pose)
            add_frame(root, frame, tool.parent, pose)
            notes.append(f"arm {name!r}: the link {frame!r} was added {_where(tool)}")
        if not tool.fingers:
            notes.append(f"arm {name!r} has no fingers: it needs a gripper to grasp anything")
        arms.append(Arm(name, chain[0].parent, frame))
    added = len(root) > len(etree.fromstring(structure.urdf.xml))
    return checked_urdf(structure.urdf.path, root) if added else structure.urdf, tuple(arms)


def _where(tool: Tool) -> str:
    x, y, z = tool.pose[:3, 3]
    end = f"{tool.beyond!r}, the way it points" if tool.beyond else "its end"
    place = "between its finger tips" if tool.fingers else f"{BEYOND_END} m beyond {end}"
    return f"{place}, at ({x:.3f}, {y:.3f}, {z:.3f}) m in {tool.parent!r}"


def _names(structure: Structure, chains: list[list[Any]]) -> list[str]:
    """Left and right as all their links are named, or for two arms side by side; else numbers."""
    if len(chains) == 1:
        return ["arm"]
    sides = [{_side(joint.child) for joint in chain} for chain in chains]
    if sorted(map(sorted, sides)) == [["left"], ["right"]]:
        return [next(iter(side)) for side in sides]
    return _numbered(structure, chains)


def _side(link: str) -> str:
    """The side in a link's name, "left" or "right"; "" if there is none or both."""
    words = {word.lower() for word in WORD.findall(link)}
    found = [side for side in ("left", "right") if words & {side, side[0]}]
    return found[0] if len(found) == 1 else ""


def _numbered(structure: Structure, chains: list[list[Any]]) -> list[str]:
    """Left and right for two arms side by side, else numbers."""
    sides = [float(structure.pose(chain[0].child)[1, 3]) for chain in chains]
    if len(chains) == 2 and min(sides) < 0 < max(sides):
        return ["left" if side > 0 else "right" for side in sides]
    return [f"arm-{i + 1}" for i in range(len(chains))]


def _body(structure: Structure, moved: set[str]) -> tuple[str, ...]:
    """The collision links that no arm moves and that are not entirely low."""
    points = {name: structure.points(name) for name in structure.hanging(structure.base)}
    return tuple(
        name
        for name, each in points.items()
        if name not in moved and len(each) and each[:, 2].max() > ABOVE_WHEELS
    )


def _footprint(
    structure: Structure, moved: set[str], notes: list[str]
) -> tuple[float, float, float, float]:
    """The rectangle around the shapes near the floor that no arm moves, in full mm."""
    own = [name for name in structure.hanging(structure.base) if name not in moved]
    shapes = [each for name in own for each in structure.shapes(name)]
    low = [each for each in shapes if each[:, 2].min() < LOW] or shapes
    if not low:
        notes.append("nothing but arms collides: the footprint is a square of 0.2 m, give yours")
        return -0.1, 0.1, -0.1, 0.1
    points = np.concatenate(low)[:, :2] * 1000
    least, most = points.min(axis=0).round(2), points.max(axis=0).round(2)  # files are rounded, too
    room = np.maximum(LEAST_SIDE - (most - least), 0) / 2
    (x0, y0), (x1, y1) = np.floor(least - room) / 1000, np.ceil(most + room) / 1000
    return float(x0), float(x1), float(y0), float(y1)
