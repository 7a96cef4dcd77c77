"""Dry run of rows alone: no result of a batch may depend on its other rows."""

import time
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.dry_run import first_difference, kind, returned
from cgtorch.ground.environment import Environment, Episodic, Lanes, Rewarded, start_lanes
from cgtorch.ground.errors import WorldError
from cgtorch.ground.whole_episode import ROUNDED, SECONDS

TOGETHER = 8  # rows of a batch, as a condition of the user's may be met only now and then
TRIED = 3  # motions, at most

Shown: TypeAlias = tuple[Lanes, dict[str, Tensor]]
"""Lanes, and their results by what they are."""


def what_others_change(environment: Environment, controls: Tensor) -> str:
    """What a row of a checked environment shows otherwise alone than in a batch, or "".

    Rows have different ones of the `controls` (N, U). Each motion begins where the batch is, for a
    row alone, too, as little differences would grow.
    """
    until = time.monotonic() + SECONDS
    rows = torch.arange(min(TOGETHER, environment.num_scenarios))
    lanes, differs = _compared(environment, rows, partial(_begun, environment))
    for motion, control in enumerate(controls.split(len(rows))[:TRIED], 1):
        if differs or time.monotonic() > until:
            break
        moved = partial(_moved, environment, lanes, control, motion)
        lanes, differs = _compared(environment, rows, moved)
    return differs


def _compared(
    environment: Environment, rows: Tensor, look: Callable[[Tensor], Shown]
) -> tuple[Lanes, str]:
    """The lanes of all rows (n,) that are looked at, and what one shows otherwise alone."""
    name, n = type(environment).__name__, len(rows)
    lanes, together = returned(WorldError, name, look, rows, tried=f"{n} rows")
    alone = [returned(WorldError, name, look, row, tried="one row")[1] for row in rows.split(1)]
    for what, numbers in together.items():
        for found in (each[what] for each in alone):
            if found.shape != numbers[:1].shape:
                raise WorldError(
                    f"{name} gave {what.format(1)} in {kind(found)} for one row, in "
                    f"{kind(numbers)} for {n}; keep the dimension of rows"
                )
    apart = {what: torch.cat([each[what] for each in alone]) for what in together}
    return lanes, first_difference(environment, apart, together, ROUNDED)


def _begun(environment: Environment, rows: Tensor) -> Shown:
    """The start of scenarios (n,)."""
    lanes = start_lanes(environment, rows, environment.control_size, 0)
    return lanes, {"number {} of the first percept": lanes.percept}


def _moved(
    environment: Environment, lanes: Lanes, control: Tensor, motion: int, rows: Tensor
) -> Shown:
    """What rows of lanes show after a motion."""
    after, done = environment.step(lanes.rows(rows), control[rows].to(lanes.percept))
    shown = {
        f"whether motion {motion} could be done": done,
        f"number {{}} of the percept after motion {motion}": after.percept,
        f"success after motion {motion}": environment.success(after)[1],
    }
    if isinstance(environment, Episodic):
        shown[f"whether it is over after motion {motion}"] = environment.over(after)
    if isinstance(environment, Rewarded):
        shown[f"the return after motion {motion}"] = environment.returns(after)
    return after, shown
