"""The robot: its URDF and description, checked together and prepared for batched kinematics."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lxml import etree
from torch import Tensor
from trimesh import transformations

from cgtorch.ground.errors import RobotError
from cgtorch.ground.given import given_path, shown
from cgtorch.tabletop.kinematics.arm import ArmModel, built_chain
from cgtorch.tabletop.kinematics.clear_ways import OWN, Scene
from cgtorch.tabletop.kinematics.description import (
    Arm,
    RobotDescription,
    load_description,
    robot_files,
)
from cgtorch.tabletop.kinematics.fitted import MeshFit, without_meshes
from cgtorch.tabletop.kinematics.inverse_kinematics import spherical_arm
from cgtorch.tabletop.kinematics.meshes import package_places
from cgtorch.tabletop.kinematics.scene import home_postures, placed_at, scene_of
from cgtorch.tabletop.kinematics.solids import (
    Solids,
    solid_of,
    solid_of_capsule,
    solids_of,
)
from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf, load_urdf, mimic_of

_TURNS = 3 * math.pi
OTHER_ENDS = "by a base link after this joint or a tool frame before it"
MENDED = "in a robot folder by cgtorch-robot, where the first of such joints leads the others"


@dataclass(frozen=True)
class Robot:
    """A mobile robot with a fixed torso: arms on a base that drives.

    Attributes:
        arms: In the description's order.
        body: The solids that an arm must not touch, in the base frame.
        home: (n,) of each arm, the positions of its joints while the robot drives, rad or m.
        body_links: The link of each of these solids.
        meshes: Shapes fitted to the meshes of its URDF; empty without meshes.
    """

    description: RobotDescription
    urdf: Urdf
    arms: tuple[ArmModel, ...]
    body: Solids
    home: tuple[Tensor, ...]
    body_links: tuple[str, ...]
    meshes: tuple[MeshFit, ...] = ()

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """For each arm, what it must keep clear of, with the others at home.

        Many commands read a robot, and few of them plan motions, so it is computed when asked for.
        """
        at_home = [placed_at(arm, q) for arm, q in zip(self.arms, self.home, strict=True)]
        n = len(self.arms)
        others = [self.body[:0].joined(*at_home[:i], *at_home[i + 1 :]) for i in range(n)]
        pairs = zip(self.arms, others, strict=True)
        return tuple(self._scene(arm, each) for arm, each in pairs)

    def _scene(self, arm: ArmModel, others: Solids) -> Scene:
        """The scene of an arm, without the pairs of links that never collide."""
        scene, apart = (
            scene_of(arm, self.body, others),
            {*map(frozenset, self.description.excludes)},
        )
        named = itertools.chain(itertools.repeat("", OWN), arm.solid_links, self.body_links)
        link = dict(enumerate(named))
        kept = torch.tensor(
            [{link.get(a), link.get(b)} not in apart for a, b, _ in scene.pairs.tolist()]
        )
        return replace(scene, pairs=scene.pairs[kept], reach=scene.reach[kept])


def load_robot(
    urdf: Path | str | None = None,
    description: Path | str | None = None,
    packages: Sequence[Path | str] = (),
) -> Robot:
    """Load a robot, with files as in `robot_files`, and check that they are consistent.

    Shapes replace meshes, which are searched in the folders `packages` and those of the environment
    (`package_places`).

    RobotError if a file is missing or broken, or the description names a link or joint that the
    URDF lacks or that is not suitable.
    """
    urdf, description = robot_files(urdf, description)
    if isinstance(packages, str) or not isinstance(packages, Sequence):
        raise RobotError(f"packages is {shown(packages)}; give a list of folders")
    packages = [given_path(place, "a folder of packages", RobotError) for place in packages]
    model, words = load_urdf(urdf), load_description(description)
    model, meshes = without_meshes(model, package_places(packages), words.capsules)
    joints = {arm.name: model.joints_between(arm.base_link, arm.tool_frame) for arm in words.arms}
    in_arms = {joint.name for path in joints.values() for joint in path if joint.type in MOVING}
    for name, position in words.held.items():
        _check_held(model.joint(name), position, in_arms)
    model.model.update_cfg(words.held)
    for name in words.capsules:
        model.link(name)
    arms = tuple(_arm(model, words, arm, joints[arm.name]) for arm in words.arms)
    body, body_links = _body(model, words, in_arms)
    for name, position in words.home.items():
        _check_home(model.joint(name), position, in_arms)
    home = home_postures(arms, body, words.footprint, words.home)
    return Robot(words, model, arms, body, home, body_links, meshes)


def _check_held(joint: Any, position: float, in_arms: set[str]) -> None:
    """Refuse to fix a joint that does not move or is an arm's, or to fix it beyond its limits."""
    if joint.name in in_arms:
        raise RobotError(
            f"joint {joint.name!r} is named in the robot description but moves an arm: name a "
            "joint outside the arms"
        )
    refused = f"joint {joint.name!r} cannot be held at {position}: "
    if joint.type not in MOVING or joint.mimic is not None:
        raise RobotError(f"{refused}it is fixed or follows another joint; name a joint that moves")
    if joint.type != "continuous" and not joint.limit.lower <= position <= joint.limit.upper:
        raise RobotError(
            f"{refused}give a position within its limits {joint.limit.lower} to {joint.limit.upper}"
        )


