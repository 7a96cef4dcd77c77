"""Obstacles of an arm on its way, and its home posture, where every way begins."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.clear_ways import (
    APPROACH,
    CARRY,
    HELD,
    LIFT,
    MARGIN,
    OBJECT,
    OWN,
    POSTURE,
    REACH,
    SHOULDER_JOINTS,
    TABLE,
    Places,
    Scene,
    ways_clear,
)
from cgtorch.tabletop.kinematics.solids import Solids, with_boxed_hand

ALWAYS = REACH | APPROACH | LIFT | CARRY
OBJECT_RADIUS, OBJECT_HALF = 0.025, 0.05  # m, of the upright cylinder that stands for an object
SPREAD = 200
"""The number of random postures that show which solids overlap by design."""
BUILT_IN = 0.25
"""Solids that touch in more than this share of them overlap by design."""
NEARLY_ALL = 0.95
"""So do an arm's first links and the body that touch in more than this share of them."""
BITS = 62

SAMPLES, TRIED = 16_384, 2048  # random postures for home, and how many of them are looked at first
OFF_BODY = 3  # how good a home at least is whose first links are clear of the body, too
CENTRE = 0.01  # m: an arm whose shoulder is nearer to the middle than this has no side of its own
ABOVE = 1.0  # m: parts beyond the footprint stay above tables
TABLE_AHEAD, TABLE_SIZE = 0.05, (0.8, 1.6)  # m before the footprint; length and width
TABLE_TOPS = 0.55, 0.9  # m: the lowest point of the lowest table, and the top of the highest
BELOW_COSTS = 4.0
"""The cost of being beyond the footprint and low, or on the other arm's side, relative to being far
beyond the footprint."""


def scene_of(arm: ArmModel, body: Solids, others: Solids) -> Scene:
    """The scene of an arm, given the robot's body and the other arms at home, in the base frame."""
    n = len(arm.joint_names)
    pairs = _pairs(arm.solids.joints.tolist(), len(body), others.joints.tolist(), n)
    scene = _paired(arm, body, others, pairs)
    return _kept(scene, ~_built_in(arm, scene) & _near_enough(arm, scene))


def shoulder_scene(arm: ArmModel, body: Solids) -> Scene:
    """The scene of an arm's first links and the body, which ways do not check (`_pairs`).

    Neighbours may overlap by design, others only if they do in nearly every posture.
    """
    joints = arm.solids.joints.tolist()
    first = [i for i, moved in enumerate(joints) if moved <= SHOULDER_JOINTS]
    body_from = OWN + len(joints)
    pairs = [(OWN + i, body_from + k, ALWAYS) for i in first for k in range(len(body))]
    scene = _paired(arm, body, body[:0], torch.tensor(pairs, dtype=torch.long).view(-1, 3))
    usual = torch.tensor([BUILT_IN if joints[i - OWN] == 1 else NEARLY_ALL for i, _, _ in pairs])
    touch = _touching(arm, scene, random_postures(arm, SPREAD))
    return _kept(scene, (touch <= usual) & _near_enough(arm, scene))


def _kept(scene: Scene, which: Tensor) -> Scene:
    return replace(scene, pairs=scene.pairs[which], reach=scene.reach[which])


