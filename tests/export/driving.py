"""What the library makes a robot do, and an exported step on the same robot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.export.step import REQUESTS
from cgtorch.graphs import Action, Skill
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.stored_run import StoredRun
from cgtorch.simulation import MAX_STEPS, rollout
from cgtorch.simulation.program import compile_graphs

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
Step: TypeAlias = Callable[[Tensor, Tensor, Tensor, Tensor], Sequence[Tensor]]


@cache
def reference() -> tuple[StoredRun, Skill]:
    return last_skill(REFERENCE)


@dataclass
class Execution:
    """What a robot was asked for in one run of a skill, what came out, and the end.

    `percepts` holds what was perceived at the start and after each routine.
    """

    percepts: list[Tensor]
    routines: list[str] = field(default_factory=list)
    controls: list[Tensor] = field(default_factory=list)
    outcomes: list[int] = field(default_factory=list)
    end: str = ""
    steps: int = 0


def by_the_library(
    skill: Skill, environment: Environment, max_steps: int = MAX_STEPS
) -> tuple[list[Execution], list[list[tuple[Action, int]]]]:
    """An execution for each scenario, and all actions with their outcomes, told by the engine."""
    program = compile_graphs(skill.graph, skill.actions)
    n = environment.num_scenarios
    found = [Execution([p]) for p in environment.start(torch.arange(n))[1]]
    actions: list[list[tuple[Action, int]]] = [[] for _ in range(n)]

    def trace(lane: Tensor, node: Tensor, outcome: Tensor, lanes: Lanes) -> None:
        kinds = program.kind[node].tolist()
        for row, (i, kind, out) in enumerate(
            zip(lane.tolist(), kinds, outcome.tolist(), strict=True)
        ):
            action, run = program.actions.primitives[kind], found[i]
            actions[i].append((action, out))
            motion = lanes.message[row, : environment.control_size]
            idle = not lanes.has_message[row] or not motion.isfinite().all()
            asks = vars(type(action)).get("request", "")
            moves = asks == "control"
            if not asks or (moves and idle):
                continue
            run.routines.append(asks)
            run.controls.append(motion.clone() if moves else torch.zeros_like(motion))
            run.outcomes.append(out)
            run.percepts.append(lanes.percept[row].clone())

    runs = rollout(
        skill.graph, skill.actions, environment, max_transitions=skill.max_transitions,
        max_steps=max_steps, trace=trace,
    )  # fmt: skip
    for i, run in enumerate(found):
        ended = "timeout" if runs.timed_out[0, i] else "failure"
        run.end = "success" if runs.succeeded[0, i] else ended
        run.steps = int(runs.transitions[0, i])
    return found, actions


def by_steps(
    step: Step, about: dict[str, Any], environment: Environment, scenario: int
) -> Execution:
    """The same by an exported step: whatever it asks for is done in the environment."""
    lanes = start_lanes(environment, torch.tensor([scenario]), about["control"], 0)
    run = Execution([lanes.percept[0]])
    outcome = torch.tensor(0)
    place, mind = torch.zeros(about["place"], dtype=torch.long), torch.zeros(about["mind"])
    while True:
        request, control, place, mind = step(lanes.percept[0], outcome, place, mind)
        wanted = REQUESTS[int(request)]
        if about["requests"][int(request)] not in about["outcomes"]:
            run.end, run.steps = wanted, int(place[3])
            return run
        lanes, out = act(wanted, lanes, control, environment)
        run.routines.append(wanted)
        run.controls.append(control)
        run.outcomes.append(out)
        run.percepts.append(lanes.percept[0])
        outcome = torch.tensor(out)


def act(wanted: str, lanes: Lanes, control: Tensor, environment: Environment) -> tuple[Lanes, int]:
    """A routine and its outcome's index."""
    match wanted:
        case "control":
            lanes, moved = environment.step(lanes, control[None])
            return lanes, int(not moved)
        case "perceive":
            return environment.observe(lanes), 0
        case "test":
            lanes, probability = environment.success(lanes)
            return lanes, int(probability <= 0.5)
    raise AssertionError(wanted)


def assert_same(one: Execution, other: Execution, tolerance: float = 0.0) -> None:
    assert (one.routines, one.outcomes, one.end, one.steps) == (
        other.routines, other.outcomes, other.end, other.steps,
    )  # fmt: skip
    for a, b in zip(one.controls + one.percepts, other.controls + other.percepts, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=tolerance, equal_nan=True)


def stacked(runs: list[Execution]) -> dict[str, Tensor]:
    """Executions as tensors, for another process: the inputs of all steps and what is to come out.

    Step t of run i gets `percept[t, i]` and `outcome[t, i]` and is to give `request` (by name:
    0 success, 1 failure, 2 timeout, then control, perceive, test) and `control`. `rows` (R,) says
    how many steps a run has.
    """
    longest = max(len(r.percepts) for r in runs)
    size, motion = len(runs[0].percepts[0]), 3
    out = {
        "rows": torch.tensor([len(r.percepts) for r in runs]),
        "percept": torch.zeros(longest, len(runs), size),
        "outcome": torch.zeros(longest, len(runs), dtype=torch.long),
        "request": torch.zeros(longest, len(runs), dtype=torch.long),
        "control": torch.zeros(longest, len(runs), motion),
    }
    for i, run in enumerate(runs):
        for t, percept in enumerate(run.percepts):
            out["percept"][t, i] = percept
            if t:
                out["outcome"][t, i] = run.outcomes[t - 1]
            last = t == len(run.routines)
            out["request"][t, i] = REQUESTS.index(run.end if last else run.routines[t])
            if not last:
                out["control"][t, i] = run.controls[t]
    return out
