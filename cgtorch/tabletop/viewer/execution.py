"""One skill on one scenario, step by step, with everything that the page shows."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.simulation.tracing import Step, traced
from cgtorch.tabletop.world import ObservedTabletop, Scenarios, draw_of
from cgtorch.tabletop.world.geometry import rotate

FROM_EDGE = 0.03  # m that a dragged object keeps from the table's edges


def scenario_of(kind: str, count: int, seed: int, number: int) -> Scenarios:
    """Scenario `number`, from 0 on, of those that `cgtorch-evaluate` tries."""
    drawn = draw_of(kind)(count, Generator().manual_seed(seed))
    return drawn[torch.tensor([number])]


def put_object(scenario: Scenarios, at: Tensor) -> Scenarios:
    """The scenario with its object at (2,) m, or at the nearest place on the table."""
    table = scenario.table[0]
    half = table[3:5] / 2 - FROM_EDGE
    local = rotate(at - table[:2], -table[2])
    placed = rotate(local.clamp(-half, half), table[2]) + table[:2]
    return replace(scenario, object=placed[None])


@dataclass(frozen=True)
class Execution:
    """The run of a skill on a scenario, in T steps.

    Attributes:
        end: success, failure or timeout.
        pose: (T + 1, 3) base x, y (m), θ (rad) before the first step and after each.
        object: (T + 1, 3) the foot of the object, m.
        percept: (T + 1, D) the last percept.
        message: (T + 1, M) the message on the current edge, NaN without one.
    """

    skill: Skill
    scenario: Scenarios
    steps: tuple[Step, ...]
    end: str
    pose: Tensor
    object: Tensor
    percept: Tensor
    message: Tensor


def execute(
    skill: Skill,
    world: ObservedTabletop,
    scenario: int = 0,
    ended: Callable[[], object] = lambda: None,
) -> Execution:
    """Run a skill on one scenario of a world with the percepts that the skill reads.

    `ended` is called after each step.
    """
    run, which = traced(skill, world, scenario, ended), torch.tensor([scenario])
    return Execution(
        skill, world.scenarios[which], run.steps, run.end,
        pose=torch.cat([x.state[:, :3] for x in run.lanes]),
        object=torch.cat([world.placed(x.state) for x in run.lanes]),
        percept=torch.cat([x.percept for x in run.lanes]),
        message=torch.cat([x.message.where(x.has_message[:, None], torch.nan) for x in run.lanes]),
    )  # fmt: skip
