"""A robot's hands: how they open, and where their tool frame is."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cgtorch.tabletop.robot_folder.opposed import closing, sides
from cgtorch.tabletop.robot_folder.round_hands import around, opened_outward
from cgtorch.tabletop.robot_folder.structure import Array, Structure
from cgtorch.tabletop.robot_folder.tips import Tip, tip_of

MOST_TRIED = 5  # finger joints of which every combination is tried
WIDER = 0.005  # m by which another joint's end has to open them farther, where there are more
JAW_OPEN, STEPS = 0.1, 17  # m between its tip and the hand's, and positions that are tried
FROM_TIP = 0.02  # m from the finger tips to the middle of an object
NEAR_TIP = (-0.06, 0.005)  # m along the approach, where a frame that is there may be
BEYOND_END = (
    0.06  # m beyond the end of an arm without fingers, where a gripper would hold an object
)
BEYOND = (-0.03, 0.14)  # m from there along the approach, where a frame that is there may be
ASIDE = 0.015  # m across it
ALONG, ACROSS = 0.95, 0.9  # cosines by which axes of a frame that is there may differ
LED = 0.8  # cosine of a last joint's axis to the way to the fingers from which it leads there
ROUNDING = 1e-6  # m, or of unit vectors
SHORT = 0.5  # of the length of short fingers, how far behind their tips an object is held


@dataclass(frozen=True)
class Across:
    """How fingers oppose each other.

    Attributes:
        y: (3,) the unit vector along which they close.
        sides: Which of them are farthest along it, and which least.
        tips: Which of the points of each are at its tip.
    """

    y: Array
    sides: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    tips: tuple[NDArray[np.bool_], ...]


@dataclass(frozen=True)
class Tool:
    """The tool frame of an arm.

    Attributes:
        link: The link of the URDF that is this frame, or None if it has to be added.
        parent: The link that carries it.
        pose: (4, 4) in that link's frame: x along the approach, y across the fingers.
        fingers: Whether there are fingers; without them, the direction of the last joint is used.
        beyond: The link of a tool that points another way, beyond whose tip the frame is, or "".
    """

    link: str | None
    parent: str
    pose: Array
    fingers: bool
    beyond: str = ""


def open_fingers(structure: Structure, hand: str) -> dict[str, float]:
    """Positions of a hand's joints: each at a limit, with its fingers farthest apart.

    Fingers around an axis are each as far from it as they open.

    A single jaw, which may open as wide as a right angle, is opened for an object of usual size.
    """
    joints = [structure.above[link] for link in structure.hanging(hand)[1:]]
    joints = [j for j in joints if j.type in ("revolute", "prismatic") and j.mimic is None]
    if fingers := around(structure, hand):
        return opened_outward(structure, hand, fingers, joints)
    names = [joint.name for joint in joints]
    ends = [(float(joint.limit.lower), float(joint.limit.upper)) for joint in joints]
    if len(joints) == 1 == len(structure.moved(hand)):
        return _jaw_opened(structure, hand, names[0], *ends[0])
    across, every = _across_fingers(structure, hand), len(names) <= MOST_TRIED
    combinations = itertools.product(*ends) if every else zip(*ends, strict=True)
    tried = [dict(zip(names, positions, strict=True)) for positions in combinations]
    best, widest = _widest(structure, hand, across, tried, {}, -math.inf)
    for name, both in [] if every or across is None else zip(names, ends, strict=True):
        others = [best | {name: end} for end in both]  # a thumb may open the other way than fingers
        wider, opening = _widest(structure, hand, across, others, best, widest + WIDER)
        best, widest = (wider, opening) if wider is not best else (best, widest)
    structure.urdf.model.update_cfg(best)
    return best


def _widest(
    structure: Structure,
    hand: str,
    across: Across | None,
    tried: Sequence[dict[str, float]],
    best: dict[str, float],
    least: float,
) -> tuple[dict[str, float], float]:
    """The positions at which a hand opens farthest, and how far, m; `best` if none is wider."""
    for positions in tried:
        structure.urdf.model.update_cfg(positions)
        if (opening := _opening(structure, hand, across)) > least + ROUNDING:
            best, least = positions, opening
    return best, least


def _across_fingers(structure: Structure, hand: str) -> Across | None:
    """How the fingers of a hand at rest oppose each other; None if they do not."""
    fingers = _branches(structure, hand)
    if len(fingers) < 2:
        return None
    x = _approach(structure, hand, np.concatenate(fingers).mean(axis=0))
    centres = [finger.mean(axis=0) for finger in fingers]
    y = closing(structure, hand, x, centres)
    both = None if y is None else sides(y, centres)
    if y is None or both is None:
        return None
    return Across(y, both, tuple(_at_tip(points) for points in fingers))


def _at_tip(points: Array) -> NDArray[np.bool_]:
    """Which points of a finger, in the hand's frame, are at its tip: the farthest quarter."""
    away = np.linalg.norm(points, axis=1)
    return np.asarray(away >= np.quantile(away, 0.75))