def _paired(arm: ArmModel, body: Solids, others: Solids, pairs: Tensor) -> Scene:
    """The scene of an arm with pairs (P, 3) of its solids."""
    n, tool = len(arm.joint_names), len(arm.chain(arm.lower)[1].kind) - 1
    size = arm.lower.new_tensor([[0, 0, OBJECT_HALF, OBJECT_RADIUS, 0]]).expand(OWN, 5)
    own = Solids(
        pose=torch.eye(4, dtype=size.dtype)[:3].expand(OWN, 3, 4),
        size=size,
        frame=torch.tensor([-1, -1, tool]),
        joints=torch.tensor([0, 0, n]),
    )
    every = own.joined(arm.solids, body, others)
    moving = torch.cat([(arm.chain(arm.lower)[1].kind > 0).cumsum(0), torch.zeros(1).long()])
    carried = moving[every.frame]  # how many joints move each solid, with those that follow others
    apart = [(first, int(carried[second])) for first, second, _ in pairs.tolist()]
    reaches = {each: _reach(arm, every, *each) for each in dict.fromkeys(apart)}
    reach = torch.stack([reaches[each] for each in apart]) if apart else arm.lower.new_empty(0, n)
    return Scene(every.pose, every.size, every.radius, every.frame, pairs, reach)


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
        pairs.append((i, TABLE, ALWAYS | POSTURE))
        pairs.append((i, OBJECT, REACH if joints == n else REACH | APPROACH))
        if joints < n:
            pairs.append((HELD, i, LIFT | CARRY))
        pairs.extend((i, k, ALWAYS | POSTURE) for k in torso if loose)
        pairs.extend((i, k, ALWAYS) for k, far in beside.items() if loose or far > SHOULDER_JOINTS)
    pairs.extend((i, k, ALWAYS) for i, k in itertools.permutations(arm, 2) if arm[i] > arm[k] + 1)
    return torch.tensor(pairs)


def _built_in(arm: ArmModel, scene: Scene) -> Tensor:
    """(P,) whether solids of the robot touch in most postures."""
    robot = (scene.pairs[:, :2] >= OWN).all(1)
    found = torch.zeros(len(robot), dtype=torch.bool)
    found[robot] = _touching(arm, _kept(scene, robot), random_postures(arm, SPREAD)) > BUILT_IN
    return found


def _touching(arm: ArmModel, scene: Scene, q: Tensor) -> Tensor:
    """(P,) in which share of postures (B, n) the solids of each pair of a scene touch."""
    found = torch.zeros(len(scene.pairs), dtype=torch.double)
    for some in torch.arange(len(scene.pairs)).split(BITS):
        bit = 1 << torch.arange(len(some))
        pairs = torch.cat([scene.pairs[some, :2], bit[:, None]], 1)
        alone = replace(scene, pairs=pairs, reach=scene.reach[some])
        kind = bit.repeat_interleave(len(q))
        clear = _clear_of_nothing_else(arm, alone, kind, q.repeat(len(some), 1))
        found[some] = 1 - clear.view(len(some), len(q)).double().mean(1)
    return found


def shoulders_touching(arm: ArmModel, body: Solids, q: Tensor) -> list[tuple[int, int]]:
    """Which solids of an arm's first links touch which of the body in a posture (n,)."""
    scene = shoulder_scene(arm, body)
    touch = scene.pairs[_touching(arm, scene, q[None]) > 0, :2] - OWN
    return [(i, k - len(arm.solids)) for i, k in touch.tolist()]


def _clear_of_table(arm: ArmModel, body: Solids, q: Tensor, front: float) -> Tensor:
    """(B,) whether postures (B, n) are clear of tables of usual height before the robot's front."""
    scene = scene_of(arm, body, body[:0])
    alone = _kept(scene, (scene.pairs[:, 1] == TABLE) & (scene.pairs[:, 0] >= OWN))
    (length, width), (low, high) = TABLE_SIZE, TABLE_TOPS
    pose = torch.eye(4).to(q)[:3]
    pose[:, 3] = q.new_tensor([front + TABLE_AHEAD + length / 2, 0.0, (low + high) / 2])
    size = q.new_tensor([length / 2, width / 2, (high - low) / 2, 0.0, 0.0])
    every = pose.expand(len(q), 3, 4)
    places = Places(every, size.expand(len(q), 5), every, every)
    return ways_clear(arm, alone, places, torch.full((len(q),), REACH), q[:, None])


def clear_of_robot(arm: ArmModel, scene: Scene, q: Tensor) -> Tensor:
    """(B,) whether an arm in postures (B, n) touches neither itself nor others of the robot."""
    return _clear_of(arm, _kept(scene, (scene.pairs[:, :2] >= OWN).all(1)), q)


def shoulders_clear(arm: ArmModel, body: Solids, q: Tensor) -> Tensor:
    """(B,) whether an arm's first links are clear of the body in postures (B, n)."""
    return _clear_of(arm, shoulder_scene(arm, body), q)