def _check_home(joint: Any, position: float, in_arms: set[str]) -> None:
    """Refuse a home position of a joint that is no arm's, or that is beyond its limits."""
    if joint.name not in in_arms:
        raise RobotError(
            f"joint {joint.name!r} is named in the home of the robot description but moves no arm: "
            "name a joint of an arm, or hold it by gripper_joints"
        )
    lower, upper = _limits(joint)
    if not lower <= position <= upper:
        raise RobotError(
            f"joint {joint.name!r} cannot be at {position} at home: give a position within its "
            f"limits {lower} to {upper}"
        )


def _check_base(urdf: Urdf, words: RobotDescription, arm: Arm, own: set[str]) -> None:
    """Refuse an arm whose base link moves with it, as a joint below that follows one of its own."""
    for joint in urdf.joints_between(words.base_frame, arm.base_link):
        if joint.mimic is not None and joint.mimic.joint in own:
            raise RobotError(
                f"arm {arm.name!r} begins at {arm.base_link!r}, which {joint.name!r} moves, as it "
                f"follows {joint.mimic.joint!r} of the arm: begin the arm at {joint.parent!r}, "
                f"{MENDED}"
            )


def _arm(urdf: Urdf, words: RobotDescription, arm: Arm, joints: tuple[Any, ...]) -> ArmModel:
    _fixed_to_base(urdf, words, arm.base_link, {j.name for j in joints}, f"arm {arm.name!r}")
    moving = [joint for joint in joints if joint.type != "fixed"]
    if not moving:
        raise RobotError(
            f"arm {arm.name!r} has no joint between {arm.base_link!r} and {arm.tool_frame!r}: name "
            "the links at both ends of the arm"
        )
    own = [joint for joint in moving if joint.mimic is None]
    _check_base(urdf, words, arm, {joint.name for joint in own})
    for i, joint in enumerate(moving):
        before = [None, *(each.name for each in moving[:i] if each.mimic is None)]
        leader = None if joint.mimic is None else joint.mimic.joint
        if joint.type not in MOVING or leader not in before:
            kind = "mimic" if leader is not None else joint.type
            follows = "" if leader is None else f", which follows {leader!r}"
            later = leader in {each.name for each in own}
            raise RobotError(
                f"arm {arm.name!r} has the {kind} joint {joint.name!r}{follows}: use an arm of "
                "revolute, continuous and prismatic joints that follow none but one before them in "
                f"the arm, {MENDED if later else OTHER_ENDS}"
            )
    limits = torch.tensor([_limits(joint) for joint in own], dtype=torch.float64)
    xml, links = _chain_xml(urdf, joints), (arm.base_link, arm.tool_frame)
    mount = _transform(urdf, arm.base_link, words.base_frame)
    chain, table = built_chain(xml, links, mount)
    solids, solid_links = _solids(urdf, words, arm, moving, chain.frame_to_idx)
    return ArmModel(
        name=arm.name,
        joint_names=tuple(joint.name for joint in own),
        lower=limits[:, 0],
        upper=limits[:, 1],
        continuous=torch.tensor([joint.type == "continuous" for joint in own]),
        mount=mount,
        reach=_reach(joints),
        solids=solids,
        solid_links=solid_links,
        closed_form=spherical_arm(joints, limits) if len(own) == len(moving) else None,
        _xml=xml,
        _links=links,
        _chains={(mount.dtype, mount.device): (chain, table)},
    )


def _reach(joints: tuple[Any, ...]) -> float:
    """The length of a chain with all its links in one line and its prismatic joints extended."""
    slides = [_limits(joint) for joint in joints if joint.type == "prismatic"]
    drawn = sum(max(-lower, upper, 0.0) for lower, upper in slides)
    offsets = [joint.origin[:3, 3] for joint in joints if joint.origin is not None]
    return drawn + sum(math.hypot(*offset) for offset in offsets)


def _limits(joint: Any) -> tuple[float, float]:
    """The limits: the hard ones, narrowed by the soft ones if there are any."""
    if joint.type == "continuous":
        return -_TURNS, _TURNS
    lower, upper, soft = float(joint.limit.lower), float(joint.limit.upper), joint.safety_controller
    if soft is not None and soft.soft_lower_limit is not None and soft.soft_upper_limit is not None:
        narrow = max(lower, soft.soft_lower_limit), min(upper, soft.soft_upper_limit)
        if narrow[0] < narrow[1]:
            return narrow
    return lower, upper


