"""The pairs of solids that an arm must keep apart on its way."""

import itertools
import math
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import MARGIN, Places, ways_clear
from cgtorch.tabletop.kinematics.scene import (
    ALWAYS,
    APPROACH,
    CARRY,
    HELD,
    LIFT,
    OBJECT,
    OBJECT_HALF,
    OBJECT_RADIUS,
    OWN,
    REACH,
    TABLE,
    Scene,
)
from cgtorch.tabletop.kinematics.solids import Solids
from cgtorch.tabletop.kinematics.touching import SHOULDER_JOINTS

SPREAD = 200
"""The number of random postures that show which solids overlap by design."""
BUILT_IN = 0.25
"""Solids that touch in more than this share of them overlap by design."""
BITS = 62
_FAR = torch.eye(3, 4, dtype=torch.float64)


def scene_of(arm: ArmModel, body: Solids, others: Solids) -> Scene:
    """The scene of an arm, given the robot's body and the other arms at home, in the base frame."""
    n, tool = len(arm.joint_names), len(arm.chain(arm.lower)[1].kind) - 1
    size = arm.lower.new_tensor([[0, 0, OBJECT_HALF, OBJECT_RADIUS, 0]]).expand(OWN, 5)
    own = Solids(
        pose=torch.eye(4, dtype=size.dtype)[:3].expand(OWN, 3, 4),
        size=size,
        frame=torch.tensor([-1, -1, tool]),
        joints=torch.tensor([0, 0, n]),
    )
    every = own.joined(arm.solids, body, others)
    pairs = _pairs(arm.solids.joints.tolist(), len(body), others.joints.tolist(), n)
    carried = torch.where(every.frame >= 0, every.joints, 0)  # the joints that move each solid
    apart = [(first, int(carried[second])) for first, second, _ in pairs.tolist()]
    reaches = {each: _reach(arm, every, *each) for each in dict.fromkeys(apart)}
    reach = torch.stack([reaches[each] for each in apart])
    scene = Scene(every.pose, every.size, every.radius, every.frame, pairs, reach)
    kept = ~_built_in(arm, scene) & _near_enough(arm, scene)
    return replace(scene, pairs=pairs[kept], reach=reach[kept])


def _pairs(own: list[int], body: int, others: list[int], n: int) -> Tensor:
    """(P, 3) pairs of solids that may meet, given how many joints move those of the arms.

    The gripper, which all joints move, may touch the object from the approach on. The object is on
    the table until it is lifted. Neighbouring links touch by design, and joint limits keep
    shoulders off the body.
    """
    arm = {OWN + i: joints for i, joints in enumerate(own)}
    torso = range(OWN + len(arm), OWN + len(arm) + body)
    beside = {OWN + len(arm) + body + i: joints for i, joints in enumerate(others)}
    pairs = [(HELD, TABLE, CARRY), *((HELD, k, LIFT | CARRY) for k in (*torso, *beside))]
    for i, joints in arm.items():
        loose = joints > SHOULDER_JOINTS
        pairs.append((i, TABLE, ALWAYS))
        pairs.append((i, OBJECT, REACH if joints == n else REACH | APPROACH))
        if joints < n:
            pairs.append((HELD, i, LIFT | CARRY))
        pairs.extend((i, k, ALWAYS) for k in torso if loose)
        pairs.extend((i, k, ALWAYS) for k, far in beside.items() if loose or far > SHOULDER_JOINTS)
    for i, k in itertools.permutations(arm, 2):
        if arm[i] > arm[k] + 1:
            pairs.append((i, k, ALWAYS))
    return torch.tensor(pairs)


def _built_in(arm: ArmModel, scene: Scene) -> Tensor:
    """(P,) whether solids of the robot touch in most postures."""
    found = torch.zeros(len(scene.pairs), dtype=torch.bool)
    nothing = Places(*(each[None] for each in (_FAR, scene.size[TABLE], _FAR, _FAR)))
    q = random_postures(arm, SPREAD)[:, None]
    robot = (scene.pairs[:, :2] >= OWN).all(1).nonzero()[:, 0]
    for some in robot.split(BITS):
        bit = 1 << torch.arange(len(some))
        alone = replace(
            scene,
            pairs=torch.cat([scene.pairs[some, :2], bit[:, None]], 1),
            reach=scene.reach[some],
        )
        kind, rows = bit.repeat_interleave(SPREAD), torch.zeros(SPREAD * len(some)).long()
        clear = ways_clear(arm, alone, nothing[rows], kind, q.repeat(len(some), 1, 1))
        found[some] = clear.view(len(some), SPREAD).double().mean(1) < 1 - BUILT_IN
    return found