def _jaw_opened(
    structure: Structure, hand: str, name: str, low: float, high: float
) -> dict[str, float]:
    """The position of a hand's only jaw at which it is nearest to `JAW_OPEN`."""

    def off(position: float) -> float:
        structure.urdf.model.update_cfg({name: position})
        return abs(_opening(structure, hand) - JAW_OPEN)

    best = {name: min(np.linspace(low, high, STEPS).tolist(), key=off)}
    structure.urdf.model.update_cfg(best)
    return best


def _branches(structure: Structure, hand: str) -> list[Array]:
    """The points of each finger in the hand's frame; a single jaw closes against the hand."""
    found, joints = list[Array](), structure.moved(hand)
    for joint in joints:
        points = structure.seen(structure.hanging(joint.child), hand)
        found.extend([points] if len(points) else [])
    if len(joints) == len(found) == 1:
        begin = np.asarray(structure.urdf.model.get_transform(joints[0].child, hand))[:3, 3]
        body = structure.seen(structure.rigid(hand), hand)
        beyond = body[np.linalg.norm(body, axis=1) > np.linalg.norm(begin)]
        found.extend([beyond] if len(beyond) else [])
    return found


def _opening(structure: Structure, hand: str, across: Across | None = None) -> float:
    """The distance of the two fingers that are farthest apart at their tips, m.

    Of fingers that oppose each other, it is the distance of their tips along the direction in which
    they close, which is below 0 where they have passed each other.
    """
    fingers = _branches(structure, hand)
    if across is not None and len(fingers) == len(across.tips):
        tips = [points[tip].mean(axis=0) for points, tip in zip(fingers, across.tips, strict=True)]
        along = np.stack(tips) @ across.y
        far, near = across.sides
        return float(along[far].mean() - along[near].mean())
    tips = [points[_at_tip(points)].mean(axis=0) for points in fingers]
    pairs = itertools.combinations(tips, 2)
    return max((float(np.linalg.norm(a - b)) for a, b in pairs), default=0.0)


def tool_of(structure: Structure, hand: str) -> Tool:
    """The tool frame of a hand with open fingers: between their tips, or before an end without any.

    x is the axis of the last joint if it leads to the fingers, else the best axis of the hand's
    frame; y leads along the direction in which they close, or from the middle of others around an
    axis. A link of the URDF with nearly this frame is used. A tool that points another way than the
    last joint, or lies beside it, has its frame before its own tip.
    """
    fingers = _branches(structure, hand)
    points = np.concatenate(fingers) if fingers else structure.seen(structure.rigid(hand), hand)
    points = points if len(points) else np.zeros((1, 3))
    x = _approach(structure, hand, points.mean(axis=0))
    tip = None if fingers else tip_of(structure, hand)
    if tip is not None and _leads_aside(tip, x):
        pose = _frame(tip.way, np.zeros(3), tip.at + BEYOND_END * tip.way)
        return Tool(None, hand, pose, fingers=False, beyond=tip.link)
    y, middle = _held(structure, hand, x, [finger.mean(axis=0) for finger in fingers])
    low, end = float((points @ x).min()), float((points @ x).max())
    if not fingers:
        end = max(end, _wrist_end(structure, hand, x))
    back = min(FROM_TIP, SHORT * (end - low))
    hold, (near, far) = (-back, NEAR_TIP) if fingers else (BEYOND_END, BEYOND)
    near = max(near, low - end) if fingers and back < FROM_TIP else near
    pose = _frame(x, np.zeros(3) if y is None else y, middle + x * (end + hold - middle @ x))
    for link in sorted(structure.rigid(hand), key=lambda link: _away(structure, hand, link, pose)):
        own = np.asarray(structure.urdf.model.get_transform(link, hand))
        shift = own[:3, 3] - pose[:3, 3]
        along = float(shift @ x) - back * bool(fingers)
        aside = float(np.linalg.norm(shift - (shift @ x) * x))
        straight = own[:3, 0] @ x > ALONG and (y is None or abs(own[:3, 1] @ pose[:3, 1]) > ACROSS)
        if straight and aside < ASIDE and near <= along <= far:
            return Tool(link, hand, own, bool(fingers))
    return Tool(None, hand, pose, bool(fingers))