def _clear_of(arm: ArmModel, scene: Scene, q: Tensor) -> Tensor:
    return _clear_of_nothing_else(arm, scene, torch.full((len(q),), REACH), q)


def _clear_of_nothing_else(arm: ArmModel, scene: Scene, kind: Tensor, q: Tensor) -> Tensor:
    """(B,) whether postures (B, n) are clear for kinds (B,), with neither table nor object."""
    any_ = torch.full_like(kind, TABLE)  # as no pair has any of these
    nothing = Places(scene.pose[any_], scene.size[any_], scene.pose[any_], scene.pose[any_])
    return ways_clear(arm, scene, nothing, kind, q[:, None])


def _near_enough(arm: ArmModel, scene: Scene) -> Tensor:
    """(P,) whether an arm is long enough for pairs to meet, by distance from its first axis."""
    chain, b = arm.chain(arm.lower)[1], scene.pairs[:, 1]
    first = int((chain.kind > 0).nonzero()[0, 0])
    still = (b >= OWN) & (scene.frame[b] < 0) & (chain.kind[first] == 1)
    pose = arm.frames(arm.lower[None])[first, 0, :3]
    axis, offset = pose[:, :3] @ chain.axis[first], scene.pose[b, :, 3] - pose[:, 3]
    away = torch.linalg.cross(axis.expand_as(offset), offset).norm(dim=1) - scene.radius[b]
    return ~still | (away <= scene.reach[:, 0] + MARGIN)


def random_postures(arm: ArmModel, count: int) -> Tensor:
    """(count, n) random postures within limits, rad or m, always the same."""
    generator = torch.Generator().manual_seed(0)
    low, high = arm.turn_limits
    share = torch.rand(count, len(low), generator=generator, dtype=low.dtype)
    return low + share * (high - low)


def _reach(arm: ArmModel, solids: Solids, which: int, base: int) -> Tensor:
    """(n,) the largest distance of a solid's points from the axis of each joint that moves it.

    The first `base` joints do not count, as they move another solid, too. At every revolute joint,
    the links beyond it are assumed to be in one line, with prismatic joints extended. It is 1 for a
    prismatic joint. A joint that others follow moves it by these as well.
    """
    chain = arm.chain(arm.lower)[1]
    moving = (chain.kind > 0).cumsum(0)
    reach = arm.lower.new_zeros(len(arm.joint_names))
    # Points that no joint so far moves against each other, and how far others are from them.
    points, far = _corners(solids, which), float(solids.size[which, 4])
    if which == HELD:  # which is turned about the tool frame's origin as its grasp has it
        points, far = points.new_zeros(1, 3), float(solids.radius[which])
    for frame in range(int(solids.frame[which]), -1, -1):
        joint, kind, offset = int(chain.joint[frame]), int(chain.kind[frame]), chain.offset[frame]
        gain = abs(float(chain.gain[frame]))
        if kind and moving[frame] > base:
            axis = chain.axis[frame].expand_as(points)
            off = torch.linalg.cross(axis, points).norm(dim=1).max()
            reach[joint] += gain * (float(off) + far if kind == 1 else 1.0)
        if kind:
            far += float(points.norm(dim=1).max())
            points = points.new_zeros(1, 3)
        if kind == 2:
            far += gain * max(abs(float(arm.lower[joint])), abs(float(arm.upper[joint])))
        points = points @ offset[:, :3].T + offset[:, 3]
    return reach


def _corners(solids: Solids, which: int) -> Tensor:
    """(8, 3) corners of the box about a solid without its ball, in the solid's frame."""
    disc = solids.size[which, 3] * solids.size.new_tensor([1.0, 1.0, 0.0])
    signs = torch.tensor(list(itertools.product((1.0, -1.0), repeat=3))).to(disc)
    pose = solids.pose[which]
    return signs * (solids.size[which, :3] + disc) @ pose[:, :3].T + pose[:, 3]


