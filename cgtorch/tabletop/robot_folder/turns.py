"""Which way round an arm holds a tool frame, as the range of its last joint may allow one only."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from cgtorch.tabletop.kinematics.origins import add_origin, pose_of
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, checked_urdf, mimic_of
from cgtorch.tabletop.robot_folder.structure import Array, Structure

POSTURES = 16384  # random ones of an arm
FORWARD, SLANTED = 0.8, 0.8  # of an approach: at least along x, and at most downwards
LEVEL = 0.26  # of the direction across the fingers, at most up or down
RARE = 1 / 3  # of the postures with the frame upside down, those with it upright that are too few
FULL = 6.1  # rad, nearly a full turn
OVER = np.diag([1.0, -1.0, -1.0, 1.0])  # half a turn about x


def upright(structure: Structure, chain: Sequence[Any], link: str, pose: Array) -> Array:
    """The pose (4, 4) of a tool frame in the frame of a link of an arm, z up before the robot.

    Where the arm can nearly only hold it with z down, it is turned by half a turn about x, its
    approach, which leaves y across the fingers.
    """
    turns = (_turns(structure, chain, link) * Rotation.from_matrix(pose[:3, :3])).as_matrix()
    x, y, z = np.moveaxis(turns, 2, 0)
    ahead = (x[:, 0] > FORWARD) & (np.abs(x[:, 2] + SLANTED / 2) < SLANTED / 2 + LEVEL)
    held = ahead & (np.abs(y[:, 2]) < LEVEL)
    up, down = int((held & (z[:, 2] > 0)).sum()), int((held & (z[:, 2] < 0)).sum())
    return np.asarray(pose @ OVER) if up < RARE * down else pose


def turned_over(urdf: Urdf, frames: Sequence[str]) -> Urdf:
    """A URDF whose links of some names, which fixed joints carry, are turned by half a turn."""
    root = etree.fromstring(urdf.xml)
    for joint in root.findall("joint"):
        if joint.find("child").get("link") in frames:
            pose = pose_of(joint) @ OVER
            joint.remove(joint.find("origin"))
            add_origin(joint, pose)
    return checked_urdf(urdf.path, root)


def turns_fully(structure: Structure, link: str) -> bool:
    """Whether the last joint before a link turns by so much that it may be held both ways round."""
    *_, last = structure.path(link)
    low, high = _ends(last)
    return last.type != "prismatic" and high - low > FULL


def _turns(structure: Structure, chain: Sequence[Any], link: str) -> Rotation:
    """How a link of an arm is turned in the base frame in random postures."""
    rng = np.random.default_rng(0)
    at = {joint.name: rng.uniform(*_ends(joint), POSTURES) for joint in chain}
    begin = chain[0].parent
    turns = Rotation.from_matrix(structure.pose(begin)[:3, :3])
    for joint in structure.urdf.joints_between(begin, link):
        origin = np.eye(4) if joint.origin is None else joint.origin
        turns = turns * Rotation.from_matrix(origin[:3, :3])
        if joint.type in MOVING and joint.type != "prismatic":
            turns = turns * Rotation.from_rotvec(np.outer(_position(joint, at), joint.axis))
    return turns


def _position(joint: Any, at: dict[str, Array]) -> Array:
    """The positions (N,) of a joint, which may follow another, rad."""
    if joint.mimic is None:
        return at[joint.name]
    offset, factor = mimic_of(joint)
    return offset + factor * at[joint.mimic.joint]


def _ends(joint: Any) -> tuple[float, float]:
    """The ends of a joint's range, rad or m."""
    if joint.type == "continuous":
        return -math.pi, math.pi
    return float(joint.limit.lower), float(joint.limit.upper)
