"""One skill on one scenario, step by step: which nodes acted, and what they did."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import Action, Skill
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.simulation.program import Program, compile_graphs
from cgtorch.simulation.rollout import most_steps
from cgtorch.simulation.torch_engine import (
    Frames,
    Rollouts,
    advance,
    first_frames,
    rollout_in_torch,
)

Place: TypeAlias = tuple[Skill, int]
"""A node: its skill, and its slot in that skill's graph."""


@dataclass(frozen=True)
class Step:
    """An executed action; `places` are the nodes that contain it, its own node last."""

    places: tuple[Place, ...]
    name: str
    action: Action
    outcome: str


@dataclass(frozen=True)
class Traced:
    """The run of a skill on a scenario, in T steps.

    Attributes:
        steps: The executed actions.
        lanes: The only lane before the first step and after each, T + 1 in all.
        end: success, failure or timeout.
    """

    steps: tuple[Step, ...]
    lanes: tuple[Lanes, ...]
    end: str


def traced(
    skill: Skill,
    environment: Environment,
    scenario: int = 0,
    ended: Callable[[], object] = lambda: None,
) -> Traced:
    """Run a skill on one scenario of an environment; `ended` is called after each step."""
    program, which = compile_graphs(skill.graph, skill.actions), torch.tensor([scenario])
    frames = first_frames(program, 1, skill.max_transitions)
    sizes = program.actions.message_size, program.actions.memory_size
    seen, steps = [start_lanes(environment, which, *sizes)], list[Step]()

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        nonlocal frames
        steps.append(step_at(skill, program, frames, int(outcome)))
        seen.append(lanes.rows(torch.zeros_like(active)))
        ended()
        # That something has changed keeps loops from being skipped, which only saves time.
        frames, _, _ = advance(program, frames, outcome, torch.ones(1, dtype=torch.bool))

    most = most_steps(skill.actions, skill.max_transitions)
    run = rollout_in_torch(program, environment, which, skill.max_transitions, most, trace)
    return Traced(tuple(steps), tuple(seen), end_of(run))


def end_of(run: Rollouts) -> str:
    """How the rollout of one graph on one scenario ended: success, failure or timeout."""
    return "success" if run.succeeded else "timeout" if run.timed_out else "failure"


def step_at(skill: Skill, program: Program, frames: Frames, outcome: int) -> Step:
    """The next step of the only lane, with the names of its nodes."""
    places, within, offset = [], skill, 0
    for row in frames.caller[0, 1 : int(frames.level) + 1].tolist():
        places.append((within, row - offset))
        within = within.sub_skills[name_of(*places[-1])]
        first = program.entry[int(program.kind[row]) - len(program.actions.primitives)]
        offset = int(first) - int(within.graph.start)
    places.append((within, int(frames.node) - offset))
    action = program.actions.primitives[int(program.kind[frames.node])]
    return Step(tuple(places), name_of(*places[-1]), action, action.outcomes[outcome])


def name_of(skill: Skill, slot: int) -> str:
    """The name of the action at a node."""
    return skill.actions.names[int(skill.graph.action[0, slot])]
