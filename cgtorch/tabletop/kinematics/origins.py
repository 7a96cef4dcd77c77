"""Poses in the elements of a URDF, and joints that are fixed at one."""

from collections.abc import Collection
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from trimesh import transformations

_OF_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def pose_of(element: Any) -> NDArray[np.float64]:
    """(4, 4) of the <origin> of an element, or the identity."""
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = (
        [float(part) for part in given.get(name, "0 0 0").replace(",", " ").split()]
        for name in ("xyz", "rpy")
    )
    pose: NDArray[np.float64] = transformations.euler_matrix(*rpy, "sxyz")
    pose[:3, 3] = xyz
    return pose


def add_origin(element: Any, pose: NDArray[np.float64]) -> None:
    """Give an element the <origin> of a pose (4, 4)."""
    xyz, rpy = words(pose[:3, 3].tolist()), words(transformations.euler_from_matrix(pose, "sxyz"))
    etree.SubElement(element, "origin", xyz=xyz, rpy=rpy)


def words(numbers: Collection[float]) -> str:
    """Numbers as an attribute, in m or rad to a billionth."""
    return " ".join(repr(round(float(number), 9)) for number in numbers)


def fix(joint: Any, pose: NDArray[np.float64]) -> None:
    """Make a joint one that does not move, and holds its child at a pose (4, 4)."""
    joint.set("type", "fixed")
    for old in joint.xpath("|".join(("origin", *_OF_MOTION))):
        joint.remove(old)
    add_origin(joint, pose)
