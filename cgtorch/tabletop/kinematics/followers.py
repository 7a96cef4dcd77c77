"""Joints of a URDF that follow others (`mimic`): each has a leader that moves by itself."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from trimesh import transformations

from cgtorch.tabletop.kinematics.origins import fix, pose_of
from cgtorch.tabletop.kinematics.valid import MOVING


def led(root: Any) -> list[str]:
    """Have joints follow one that moves by itself, or nothing, in a checked tree, in place.

    A joint that follows a follower follows the leader of that. One whose leader is not there or
    does not move is fixed where it is if the leader is at 0. Returns the names of the latter.
    """
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    moving = {name: joint for name, joint in joints.items() if joint.get("type") in MOVING}
    mimics = {n: m for n, joint in moving.items() if (m := joint.find("mimic")) is not None}
    held = []
    for name, joint in joints.items():
        if (mimic := joint.find("mimic")) is None:
            continue
        leader, factor, offset = _led_by(mimic, mimics)
        still = leader not in moving or leader in mimics
        if still and name in mimics:
            fix(joint, _moved(joint, offset))
            held.append(str(name))
        elif still:
            joint.remove(mimic)
        elif leader != mimic.get("joint"):
            mimic.attrib.update(
                {"joint": leader, "multiplier": repr(factor), "offset": repr(offset)}
            )
    return held


def _led_by(mimic: Any, mimics: Mapping[str, Any]) -> tuple[str | None, float, float]:
    """The joint that leads another in the end, and by which factor and offset.

    It is one of `mimics` only if they follow each other in a loop.
    """
    leader, factor, offset = mimic.get("joint"), 1.0, 0.0
    for _ in range(len(mimics)):
        leader = mimic.get("joint")
        offset += factor * float(mimic.get("offset", "0"))
        factor *= float(mimic.get("multiplier", "1"))
        if leader not in mimics:
            break
        mimic = mimics[leader]
    return leader, factor, offset


def _moved(joint: Any, position: float) -> Any:
    """(4, 4) where a joint at a position holds its child, in the frame of its parent."""
    axis = np.array([float(part) for part in joint.find("axis").get("xyz").split()])
    if joint.get("type") == "prismatic":
        return pose_of(joint) @ transformations.translation_matrix(position * axis)
    return pose_of(joint) @ transformations.rotation_matrix(position, axis)
