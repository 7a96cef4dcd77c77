"""Whether postures of an arm touch the table or the robot's own body."""

import ctypes

import torch
from torch import Tensor

from cgtorch.native import function, threads
from cgtorch.native.structures import (
    MOST_CAPSULES,
    MOST_FRAMES,
    POINTER,
    WHOLE,
    structures,
    suits,
)
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.collision import BISECTIONS, ROUNDING, Boxes, collide

SHOULDER_JOINTS = 3
"""Links that hang from fewer joints than this, or as many, are held off the body by joint limits
and by being built beside it; only the table can stop them."""

WORTH_SHARING = 512  # postures that are worth one more thread: about a quarter of a millisecond
_POSTURES = 2048  # tried at a time in torch: more fall out of the processor's cache


def touches(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor:
    """Whether an arm with joint positions q (B, n), rad or m, touches something (B,).

    That is the table of each row (B, N, ...) or the robot's own body (N, ...).
    """
    found = _touches_compiled(arm, q, slab, body)
    return touches_in_torch(arm, q, slab, body) if found is None else found


def touches_in_torch(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor:
    """What `touches` says, on any device."""
    capsules = arm.capsules.to(q)
    loose = capsules.joints > SHOULDER_JOINTS
    hit = torch.zeros(len(q), dtype=torch.bool, device=q.device)
    for first in range(0, len(q), _POSTURES):
        part = slice(first, first + _POSTURES)
        start, end = capsules.placed(arm.frames(q[part]))
        hit[part] = collide(start, end, capsules.radius, slab[part])
        hit[part] |= collide(start[:, loose], end[:, loose], capsules.radius[loose], body[None])
    return hit


def _touches_compiled(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor | None:
    """The same, posture after posture with all frames of one in the cache, where it is compiled."""
    call = function("arms_touch", torch.float32, POINTER, WHOLE)
    boxes = [*vars(slab).values(), *vars(body).values()]
    if call is None or q.dtype != torch.float32 or not suits(q, *boxes):
        return None
    capsules, chain = arm.capsules.to(q), arm.chain_table(q)
    count, frames = len(capsules.radius), len(chain.kind)
    shapes = len(slab.half), q.shape[1]
    if frames > MOST_FRAMES or count > MOST_CAPSULES or shapes != (len(q), len(arm.joint_names)):
        return None
    given = [x.contiguous() for x in (q, *boxes, capsules.start, capsules.end, capsules.radius)]
    q, *boxes, start, end, radius = given
    frame, loose = capsules.frame.contiguous(), capsules.joints > SHOULDER_JOINTS
    hit, made = torch.empty(len(q), dtype=torch.bool), structures(torch.float32)
    table, own = (
        made.Collision(
            None, None, radius.data_ptr(), *(x.data_ptr() for x in each),
            len(q), count, each[2].shape[-2], same, BISECTIONS, ROUNDING, None,
        )
        for each, same in ((boxes[:3], False), (boxes[3:], True))
    )  # fmt: skip
    task = made.Arms(
        made.Chain(*(x.data_ptr() for x in vars(chain).values()), frames, q.shape[1]),
        table, own, *(x.data_ptr() for x in (q, start, end, frame, loose, hit)),
    )  # fmt: skip
    call(ctypes.addressof(task), max(1, min(threads(), len(q) // WORTH_SHARING)))
    return hit
