"""Where a skill ends on each of many scenarios, all of which run at once."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.environment import Bounded, Environment, Lanes
from cgtorch.simulation.program import compile_graphs
from cgtorch.simulation.rollout import most_steps
from cgtorch.simulation.torch_engine import Frames, advance, first_frames, rollout_in_torch
from cgtorch.simulation.tracing import Step, step_at


@dataclass(frozen=True, eq=False)
class Ending:
    """How a skill ended on a scenario: success, failure or timeout, by which step, and where.

    `acts` is the number of steps, `percept` (D,) the last percept, and `tested` (T, D) are those at
    which it tested for success, and which were none. `returned` is the return, None without
    rewards; it is -inf if the episode is not over.
    """

    end: str
    step: Step
    acts: int
    percept: Tensor
    tested: Tensor
    returned: float | None


def endings(skill: Skill, environment: Environment) -> list[Ending]:
    """How a skill ends on each scenario of an environment."""
    every = torch.arange(environment.num_scenarios)
    most = environment.most_lanes if isinstance(environment, Bounded) else max(1, len(every))
    return [one for part in every.split(most) if len(part) for one in _of(skill, environment, part)]


def _of(skill: Skill, environment: Environment, scenarios: Tensor) -> list[Ending]:
    """`endings` of as many scenarios (n,) as run at once."""
    program = compile_graphs(skill.graph, skill.actions)
    now = first_frames(program, len(scenarios), skill.max_transitions)
    last, outcomes = now.rows(torch.arange(len(scenarios))), torch.zeros_like(now.node)
    tests = torch.tensor([action.request == "test" for action in program.actions.primitives])
    tested = [(outcomes[:0], torch.zeros(0, environment.percept_size))]

    def trace(active: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        here, changed = now.rows(active), torch.ones_like(active, dtype=torch.bool)
        outcomes[active] = outcome
        missed = tests[program.kind[here.node]] & (outcome > 0)
        tested.append((active[missed], lanes.percept[missed].clone()))
        _put(last, active, here)
        _put(now, active, advance(program, now.rows(active), outcome, changed)[0])

    steps = most_steps(skill.actions, skill.max_transitions)
    with torch.no_grad():
        runs = rollout_in_torch(
            program, environment, scenarios, skill.max_transitions, steps, trace
        )
    ends = torch.where(runs.succeeded[0], 0, torch.where(runs.timed_out[0], 2, 1)).tolist()
    who, where = (torch.cat(column) for column in zip(*tested, strict=True))
    returns = [None] * len(ends) if runs.returns is None else runs.returns[0].tolist()
    return [
        Ending(
            ("success", "failure", "timeout")[end],
            step_at(skill, program, last.rows(torch.tensor([i])), int(outcomes[i])),
            int(runs.transitions[0, i]),
            runs.percept[0, i],
            where[who == i],
            returns[i],
        )
        for i, end in enumerate(ends)
    ]


def _put(frames: Frames, index: Tensor, rows: Frames) -> None:
    """Overwrite the frames at `index` (k,)."""
    for column in fields(frames):
        getattr(frames, column.name)[index] = getattr(rows, column.name)
