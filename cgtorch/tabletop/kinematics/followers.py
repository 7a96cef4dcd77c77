"""Joints of a URDF that follow others (`mimic`): each has a leader that moves by itself."""

from collections.abc import Mapping
from typing import Any

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
    for name, mimic in mimics.items():
        leader, factor, offset = _led_by(name, mimics)
        if leader not in moving or leader in mimics:
            fix(joints[name], _moved(joints[name], offset))
            held.append(str(name))
        elif leader != mimic.get("joint"):
            mimic.attrib.update(
                {"joint": leader, "multiplier": repr(factor), "offset": repr(offset)}
            )
    for name in joints.keys() - mimics.keys():
        for idle in joints[name].findall("mimic"):
            joints[name].remove(idle)
    return held


def _led_by(name: str | None, mimics: Mapping[str, Any]) -> tuple[str | None, float, float]:
    """The joint that leads another in the end, and by which factor and offset.

    It is one of `mimics` only if they follow each other in a loop.
    """
    factor, offset = 1.0, 0.0
    for _ in mimics:
        if name is None or name not in mimics:
            break
        mimic = mimics[name]
        offset += factor * float(mimic.get("offset", "0"))
        factor *= float(mimic.get("multiplier", "1"))
        name = mimic.get("joint")
    return name, factor, offset


def _moved(joint: Any, position: float) -> Any:
    """(4, 4) where a joint at a position holds its child, in the frame of its parent."""
    axis = joint.find("axis")
    way = [float(x) for x in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()]
    if joint.get("type") == "prismatic":
        motion = transformations.translation_matrix(position * transformations.unit_vector(way))
    else:
        motion = transformations.rotation_matrix(position, way)
    return pose_of(joint) @ motion
