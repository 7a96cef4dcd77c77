"""Grasp labels that require a way of the arm, beside those that require a posture only."""

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
from cgtorch.tabletop.kinematics import graspable, has_posture, load_robot
from cgtorch.tabletop.world.geometry import rotate

LOST = 0.1
"""The largest share of the objects with a posture that may have no way; more indicates a bug."""


def grasp_way(effort: Effort) -> Line:
    """Labels of the same random objects by both meanings of the setting `grasp`."""
    with run_threads(1):
        parts = tuple(_of_robot(name, int(4000 * effort.size), effort) for name in ("pr2", "fetch"))
    return Line(
        name="grasp_way",
        compared="grasps with a way of the arm / with a posture alone, float32, one thread",
        unit="x the time",
        target=2.0,
        clock="CPU",
        threads=1,
        parts=parts,
        at_most=True,
    )


def _of_robot(name: str, count: int, effort: Effort) -> Comparison:
    robot = load_robot(description=name)
    asked = robot, *objects(count)
    way, posture = graspable(*asked), has_posture(*asked)
    lost = float((posture & ~way).sum() / posture.sum())
    if bool((way & ~posture).any()) or lost > LOST:
        raise DisagreementError(f"{lost:.1%} of grasps have no way of the arm; nothing was timed")
    works = partial(graspable, *asked), partial(has_posture, *asked)
    ours, other = in_turns(works, effort.repeats, CPU)
    return Comparison(
        label=f"{name}, {count} objects",
        ours=ours,
        other=other,
        ratio=ours.median / other.median,
        difference=None,
        sizes={"objects": count},
        note=f"{count / ours.median:.3g} labels/s; {lost:.1%} of the postures have no way",
    )


def objects(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Objects (count, 3) at the edge of tables (count, 6), seen from bases just before them."""
    draw = torch.rand(count, 5, generator=torch.Generator().manual_seed(seed))
    gap, inset = 0.36 + 0.54 * draw[:, 0], 0.05 + 0.2 * draw[:, 1]
    along, sideways, yaw = 1.1 * draw[:, 2] - 0.55, 1.2 * draw[:, 3] - 0.6, 1.4 * draw[:, 4] - 0.7
    there = rotate(torch.stack([gap + inset, along - sideways], 1), -yaw)
    middle = rotate(torch.stack([gap + 0.4, -sideways], 1), -yaw)
    one = torch.ones(count, 1)
    table = torch.cat([middle, -yaw[:, None], 0.8 * one, 1.2 * one, 0.74 * one], 1)
    return torch.cat([there, 0.74 * one], 1), table
