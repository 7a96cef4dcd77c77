"""Chains that are alike on both sides of a robot, and heads between them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cgtorch.tabletop.robot_folder.structure import Array

SAME = 0.02  # of the length of a chain, by which lengths and heights of a pair may differ
BETWEEN = 0.2  # of the distance of a pair, how far a head is from its middle at most
SHORTER = 0.75  # of the reach of a pair, that of a head at most


@dataclass(frozen=True)
class Limb:
    """A chain of joints, as it is compared with others.

    Attributes:
        begin: (3,) where its first joint is, in the base frame, m.
        joints: How many it has of its own.
        length: How long it is from the first to the last joint, m.
        reach: How far it could reach, with what it carries, m.
    """

    begin: Array
    joints: int
    length: float
    reach: float


def pairs(limbs: Sequence[Limb]) -> list[tuple[int, int]]:
    """The indices of limbs that are as long as each other, and begin beside each other."""
    return [
        (i, j)
        for i, j in itertools.combinations(range(len(limbs)), 2)
        if _alike(limbs[i], limbs[j])
    ]


def heads(limbs: Sequence[Limb]) -> set[int]:
    """The indices of limbs that are a head: alone, between and above a pair, and much shorter."""
    found = pairs(limbs)
    alone = set(range(len(limbs))).difference(*found)
    return {k for k in alone for i, j in found if _between(limbs[k], limbs[i], limbs[j])}


def _alike(one: Limb, other: Limb) -> bool:
    most = SAME * max(one.length, other.length)
    aside = one.begin - other.begin
    return bool(
        one.joints == other.joints
        and abs(one.length - other.length) <= most
        and abs(aside[2]) <= most < np.linalg.norm(aside[:2])
    )


def _between(limb: Limb, one: Limb, other: Limb) -> bool:
    middle, across = (one.begin + other.begin) / 2, (one.begin - other.begin)[:2]
    away = float(np.linalg.norm(across))
    off = abs(float((limb.begin - middle)[:2] @ across)) / away
    short = limb.reach <= SHORTER * min(one.reach, other.reach)
    return bool(short and off <= BETWEEN * away and limb.begin[2] > middle[2])
