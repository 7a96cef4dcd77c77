"""Where an arm without fingers ends, as its tool points another way than its last joint."""

import re
from dataclasses import dataclass

import numpy as np

from cgtorch.tabletop.robot_folder.structure import Array, Structure

NAMED = re.compile(
    "tcp|tip|tool|suction|sucker|vacuum|cup|nozzle|torch|needle|effector", re.IGNORECASE
)
SEES = re.compile("cam|sensor|lidar|laser|imu|optical", re.IGNORECASE)
LEAST = 1e-3  # m from the middle of a part to its end
WITHIN = 5e-3  # m that a frame at the end of a part may be within it
ALONG = 0.9  # cosine of an axis of a frame to the way to it, along which that axis leads


@dataclass(frozen=True)
class Tip:
    """The end of a tool.

    Attributes:
        link: The link that ends there.
        at: (3,) where it is, m, in the frame of the hand.
        way: (3,) the unit vector along which it points, in that frame.
    """

    link: str
    at: Array
    way: Array


def tip_of(structure: Structure, hand: str) -> Tip | None:
    """The end of what is fixed to the last link of an arm; None if it is not known which one.

    It is the last link of one branch, by name if there are several. If it has shapes, it points
    from its frame along them; else along that of its axes which leads away from the next shape.
    """
    links = structure.rigid(hand)[1:]
    ends = [link for link in links if not structure.below[link] and not SEES.search(link)]
    ends = [link for link in ends if NAMED.search(link)] or ends
    if len(ends) != 1:
        return None
    pose = np.asarray(structure.urdf.model.get_transform(ends[0], hand), dtype=np.float64)
    own, at = structure.seen(ends, hand), pose[:3, 3]
    part = own if len(own) else _nearest(structure, hand, at)
    way = (_middle(part) - at) * (1.0 if len(own) else -1.0)
    length = float(np.linalg.norm(way))
    axes = np.concatenate([pose[:3, :3].T, -pose[:3, :3].T])
    axis = axes[int((axes @ way).argmax())]
    beyond = float(((part - at) @ axis).max(initial=0.0))
    within = not len(own) and beyond > WITHIN
    if length < LEAST or axis @ way < ALONG * length or within:
        return None
    return Tip(ends[0], at + beyond * axis, axis)


def _middle(points: Array) -> Array:
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _nearest(structure: Structure, hand: str, place: Array) -> Array:
    """Points of the shape of a hand whose middle is nearest to a place, or this without any."""
    shapes = [
        points
        for link in structure.rigid(hand)
        for points in structure.shapes(
            link, np.asarray(structure.urdf.model.get_transform(link, hand), dtype=np.float64)
        )
    ]
    away = [float(np.linalg.norm(_middle(points) - place)) for points in shapes]
    return shapes[int(np.argmin(away))] if shapes else place[None]
