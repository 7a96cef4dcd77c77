"""Collision tests of postures, beside pytorch-kinematics in torch."""

import math
from functools import partial

import torch

from benchmarks.measure import (
    CPU,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    in_turns,
    run_threads,
)
from cgtorch.tabletop.kinematics import load_robot
from cgtorch.tabletop.kinematics.grasping import table_slab
from cgtorch.tabletop.kinematics.touching import touches, touches_in_torch

TABLE = torch.tensor([[0.9, 0.1, 0.3, 0.8, 1.2, 0.7]])
BORDERLINE = 1e-3
"""The share of postures whose results may differ, as rounding decides them."""


def touching(effort: Effort) -> Line:
    """Frames, capsules and boxes of random postures in one pass, against one after the other."""
    with run_threads(1):
        parts = tuple(_of_robot(name, int(4000 * effort.size), effort) for name in ("pr2", "fetch"))
    return Line(
        name="touching",
        compared="whether arms touch a table or their body / frames by pytorch-kinematics and "
        "capsules in torch, float32, one thread",
        unit="x faster",
        target=4.0,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _of_robot(name: str, count: int, effort: Effort) -> Comparison:
    robot, generator = load_robot(description=name), torch.Generator().manual_seed(0)
    arm = robot.arms[0]
    lower = torch.where(arm.continuous, -math.pi, arm.lower).float()
    upper = torch.where(arm.continuous, math.pi, arm.upper).float()
    q = lower + (upper - lower) * torch.rand(count, len(lower), generator=generator)
    asked = arm, q, table_slab(TABLE.expand(count, 6)), robot.body.to(q)
    gap = float((touches(*asked) != touches_in_torch(*asked)).float().mean())
    if gap > BORDERLINE:
        raise DisagreementError(f"{gap:.1%} of postures are said otherwise; nothing was timed")
    works = partial(touches, *asked), partial(touches_in_torch, *asked)
    ours, other = in_turns(works, effort.repeats, CPU, calls=[5, 1])
    return Comparison(
        label=f"{name}, {count} postures",
        ours=ours,
        other=other,
        ratio=other.median / ours.median,
        difference=gap,
        sizes={"postures": count, "joints": len(lower)},
        note=f"{count / ours.median:.3g} postures/s",
    )
