"""The gradient by which gating networks are trained, beside automatic differentiation in torch."""

from functools import partial

import torch

from benchmarks.measure import CPU, Comparison, Effort, Line, difference, in_turns, run_threads
from cgtorch.graphs import BranchingNN
from cgtorch.improvement.gating import RESTARTS, gradient_in_torch, gradient_of

CASES = {"S1": (760, 2), "S3": (1160, 4)}
"""Scenarios and members in the middle and at the end of a run."""
ROUNDING = 1e-5


def gating_gradient(effort: Effort) -> Line:
    """One step of all restarts, in C and by autograd."""
    with run_threads(1):
        parts = tuple(_of_stage(stage, effort) for stage in CASES)
    return Line(
        name="gating_gradient",
        compared="gradient of gating networks / automatic differentiation in torch, float32, one "
        "thread",
        unit="x faster",
        target=5.0,
        clock="CPU",
        threads=1,
        parts=parts,
    )


def _of_stage(stage: str, effort: Effort) -> Comparison:
    (count, members), branch = CASES[stage], BranchingNN()
    generator = torch.Generator().manual_seed(0)
    percepts = torch.randn(count, branch.inputs, generator=generator)
    solves = torch.randint(0, 4, (count, members), generator=generator) / 3
    shape = (RESTARTS, members - 1, branch.num_parameters)
    parameters, weight = torch.randn(shape, generator=generator), torch.ones(count)
    gradients = (
        gradient_of(branch, solves, weight, RESTARTS),
        gradient_in_torch(branch, solves, weight),
    )
    gap = difference(*(each(parameters, percepts) for each in gradients), ROUNDING)
    works = [partial(each, parameters, percepts) for each in gradients]
    ours, other = in_turns(works, effort.repeats, CPU, calls=[200, 40])
    return Comparison(
        label=f"{stage}: {count} scenarios, {members} members",
        ours=ours,
        other=other,
        ratio=other.median / ours.median,
        difference=gap,
        sizes={"scenarios": count, "members": members, "restarts": RESTARTS},
    )