def _near_enough(arm: ArmModel, scene: Scene) -> Tensor:
    """(P,) whether an arm is long enough for pairs to meet, by distance from its first joint."""
    chain, b = arm.chain(arm.lower)[1], scene.pairs[:, 1]
    first = int((chain.kind > 0).nonzero()[0, 0])
    still = (b >= OWN) & (scene.frame[b] < 0) & (chain.kind[first] == 1)
    joint = arm.frames(arm.lower[None])[first, 0, :3, 3]
    away = (scene.pose[b, :, 3] - joint).norm(dim=1) - scene.radius[b]
    return ~still | (away <= scene.reach[:, 0] + MARGIN)


def clear_alone(arm: ArmModel, scene: Scene, q: Tensor) -> Tensor:
    """(B,) whether postures (B, n) are clear of the robot, with neither table nor object."""
    pairs = scene.pairs[:, :2] >= OWN
    robot = replace(scene, pairs=scene.pairs[pairs.all(1)], reach=scene.reach[pairs.all(1)])
    kind, rows = torch.full((len(q),), REACH), torch.zeros(len(q), dtype=torch.long)
    nothing = Places(*(each[None] for each in (_FAR, scene.size[TABLE], _FAR, _FAR)))
    return ways_clear(arm, robot, nothing[rows], kind, q[:, None])


def random_postures(arm: ArmModel, count: int) -> Tensor:
    """(count, n) random postures within limits, rad or m, always the same."""
    generator = torch.Generator().manual_seed(0)
    low = torch.where(arm.continuous, -math.pi, arm.lower)
    high = torch.where(arm.continuous, math.pi, arm.upper)
    share = torch.rand(count, len(low), generator=generator, dtype=low.dtype)
    return low + share * (high - low)


def _reach(arm: ArmModel, solids: Solids, which: int, base: int) -> Tensor:
    """(n,) the largest distance of a solid's points from the axis of each joint that moves it.

    The first `base` joints do not count, as they move another solid, too. At every revolute joint,
    the links beyond it are assumed to be in one line, with prismatic joints extended. It is 1 for a
    prismatic joint.
    """
    chain = arm.chain(arm.lower)[1]
    reach = arm.lower.new_zeros(len(arm.joint_names))
    # Points that no joint so far moves against each other, and how far others are from them.
    points, far = _corners(solids, which), float(solids.size[which, 4])
    if which == HELD:  # which is turned about the tool frame's origin as its grasp has it
        points, far = points.new_zeros(1, 3), float(solids.radius[which])
    for frame in range(int(solids.frame[which]), -1, -1):
        joint, kind, offset = int(chain.joint[frame]), int(chain.kind[frame]), chain.offset[frame]
        if kind and joint >= base:
            axis = chain.axis[frame].expand_as(points)
            off = torch.linalg.cross(axis, points).norm(dim=1).max()
            reach[joint] = float(off) + far if kind == 1 else 1.0
        if kind:
            far += float(points.norm(dim=1).max())
            points = points.new_zeros(1, 3)
        if kind == 2:
            far += max(abs(float(arm.lower[joint])), abs(float(arm.upper[joint])))
        points = points @ offset[:, :3].T + offset[:, 3]
    return reach


def _corners(solids: Solids, which: int) -> Tensor:
    """(8, 3) corners of the box about a solid without its ball, in the solid's frame."""
    disc = solids.size[which, 3] * solids.size.new_tensor([1.0, 1.0, 0.0])
    signs = torch.tensor(list(itertools.product((1.0, -1.0), repeat=3))).to(disc)
    pose = solids.pose[which]
    return signs * (solids.size[which, :3] + disc) @ pose[:, :3].T + pose[:, 3]
