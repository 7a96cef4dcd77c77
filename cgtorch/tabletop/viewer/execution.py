"""One skill on one scenario, step by step, with all that can be seen of it."""

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import Action
from cgtorch.environment import Lanes, start_lanes
from cgtorch.graphs import Skill, SubSkill
from cgtorch.simulation import MAX_STEPS
from cgtorch.simulation.action_table import FAILURE, SUCCESS
from cgtorch.simulation.call_stack import Frames, first_frames, follow
from cgtorch.simulation.program import Program, compile_graphs
from cgtorch.tabletop.world import Scenarios, TabletopWorld

Place: TypeAlias = tuple[Skill, int]
"""A node: the skill it belongs to and its slot in that skill's graph."""


@dataclass(frozen=True)
class Step:
    """One action that was executed.

    Attributes:
        places: the node, last, and before it the nodes of the sub-skills that it runs in.
        name: of the action.
        action: the action.
        outcome: how it came out.
    """

    places: tuple[Place, ...]
    name: str
    action: Action
    outcome: str


@dataclass(frozen=True)
class Execution:
    """What a skill did on a scenario, in T steps.

    Attributes:
        skill: the skill.
        scenario: the one scenario.
        steps: T of them.
        end: success, failure or timeout.
        pose: (T + 1, 3) base x, y (m), θ (rad) before the first step and after each.
        percept: (T + 1, D) what the robot had perceived by then.
        message: (T + 1, M) the message travelling along the edges, NaN where there is none.
        memory: (T + 1, C) the common memory.
    """

    skill: Skill
    scenario: Scenarios
    steps: tuple[Step, ...]
    end: str
    pose: Tensor
    percept: Tensor
    message: Tensor
    memory: Tensor


def execute(skill: Skill, world: TabletopWorld, scenario: int = 0) -> Execution:
    """Run a skill on one scenario of a world, exactly as `cgtorch.simulation.rollout` does.

    Args:
        skill: what to run.
        world: where; its percepts must be those that the skill reads.
        scenario: index into the world's scenarios.
    """
    program = compile_graphs(skill.graph, skill.actions)
    sizes = program.message_size, program.memory_size
    lanes = start_lanes(world, torch.tensor([scenario]), *sizes)
    frames = first_frames(program, 1, skill.max_transitions)
    seen, steps, end = [lanes], list[Step](), torch.zeros(1)
    while not end.any() and len(steps) < MAX_STEPS:
        node = frames.node
        action = program.primitives[int(program.kind[node])]
        parameters = program.parameters[node, : action.num_parameters]
        lanes, outcome = action(lanes, parameters, world)
        steps.append(_step(skill, program, frames, action, int(outcome)))
        seen.append(lanes)
        # That something has changed keeps loops from being skipped, which only saves time.
        frames, end, _ = follow(program, frames, outcome, torch.ones(1, dtype=torch.bool))
    return Execution(
        skill,
        world.scenarios[torch.tensor([scenario])],
        tuple(steps),
        {SUCCESS: "success", FAILURE: "failure"}.get(int(end), "timeout"),
        pose=torch.cat([x.state[:, :3] for x in seen]),
        percept=torch.cat([x.percept for x in seen]),
        message=torch.cat([_message(x) for x in seen]),
        memory=torch.cat([x.memory for x in seen]),
    )


def _message(lanes: Lanes) -> Tensor:
    return lanes.message.masked_fill(~lanes.has_message[:, None], float("nan"))


def _step(skill: Skill, program: Program, frames: Frames, action: Action, outcome: int) -> Step:
    """The step that the only lane is about to make, named by the nodes that it is at."""
    callers = frames.caller[0, 1 : int(frames.level) + 1].tolist()
    places, within, offset = [], skill, 0
    for row in callers:
        places.append((within, row - offset))
        within = _inner(*places[-1])
        first = program.entry[int(program.kind[row]) - len(program.primitives)]
        offset = int(first) - int(within.graph.start)
    places.append((within, int(frames.node) - offset))
    name = within.actions.names[int(within.graph.action[0, places[-1][1]])]
    return Step(tuple(places), name, action, action.outcomes[outcome])


def _inner(skill: Skill, slot: int) -> Skill:
    """The skill that a node of another one stands for."""
    action = skill.actions.actions[int(skill.graph.action[0, slot])]
    assert isinstance(action, SubSkill)  # noqa: S101 - the engine only calls these
    return action.skill
