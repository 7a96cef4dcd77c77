"""Joints of a URDF that follow others (`mimic`): each has a leader that moves by itself."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from lxml import etree
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


def first_leads(root: Any) -> dict[str, str]:
    """Have what follows a joint farther out lead it instead, in a tree that is `led`, in place.

    The slides of a telescope may all follow the outermost one, but a joint of an arm can only
    follow one before it. Its range is then that of its leader, as it follows it. Returns each joint
    that leads now, and which one it followed.
    """
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    above = {joint.find("child").get("link"): joint for joint in joints.values()}
    found = dict[str, str]()
    for name, leader in joints.items():
        before = list[Any]()
        each = above.get(leader.find("parent").get("link"))
        while each is not None:
            before.append(each)
            each = above.get(each.find("parent").get("link"))
        following = [each for each in before if _follows(each, name)]
        if following and _turned_round(following[-1], leader):
            first = following[-1].get("name")
            found[first] = name
            for other in joints.values():
                if other is not leader and _follows(other, name):
                    _follow_instead(other, first, leader.find("mimic"))
    return found


def _follows(joint: Any, name: str) -> bool:
    mimic = joint.find("mimic")
    return mimic is not None and mimic.get("joint") == name


def _turned_round(first: Any, leader: Any) -> bool:
    """Have a joint that follows another lead it; whether that is possible."""
    (offset, factor), limit = _line(first.find("mimic")), leader.find("limit")
    if leader.get("type") == "continuous" or not factor:
        return False
    ends = sorted(offset + factor * float(limit.get(name)) for name in ("lower", "upper"))
    mimic = first.find("mimic")
    first.remove(mimic)
    if first.get("type") == "continuous":
        first.set("type", "revolute")
    own = first.find("limit")
    own = etree.SubElement(first, "limit", effort="0", velocity="0") if own is None else own
    own.attrib.update(zip(("lower", "upper"), map(repr, ends), strict=True))
    mimic.attrib.update(
        {
            "joint": first.get("name"),
            "multiplier": repr(1 / factor),
            "offset": repr(-offset / factor),
        }
    )
    leader.append(mimic)
    return True


def _follow_instead(joint: Any, first: str, mimic: Any) -> None:
    """Have a joint that follows one with a mimic follow the joint that this names."""
    (offset, factor), (before, gain) = _line(joint.find("mimic")), _line(mimic)
    numbers = {"multiplier": repr(factor * gain), "offset": repr(offset + factor * before)}
    joint.find("mimic").attrib.update({"joint": first, **numbers})


def _line(mimic: Any) -> tuple[float, float]:
    """The offset and the factor by which a joint follows another."""
    return float(mimic.get("offset", "0")), float(mimic.get("multiplier", "1"))


def _led_by(mimic: Any, mimics: Mapping[str, Any]) -> tuple[str | None, float, float]:
    """The joint that leads another in the end, and by which factor and offset.

    It is one of `mimics` only if they follow each other in a loop.
    """
    leader, factor, offset = mimic.get("joint"), 1.0, 0.0
    for _ in range(len(mimics)):
        leader = mimic.get("joint")
        further, gain = _line(mimic)
        offset, factor = offset + factor * further, factor * gain
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
