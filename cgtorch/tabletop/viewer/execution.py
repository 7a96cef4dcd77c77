"""One skill on one scenario, step by step, with everything that the page shows."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Action, Skill
from cgtorch.ground.environment import Lanes, start_lanes
from cgtorch.simulation import most_steps
from cgtorch.simulation.program import Program, compile_graphs
from cgtorch.simulation.torch_engine import Frames, advance, first_frames, rollout_in_torch
from cgtorch.tabletop.world import ObservedTabletop, Scenarios, draw_of
from cgtorch.tabletop.world.geometry import rotate

FROM_EDGE = 0.03  # m that a dragged object keeps from the table's edges
Place: TypeAlias = tuple[Skill, int]
"""A node: its skill, and its slot in that skill's graph."""


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
class Step:
    """An executed action; `places` are the nodes that contain it, its own node last."""

    places: tuple[Place, ...]
    name: str
    action: Action
    outcome: str


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
    program, which = compile_graphs(skill.graph, skill.actions), torch.tensor([scenario])
    frames = first_frames(program, 1, skill.max_transitions)
    sizes = program.actions.message_size, program.actions.memory_size
    seen = [start_lanes(world, which, *sizes)]
    steps: list[Step] = []

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        nonlocal frames
        steps.append(_step(skill, program, frames, int(outcome)))
        seen.append(lanes.rows(torch.zeros_like(active)))
        ended()
        # That something has changed keeps loops from being skipped, which only saves time.
        frames, _, _ = advance(program, frames, outcome, torch.ones(1, dtype=torch.bool))

    most = most_steps(skill.actions, skill.max_transitions)
    run = rollout_in_torch(program, world, which, skill.max_transitions, most, trace)
    end = "success" if run.succeeded else "timeout" if run.timed_out else "failure"
    return Execution(
        skill, world.scenarios[which], tuple(steps), end,
        pose=torch.cat([x.state[:, :3] for x in seen]),
        object=torch.cat([world.placed(x.state) for x in seen]),
        percept=torch.cat([x.percept for x in seen]),
        message=torch.cat([x.message.where(x.has_message[:, None], torch.nan) for x in seen]),
    )  # fmt: skip


def _step(skill: Skill, program: Program, frames: Frames, outcome: int) -> Step:
    """The next step of the only lane, with the names of its nodes."""
    places, within, offset = [], skill, 0
    for row in frames.caller[0, 1 : int(frames.level) + 1].tolist():
        places.append((within, row - offset))
        within = within.sub_skills[_name(*places[-1])]
        first = program.entry[int(program.kind[row]) - len(program.actions.primitives)]
        offset = int(first) - int(within.graph.start)
    places.append((within, int(frames.node) - offset))
    action = program.actions.primitives[int(program.kind[frames.node])]
    return Step(tuple(places), _name(*places[-1]), action, action.outcomes[outcome])


def _name(skill: Skill, slot: int) -> str:
    """The name of the action at a node."""
    return skill.actions.names[int(skill.graph.action[0, slot])]