def _chain_xml(urdf: Urdf, joints: tuple[Any, ...]) -> bytes:
    """A URDF of the arm alone, with the finite limits that pytorch-kinematics needs."""
    elements = {e.get("name"): e for e in etree.fromstring(urdf.xml).findall("joint")}
    robot = etree.Element("robot", name="arm")
    for link in [joints[0].parent, *(joint.child for joint in joints)]:
        etree.SubElement(robot, "link", name=link)
    for joint in joints:
        source = elements[joint.name]
        kind = "revolute" if joint.type == "continuous" else joint.type
        target = etree.SubElement(robot, "joint", name=joint.name, type=kind)
        for tag in ("origin", "parent", "child", "axis"):
            if source.find(tag) is not None:
                target.append(source.find(tag))
        if joint.mimic is not None:
            _add_mimic(target, joint)
        if joint.type != "fixed":
            lower, upper = _limits(joint)
            bounds = {"lower": repr(lower), "upper": repr(upper), "effort": "1", "velocity": "1"}
            etree.SubElement(target, "limit", bounds)
    xml: bytes = etree.tostring(robot)
    return xml


def _add_mimic(element: Any, joint: Any) -> None:
    """Let a joint of an arm follow another, with its offset in its origin."""
    offset, factor = mimic_of(joint)
    pose = np.eye(4) if joint.origin is None else joint.origin
    if joint.type == "prismatic":
        pose = pose @ transformations.translation_matrix(offset * joint.axis)
    else:
        pose = pose @ transformations.rotation_matrix(offset, joint.axis)
    origin = element.find("origin")
    origin = etree.SubElement(element, "origin") if origin is None else origin
    turns = transformations.euler_from_matrix(pose, "sxyz")
    for name, numbers in (("xyz", pose[:3, 3]), ("rpy", turns)):
        origin.set(name, " ".join(repr(float(x)) for x in numbers))
    etree.SubElement(element, "mimic", joint=joint.mimic.joint, multiplier=repr(float(factor)))


def _transform(urdf: Urdf, link: str, frame: str) -> Tensor:
    """(4, 4): the pose of a link in the frame of another, with fixed joints in place."""
    return torch.tensor(urdf.model.get_transform(link, frame), dtype=torch.float64)


def _fixed_to_base(
    urdf: Urdf, words: RobotDescription, link: str, arm_joints: set[str], what: str
) -> None:
    """Refuse a link that the base frame does not carry, or that a joint can move."""
    for joint in urdf.joints_between(words.base_frame, link):
        moves = joint.type != "fixed" and joint.name not in words.held and joint.mimic is None
        if moves or joint.name in arm_joints:
            raise RobotError(
                f"{what}: joint {joint.name!r} can move {link!r}: hold it as the torso_joint, or "
                "name another link"
            )


def _solids(
    urdf: Urdf, words: RobotDescription, arm: Arm, moving: list[Any], frame_index: dict[str, int]
) -> tuple[Solids, tuple[str, ...]]:
    """The shapes of links that the arm's joints move, including fixed fingers, and their links."""
    rows, names = [], []
    own = {joint.child for joint in moving if joint.mimic is None}
    for link, pose, carriers in _moved_links(urdf, arm, moving):
        if link.name in words.capsules:
            given = torch.tensor(words.capsules[link.name], dtype=torch.float64).view(-1, 7)
            shapes = [solid_of_capsule(row[:3], row[3:6], float(row[6])) for row in given]
        else:
            shapes = [solid_of(each, f"link {link.name!r}") for each in link.collisions]
        for at, size in shapes:
            rows.append(
                (pose @ at, size, frame_index[carriers[0]], len(own.intersection(carriers)))
            )
            names.append(str(link.name))
    return solids_of(rows), tuple(names)


def _moved_links(
    urdf: Urdf, arm: Arm, moving: list[Any]
) -> Iterator[tuple[Any, Tensor, list[str]]]:
    """Links that an arm's joints move, and the names of the arm's frames above each, nearest first.

    Also yielded is their pose (4, 4) in the nearest of these frames.
    """
    names = {joint.name for joint in moving}
    for link in urdf.model.robot.links:
        path = urdf.joints_above(link.name, arm.base_link)
        carriers = [joint.child for joint in path if joint.name in names]
        if carriers and path[-1].parent == arm.base_link:
            yield link, _transform(urdf, link.name, carriers[0]), carriers


def _body(
    urdf: Urdf, words: RobotDescription, arm_joints: set[str]
) -> tuple[Solids, tuple[str, ...]]:
    """The shapes of links that an arm must not touch, in the base frame, and the link of each."""
    rows, names = [], []
    for name in words.body:
        _fixed_to_base(urdf, words, name, arm_joints, "body")
        link = _transform(urdf, name, words.base_frame)
        for collision in urdf.link(name).collisions:
            pose, size = solid_of(collision, f"link {name!r}")
            rows.append((link @ pose, size, -1, 0))
            names.append(name)
    return solids_of(rows), tuple(names)
