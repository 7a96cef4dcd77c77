"""In which direction the fingers of a hand close, and which of them are on which side."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cgtorch.tabletop.kinematics.urdf import MOVING
from cgtorch.tabletop.robot_folder.round_hands import around
from cgtorch.tabletop.robot_folder.structure import Array, Structure

LEAST_FINGERS = 3
ONE_WAY = 0.7  # of the squares of the ways in which fingers close, that along one direction
APART = 0.01  # m by which fingers are on two sides at least
EDGE = 0.25  # of this distance, that within which others are on the same side


def closing(structure: Structure, hand: str, x: Array, centres: Sequence[Array]) -> Array | None:
    """The unit vector (3,) along which fingers with some centres close, across the approach x.

    It leads to the thumb, if there is one, from the others. Of three fingers or more it is the
    direction in which most are bent by their last joints, wherever they are bent to. None where
    they stand around an axis, or close in several directions.
    """
    if len(centres) < LEAST_FINGERS:
        return _across(x, centres[0] - centres[1]) if len(centres) > 1 else None
    if around(structure, hand):
        return None
    ways = np.stack([_bent(structure, hand, x, j.child) for j in structure.moved(hand)])
    strengths, directions = np.linalg.eigh(ways.T @ ways)
    if strengths[-1] < ONE_WAY * strengths.sum() or not strengths[-1]:
        return None
    y = np.asarray(directions[:, -1])
    both = sides(y, centres)
    return y if both is None or both[0].sum() <= both[1].sum() else -y


def sides(y: Array, centres: Sequence[Array]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Which fingers are farthest along y, and which least; None if they are on one side."""
    along = np.stack(centres) @ y
    room = EDGE * float(np.ptp(along))
    if np.ptp(along) < APART:
        return None
    return along >= along.max() - room, along <= along.min() + room


def _across(x: Array, way: Array) -> Array | None:
    """The unit vector along a way across x; None if it is short."""
    across = way - (way @ x) * x
    length = float(np.linalg.norm(across))
    return across / length if length > APART else None


def _bent(structure: Structure, hand: str, x: Array, finger: str) -> Array:
    """(3,) the way along which the last joint of a finger moves it across x, of length 1 or less.

    Without shapes to move it is 0.
    """
    links = structure.hanging(finger)
    if not len(structure.seen(links)):
        return np.zeros(3)
    last = [link for link in links if structure.above[link].type in MOVING][-1]
    turn = np.asarray(structure.urdf.model.get_transform(last, hand))[:3, :3]
    axis = turn @ np.asarray(structure.above[last].axis, dtype=np.float64)
    slides = structure.above[last].type == "prismatic"
    return axis - (axis @ x) * x if slides else np.cross(x, axis)