def _frame(x: Array, across: Array, place: Array) -> Array:
    """A pose (4, 4) at a place, from its x, and about what its y is."""
    y, pose = _across(x, across), np.eye(4)
    pose[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    pose[:3, 3] = place
    return pose


def _leads_aside(tip: Tip, x: Array) -> bool:
    """Whether a tip points another way than x, or lies beside x from the last joint on."""
    off = tip.at - (tip.at @ x) * x
    return bool(tip.way @ x < ALONG or np.linalg.norm(off) > ASIDE)


def _held(
    structure: Structure, hand: str, x: Array, centres: Sequence[Array]
) -> tuple[Array | None, Array]:
    """The way across fingers with some centres, None without two of them, and their middle.

    Several around an axis have that from the middle of the others to one. Others have the direction
    in which they close, or else that of the two that are farthest apart.
    """
    if around(structure, hand):
        return centres[0] - np.mean(centres[1:], axis=0), np.mean(centres, axis=0)
    y = closing(structure, hand, x, centres) if len(centres) > 2 else None
    if y is not None:
        every, both = np.stack(centres), sides(y, centres)
        far, near = (every, every) if both is None else (every[side] for side in both)
        return y, (far.mean(axis=0) + near.mean(axis=0)) / 2
    pairs = itertools.combinations(centres, 2)
    pair = max(pairs, default=None, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))
    return (None, np.zeros(3)) if pair is None else (pair[0] - pair[1], (pair[0] + pair[1]) / 2)


def _wrist_end(structure: Structure, hand: str, x: Array) -> float:
    """How far along x, in a hand's frame, the body reaches that carries the hand, m.

    A flange may lie within the wrist that turns it, or within the shapes around this.
    """
    whole, before = replace(structure, corners={}), structure.path(hand)[-2].child
    return float((whole.seen(whole.rigid(before), hand) @ x).max(initial=-math.inf))


def _away(structure: Structure, hand: str, link: str, pose: Array) -> tuple[bool, float]:
    """The order in which links are preferred as tool frame: by name, then by distance."""
    usual = any(word in link for word in ("tool", "grasp", "tcp", "gripper"))
    own = np.asarray(structure.urdf.model.get_transform(link, hand))
    return not usual, float(np.linalg.norm(own[:3, 3] - pose[:3, 3]))


def _approach(structure: Structure, hand: str, toward: Array) -> Array:
    """The direction in a hand's frame in which it approaches things: to a point, from the arm.

    What the last joint moves may begin behind that joint, so that a direction along its axis is
    told from where the joint before it is, and so it is if the point is at that joint.
    """
    before, joint = structure.path(hand)[-2:]
    turned = np.asarray(structure.urdf.model.get_transform(joint.child, hand))
    behind = np.asarray(structure.urdf.model.get_transform(before.child, hand))[:3, 3]
    axis = turned[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
    way = toward - turned[:3, 3]
    length = float(np.linalg.norm(way))
    if length < ROUNDING or abs(float(axis @ way)) >= LED * length:
        return math.copysign(1.0, float(axis @ (toward - behind))) * axis
    own = np.eye(3)[int(np.abs(way).argmax())]
    return math.copysign(1.0, float(own @ way)) * own


def _across(x: Array, wanted: Array) -> Array:
    """The unit vector perpendicular to x that is nearest to another, or any."""
    y = wanted - (wanted @ x) * x
    if np.linalg.norm(y) < ROUNDING:
        other = np.eye(3)[int(np.abs(x).argmin())]
        y = np.cross(x, other)
    y = y / np.linalg.norm(y)
    best = np.eye(3)[int(np.abs(y).argmax())]
    return np.sign(best @ y) * best if abs(best @ x) < ROUNDING and abs(best @ y) > ACROSS else y
