"""Whether postures of an arm touch the table or the robot's own body."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.native import constants, function, structure, suits, threads
from cgtorch.tabletop.kinematics.arm import ArmModel
from cgtorch.tabletop.kinematics.collision import BISECTIONS, ROUNDING, Boxes, collide

SHOULDER_JOINTS = 3
"""Joint limits keep links that at most this many joints move off the body; only the table can stop
them."""

WORTH_SHARING = 512  # postures that are worth one more thread: about a quarter of a millisecond
_POSTURES = 2048  # tried at a time in torch: more fall out of the processor's cache


def touches(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor:
    """(B,) bool, whether an arm at q (B, n), rad or m, touches its row's table or the body.

    Tables are (B, N, ...), or one for all (1, N, ...); the body is (N, ...).
    """
    found = _touches_compiled(arm, q, slab, body)
    return touches_in_torch(arm, q, slab, body) if found is None else found


def touches_in_torch(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor:
    """The same as `touches`, on any device."""
    capsules = arm.capsules.to(q)
    loose = capsules.joints > SHOULDER_JOINTS
    hit = torch.zeros(len(q), dtype=torch.bool, device=q.device)
    for first in range(0, len(q), _POSTURES):
        part = slice(first, first + _POSTURES)
        start, end = capsules.placed(arm.frames(q[part]))
        near = slab[part] if len(slab.half) > 1 else slab
        hit[part] = collide(start, end, capsules.radius, near)
        hit[part] |= collide(start[:, loose], end[:, loose], capsules.radius[loose], body[None])
    return hit


def _touches_compiled(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Tensor | None:
    """The same compiled, posture after posture with all frames of one in the cache; else None."""
    call = function("arms_touch", torch.float32)
    boxes = [*vars(slab).values(), *vars(body).values()]
    if call is None or q.dtype != torch.float32 or not suits(q, *boxes):
        return None
    if len(slab.half) not in (1, len(q)) or q.shape[1] != len(arm.joint_names):
        return None
    task, hit = touch_task(arm, q, slab, body), torch.empty(len(q), dtype=torch.bool)
    if task is None:
        return None
    task.hit = hit.data_ptr()
    call(task, max(1, min(threads(), len(q) // WORTH_SHARING)))
    return hit


def touch_task(arm: ArmModel, q: Tensor, slab: Boxes, body: Boxes) -> Any | None:
    """The input of compiled code, without its output; None if it is not supported."""
    most, capsules, chain = constants("arm_limits", q.dtype), arm.capsules.to(q), arm.chain(q)[1]
    count, frames = len(capsules.radius), len(chain.kind)
    if not most or frames > most["MOST_FRAMES"] or count > most["MOST_CAPSULES"]:
        return None
    several, same = structure("Boxes", q.dtype), len(slab.half) == 1
    return structure("Arms", q.dtype)(
        chain=structure("Chain", q.dtype)(**vars(chain), frames=frames, joints=q.shape[1]),
        table=several(**vars(slab), count=slab.half.shape[-2], same=same),
        body=several(**vars(body), count=body.half.shape[-2], same=True),
        q=q, start=capsules.start, end=capsules.end, radius=capsules.radius, frame=capsules.frame,
        loose=capsules.joints > SHOULDER_JOINTS, hit=None, postures=len(q), capsules=count,
        bisections=BISECTIONS, rounding=ROUNDING,
    )  # fmt: skip
