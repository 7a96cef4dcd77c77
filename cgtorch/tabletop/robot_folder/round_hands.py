"""Hands whose fingers, three or more, stand evenly around an axis and move alike."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cgtorch.tabletop.robot_folder.structure import Array, Structure

LEAST_FINGERS = 3
UNEVEN = 0.1  # of their distance from the axis, or of the angle between them
ALIKE = 0.1  # of the cosines by which the axes of their joints lie to the ways outward
LEADS = 0.9  # cosine of an axis around which a finger turns outward, or along which it slides
TIPS = 0.75  # of the points of a finger, those that are nearer to its begin than its tip


def around(structure: Structure, hand: str) -> list[Any]:
    """The first joints of a hand's fingers, if these stand evenly around an axis; else none."""
    joints = [j for j in structure.moved(hand) if len(structure.seen(structure.hanging(j.child)))]
    if len(joints) < LEAST_FINGERS:
        return []
    poses = [_pose(structure, joint.child, hand) for joint in joints]
    out = np.stack([pose[:3, 3] for pose in poses])
    out = out - out.mean(axis=0)
    far = np.linalg.norm(out, axis=1)
    if np.ptp(far) > UNEVEN * far.mean() or not _even(out / far.mean()):
        return []
    axis, out = _axis(out), out / far[:, None]
    slides = joints[0].type == "prismatic"
    ways = out if slides else np.cross(axis, out)
    along = [
        float(pose[:3, :3] @ np.asarray(joint.axis, dtype=np.float64) @ way)
        for joint, pose, way in zip(joints, poses, ways, strict=True)
    ]
    kind = {joint.type == "prismatic" for joint in joints}
    turned = np.sign([_gain(joint) for joint in joints]) * along
    same = float(np.ptp(turned)) < ALIKE and abs(turned[0]) > LEADS
    return joints if len(kind) == 1 and same else []


def opened_outward(
    structure: Structure, hand: str, fingers: Sequence[Any], joints: Sequence[Any]
) -> dict[str, float]:
    """Positions of the independent joints of fingers around an axis: each finger as far from it.

    Every joint is at a limit, rad or m.
    """
    begins = np.stack([_pose(structure, finger.child, hand)[:3, 3] for finger in fingers])
    out = begins - begins.mean(axis=0)
    inside = {link for finger in fingers for link in structure.hanging(finger.child)}
    positions: dict[str, float] = {}
    for finger, way in zip(fingers, out / np.linalg.norm(out, axis=1)[:, None], strict=True):
        own = structure.hanging(finger.child)
        if not positions:  # what others follow beside the fingers is opened with the first one
            own += [joint.child for joint in joints if joint.child not in inside]
        mine = [joint for joint in joints if joint.child in own]
        best, found = -math.inf, dict[str, float]()
        for ends in itertools.product(*((j.limit.lower, j.limit.upper) for j in mine)):
            tried = {j.name: float(end) for j, end in zip(mine, ends, strict=True)}
            structure.urdf.model.update_cfg(positions | tried)
            if (far := _tip(structure, hand, finger, way)) > best:
                best, found = far, tried
        positions |= found
    structure.urdf.model.update_cfg(positions)
    return positions


def _tip(structure: Structure, hand: str, finger: Any, way: Array) -> float:
    """How far the tip of a finger is along a way in the hand's frame, m."""
    points = structure.seen(structure.hanging(finger.child), hand)
    away = np.linalg.norm(points - _pose(structure, finger.child, hand)[:3, 3], axis=1)
    return float((points[away >= np.quantile(away, TIPS)] @ way).mean())


def _pose(structure: Structure, link: str, hand: str) -> Array:
    return np.asarray(structure.urdf.model.get_transform(link, hand), dtype=np.float64)


def _axis(out: Array) -> Array:
    """The unit vector (3,) to which ways (N, 3) from a middle are perpendicular."""
    return np.asarray(np.linalg.svd(out)[2][2])


def _even(out: Array) -> bool:
    """Whether ways (N, 3) of length 1 or so lie in a plane, at equal angles to the next ones."""
    axis = _axis(out)
    if float(np.abs(out @ axis).max()) > UNEVEN:
        return False
    first = out[0] / np.linalg.norm(out[0])
    angles = np.sort(np.arctan2(out @ np.cross(axis, first), out @ first))
    steps = np.diff([*angles, angles[0] + math.tau])
    return bool(np.abs(steps - math.tau / len(out)).max() <= UNEVEN * math.tau / len(out))


def _gain(joint: Any) -> float:
    """The factor by which a joint follows another; 1 if it does not."""
    factor = None if joint.mimic is None else joint.mimic.multiplier
    return 1.0 if factor is None else float(factor)
