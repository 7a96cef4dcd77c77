"""Joints that hardly move, though others hang from them, as the lock of a tool changer."""

from typing import Any

import numpy as np
from lxml import etree
from trimesh import transformations

from cgtorch.tabletop.kinematics.origins import fix
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, checked_urdf
from cgtorch.tabletop.robot_folder.structure import Array, Structure

STILL = 5e-3  # rad or m: a joint of a smaller range hardly moves


def without_still(urdf: Urdf) -> tuple[Urdf, tuple[str, ...]]:
    """A URDF whose joints of hardly any range are fixed, and a note of which these are.

    A joint that moves hangs from each of them. Other joints without a range, as those of fingers
    that are not used, remain.
    """
    structure = Structure(urdf, urdf.model.base_link)
    joints = urdf.model.robot.joints
    followed = {joint.mimic.joint for joint in joints if joint.mimic is not None}
    still = {
        joint.name: _origin(joint)
        for joint in joints
        if _is_still(joint) and joint.name not in followed and _carries_motion(structure, joint)
    }
    if not still:
        return urdf, ()
    root = etree.fromstring(urdf.xml)
    for element in root.findall("joint"):
        if (pose := still.get(element.get("name"))) is not None:
            fix(element, pose)
    are = "is" if len(still) == 1 else "are"
    names = ", ".join(still)
    note = f"{names} {are} taken to be fixed, as the two limits are nearly the same"
    return checked_urdf(urdf.path, root), (note,)


def _is_still(joint: Any) -> bool:
    slides_or_turns = joint.type in ("revolute", "prismatic") and joint.mimic is None
    return bool(slides_or_turns and joint.limit.upper - joint.limit.lower < STILL)


def _carries_motion(structure: Structure, joint: Any) -> bool:
    """Whether a joint hangs from another that moves by itself."""
    below = (each for link in structure.hanging(joint.child) for each in structure.below[link])
    return any(j.type in MOVING and j.mimic is None and not _is_still(j) for j in below)


def _origin(joint: Any) -> Array:
    """(4, 4) where a joint nearest to 0 holds its child, in the parent's frame."""
    origin = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64)
    low, high = float(joint.limit.lower), float(joint.limit.upper)
    axis, at = np.asarray(joint.axis, dtype=np.float64), min(max(low, 0.0), high)
    if joint.type == "prismatic":
        return np.asarray(origin @ transformations.translation_matrix(at * axis))
    return np.asarray(origin @ transformations.rotation_matrix(at, axis))
