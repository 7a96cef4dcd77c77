"""Which joints are those of fingers, and which one is that of a jaw."""

import math
import re
from typing import Any

import numpy as np
from trimesh.transformations import rotation_matrix

from cgtorch.tabletop.robot_folder.structure import Array, Structure

FINGERS = ((9, 0.2), (4, 0.3))  # the most joints of a finger, and how far it reaches at most, m
HALF_TURN = 3.17  # rad that a jaw turns at most, with some room
JAW = 0.6  # of the reach of a jaw, that of what it closes against
OPEN = 0.8  # rad by which a jaw may be open at rest
NAMED = re.compile("finger|thumb", re.IGNORECASE)  # what no joint of an arm is called
MOST = 0.5  # of the joints before it, those that have its range if this says nothing
ASIDE = 0.2  # of its reach, how far its middle is from its axis at least
ACROSS = 0.6  # cosine of its axis to the way to its tip


def is_finger(structure: Structure, joint: Any, far: float = 0.0) -> bool:
    """Whether what hangs from a joint is as short as a finger, and carries no fingers itself.

    It may reach as far as a finger of a hand, or `far` (m).
    """
    if any(len(_own(structure, link)) > 1 for link in structure.hanging(joint.child)):
        return False
    depth, reach = depth_of(structure, joint), extent(structure, joint.child)
    return any(depth <= most and reach <= max(usual, far) for most, usual in FINGERS)


def _own(structure: Structure, link: str) -> list[Any]:
    """The independent joints of the rigid body that begins at a link."""
    return [joint for joint in structure.moved(link) if joint.mimic is None]


def is_jaw(structure: Structure, link: str, joint: Any) -> bool:
    """Whether a joint moves a jaw, which closes against a part of the body that carries it.

    A joint that is called a finger's is one.
    """
    if not is_finger(structure, joint):
        return False
    if NAMED.search(joint.name):
        return True
    if depth_of(structure, joint) > 1:
        return False
    if _turns_far(structure, joint):
        return False
    pose = structure.pose(joint.child)
    axis = pose[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
    jaw = structure.seen(structure.hanging(joint.child)) - pose[:3, 3]
    other = structure.seen(structure.rigid(link)) - pose[:3, 3]
    if not len(jaw) or not len(other):
        return len(other) > 0  # what moves nothing that is seen is no wrist
    middle = (jaw.min(axis=0) + jaw.max(axis=0)) / 2
    if joint.type == "prismatic":
        middle = middle - (middle @ axis) * axis  # wherever it slides to
    aside = float(np.linalg.norm(middle))
    if aside < ASIDE * float(np.linalg.norm(jaw, axis=1).max()):
        return False  # it lies around its axis
    way = middle / aside
    reach = max(float((other @ closed).max()) for closed in _closed(joint, axis, way))
    return bool(abs(float(axis @ way)) < ACROSS and reach >= JAW * (jaw @ way).max())


def _closed(joint: Any, axis: Array, way: Array) -> list[Array]:
    """(3,) the ways to the tip of a jaw, which may be open in its rest position."""
    if joint.type != "revolute":
        return [way]
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    turns = (max(-OPEN, min(0.0, low)), 0.0, min(OPEN, max(0.0, high)))
    return [rotation_matrix(turn, axis)[:3, :3] @ way for turn in turns]


def _turns_far(structure: Structure, joint: Any) -> bool:
    """Whether a joint turns farther than jaws do; not if most joints before it have its range."""
    *before, own = (_range(each) for each in structure.path(joint.child))
    alike = float(np.isclose(before or [own], own).mean())
    return HALF_TURN < own < math.inf and alike <= MOST


def _range(joint: Any) -> float:
    """How far a joint turns or slides, rad or m."""
    if joint.type == "continuous":
        return math.inf
    return float(joint.limit.upper) - float(joint.limit.lower)


def depth_of(structure: Structure, joint: Any) -> int:
    """The most independent joints in a row, from this one on."""
    deeper = (depth_of(structure, each) for each in structure.moved(joint.child))
    return (joint.mimic is None) + max(deeper, default=0)


def extent(structure: Structure, link: str) -> float:
    """How far what hangs from a link reaches from it, m."""
    start = structure.pose(link)[:3, 3]
    links = structure.hanging(link)
    frames = np.stack([structure.pose(name)[:3, 3] for name in links])
    points = np.concatenate([frames, structure.seen(links)])
    return float(np.linalg.norm(points - start, axis=1).max())
