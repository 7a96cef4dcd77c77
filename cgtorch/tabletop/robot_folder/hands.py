"""A robot's hands: how they open, and where their tool frame is."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cgtorch.tabletop.robot_folder.round_hands import around, opened_outward
from cgtorch.tabletop.robot_folder.structure import Array, Structure

MOST_TRIED = 5  # finger joints of which every combination is tried
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


@dataclass(frozen=True)
class Tool:
    """The tool frame of an arm.

    Attributes:
        link: The link of the URDF that is this frame, or None if it has to be added.
        parent: The link that carries it.
        pose: (4, 4) in that link's frame: x along the approach, y across the fingers.
        fingers: Whether there are fingers; without them, the direction of the last joint is used.
    """

    link: str | None
    parent: str
    pose: Array
    fingers: bool


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
    every = itertools.product(*ends) if len(names) <= MOST_TRIED else zip(*ends, strict=True)
    best, widest = dict[str, float](), -1.0
    for positions in every:
        tried = dict(zip(names, positions, strict=True))
        structure.urdf.model.update_cfg(tried)
        opening = _opening(structure, hand)
        if opening > widest + ROUNDING:
            best, widest = tried, opening
    structure.urdf.model.update_cfg(best)
    return best


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


def _opening(structure: Structure, hand: str) -> float:
    """The distance of the two fingers that are farthest apart at their tips, m."""
    tips = []
    for points in _branches(structure, hand):
        away = np.linalg.norm(points, axis=1)
        tips.append(points[away >= np.quantile(away, 0.75)].mean(axis=0))
    pairs = itertools.combinations(tips, 2)
    return max((float(np.linalg.norm(a - b)) for a, b in pairs), default=0.0)


def tool_of(structure: Structure, hand: str) -> Tool:
    """The tool frame of a hand with open fingers: between their tips, or before an end without any.

    x is the axis of the last joint if it leads to the fingers, else the best axis of the hand's
    frame; y leads to one finger from another, or from the middle of others around an axis. A link
    of the URDF with nearly this frame is used.
    """
    fingers = _branches(structure, hand)
    points = np.concatenate(fingers) if fingers else structure.seen(structure.rigid(hand), hand)
    points = points if len(points) else np.zeros((1, 3))
    x = _approach(structure, hand, points.mean(axis=0))
    centres = [finger.mean(axis=0) for finger in fingers]
    pair = _opposed(structure, hand, centres)
    one, other, middle = (np.zeros(3),) * 3 if pair is None else pair
    y = _across(x, one - other)
    tip = float((points @ x).max())
    if not fingers:
        tip = max(tip, _wrist_end(structure, hand, x))
    hold, (near, far) = (-FROM_TIP, NEAR_TIP) if fingers else (BEYOND_END, BEYOND)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    pose[:3, 3] = middle + x * (tip + hold - middle @ x)
    for link in sorted(structure.rigid(hand), key=lambda link: _away(structure, hand, link, pose)):
        own = np.asarray(structure.urdf.model.get_transform(link, hand))
        shift = own[:3, 3] - pose[:3, 3]
        along = float(shift @ x) - FROM_TIP * bool(fingers)
        aside = float(np.linalg.norm(shift - (shift @ x) * x))
        straight = own[:3, 0] @ x > ALONG and (pair is None or abs(own[:3, 1] @ y) > ACROSS)
        if straight and aside < ASIDE and near <= along <= far:
            return Tool(link, hand, own, bool(fingers))
    return Tool(None, hand, pose, bool(fingers))


def _opposed(
    structure: Structure, hand: str, centres: Sequence[Array]
) -> tuple[Array, Array, Array] | None:
    """A finger, what it closes against, and the middle of the hand; None without two fingers.

    These are the two fingers that are farthest apart, or one of several around an axis, and the
    middle of the others.
    """
    if around(structure, hand):
        return centres[0], np.mean(centres[1:], axis=0), np.mean(centres, axis=0)
    pairs = itertools.combinations(centres, 2)
    pair = max(pairs, default=None, key=lambda pair: float(np.linalg.norm(pair[0] - pair[1])))
    return None if pair is None else (*pair, (pair[0] + pair[1]) / 2)


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