def home_postures(
    arms: tuple[ArmModel, ...],
    body: Solids,
    footprint: tuple[float, float, float, float],
    named: Mapping[str, float],
) -> tuple[Tensor, ...]:
    """A posture (n,) of each arm, rad or m: as the description names it, or else computed."""
    if named:
        return tuple(_named(arm, named) for arm in arms)
    found, others = list[Tensor](), body[:0]
    for arm in arms:
        found.append(_computed(arm, body, others, footprint))
        others = others.joined(placed_at(arm, found[-1]))
    return tuple(found)


def placed_at(arm: ArmModel, q: Tensor) -> Solids:
    """The solids of an arm in a posture (n,), with its hand as a box, in the base frame."""
    solids = with_boxed_hand(arm.solids, len(q))
    return replace(solids.placed(arm.frames(q[None])[:, 0]), joints=solids.joints)


def _named(arm: ArmModel, named: Mapping[str, float]) -> Tensor:
    zero = torch.zeros_like(arm.lower).clamp(arm.lower, arm.upper)
    given = [named.get(name, float(at)) for name, at in zip(arm.joint_names, zero, strict=True)]
    return torch.tensor(given, dtype=arm.lower.dtype)


def _computed(
    arm: ArmModel, body: Solids, others: Solids, footprint: tuple[float, float, float, float]
) -> Tensor:
    """The best of many random postures: raised, near the body, and clear of it and of other arms.

    Its first links are clear of the body, and it is clear of tables before the robot, if there is
    such a posture. A hand below the height of tables would first have to come up past their edges.
    """
    q = random_postures(arm, SAMPLES)
    frames = arm.frames(q)
    ends, radius = arm.solids.capsules()
    carrier = frames[arm.solids.frame.repeat(2)].transpose(0, 1)
    points = (carrier[..., :3, :3] @ ends[..., None]).squeeze(-1) + carrier[..., :3, 3]
    x_min, x_max, y_min, y_max = footprint
    corner = points.new_tensor([[x_max, y_max], [x_min, y_min]])
    beyond = torch.maximum(points[..., :2] - corner[0], corner[1] - points[..., :2])
    beyond = (beyond.amax(-1) + radius).clamp_min(0)
    below = (ABOVE + radius - points[..., 2]).clamp_min(0)
    under = torch.minimum(beyond, below).amax(1)
    hand = arm.solids.joints.repeat(2) > len(arm.lower) / 2
    shoulder = float(frames[1, 0, 1, 3])  # y of the first joint; an arm may hang from the middle
    side = math.copysign(1.0, shoulder) if abs(shoulder) > CENTRE else 0
    crossed = (radius - side * points[..., 1]).clamp_min(0).amax(1) if side else 0.0
    height = (below * hand).amax(1)
    cost = beyond.amax(1) + height + BELOW_COSTS * (under + crossed)
    order = q[cost.argsort()]
    rated = _rated(arm, body, others, order[:TRIED], x_max)
    if rated.amax() < OFF_BODY:
        rated = torch.cat([rated, _rated(arm, body, others, order[TRIED:], x_max)])
    return order[int(rated.argmax())]


def _rated(arm: ArmModel, body: Solids, others: Solids, q: Tensor, front: float) -> Tensor:
    """(B,) how good postures (B, n) are as home, from 0 to 4; from `OFF_BODY` on nothing touches.

    The first links may have to touch the body, and tables may be in the way of any posture.
    """
    clear = _clear_at_home(arm, body, others, q)
    if len(others):  # which must be clear of this arm, too, whose hand is a box to them
        boxed = replace(arm, solids=with_boxed_hand(arm.solids, len(arm.lower)))
        clear &= _clear_at_home(boxed, body, others, q, len(boxed.solids) + len(body))
    off, free = shoulders_clear(arm, body, q).long(), _clear_of_table(arm, body, q, front).long()
    return clear * (1 + (OFF_BODY - 1) * off + free)


def _clear_at_home(
    arm: ArmModel, body: Solids, others: Solids, q: Tensor, least: int = 0
) -> Tensor:
    """(B,) whether postures (B, n) are clear of the robot's solids, from one of them on."""
    scene = scene_of(arm, body, others)
    robot = (scene.pairs[:, :2] >= OWN).all(1) & (scene.pairs[:, 1] >= OWN + least)
    return _clear_of(arm, _kept(scene, robot), q)
