"""Memory of rollouts that wait for Python, in the layout of compiled code."""

from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.environment import Environment, Lanes, Rewarded, start_lanes
from cgtorch.native import constants, structure
from cgtorch.simulation.action_table import ActionTable
from cgtorch.simulation.compiled_actions import CompiledActions
from cgtorch.simulation.model import ModelEnvironment

FIELDS = (
    ("percept", "new_percept"), ("state", "new_state"), ("message", "new_message"),
    ("has_message", "new_has"), ("memory", "new_memory"),
)  # fmt: skip
"""The fields of lanes that an action may change, and their names in `Waiting` of waiting.h."""
OUTCOMES = ("outcome", "done", "chance")
PLACE = 8
"""The number of 32-bit integers that a `Place` of waiting.h has room for."""


@dataclass(frozen=True)
class WaitingRollouts:
    """Rollouts of L lanes in progress.

    Attributes:
        lanes: All lanes, in memory that compiled code writes to.
        asked: Equal room for the lanes that wait for an action.
        parameters: For each primitive, room (L, K) for its parameters, or None if it has none.
        waiting: A `Waiting` of waiting.h.
        succeeded: (L,) bool.
        timed_out: (L,) bool.
        executed: (S,) long, whose sum is the number of executed actions.
    """

    lanes: Lanes
    asked: Lanes
    parameters: tuple[Tensor | None, ...]
    waiting: Any
    succeeded: Tensor
    timed_out: Tensor
    executed: Tensor


def first_lanes(
    environment: Environment,
    scenarios: Tensor,
    count: int,
    known: CompiledActions,
    rewards: Rewarded | None,
) -> Lanes | None:
    """`count` copies of fresh lanes on scenarios (B,), or None if compiled code cannot run them.

    Learned models give every graph the same lanes, so one copy is enough for them.
    """
    scenario = scenarios if type(environment) is ModelEnvironment else scenarios.repeat(count)
    lanes = start_lanes(environment, scenario, 0, 0)
    over = rewards is not None and bool(rewards.over(lanes).any())
    on_cpu = lanes.percept.is_cpu and lanes.state.is_cpu
    return None if over or lanes.percept.dtype != known.dtype or not on_cpu else lanes


def _room(first: Lanes, total: int, table: ActionTable) -> Lanes:
    """Uninitialised lanes like the given ones, without messages and with an empty memory."""
    percept = first.percept.new_empty(total, first.percept.shape[1])
    return Lanes(
        percept=percept,
        state=first.state.new_empty(total, first.state.shape[1]),
        message=percept.new_zeros(total, table.message_size),
        has_message=torch.zeros(total, dtype=torch.bool),
        memory=percept.new_zeros(total, table.memory_size),
        scenario=first.scenario.repeat(total // len(first)),
        step=torch.empty(total, dtype=torch.long),
    )


def laid_out(
    program: Any,
    environment: Any,
    known: CompiledActions,
    first: Lanes,
    sizes: tuple[int, int],
    limits: tuple[int, int, int],
) -> WaitingRollouts:
    """Rollouts that are ready to start; `limits` are those of `Waiting`."""
    table, total, like = known.table, sizes[0] * sizes[1], first.percept
    lanes = _room(first, total, table)
    count, depth = len(table.primitives), table.depth
    nodes = program.nodes * sizes[0] + program.rows
    shares = -(-total // constants("waiting_limits", known.dtype)["SHARE"])
    widest = max(part.stop - part.start for part in table.memory)
    asked = Lanes(**{f.name: torch.empty_like(getattr(lanes, f.name)) for f in fields(Lanes)})
    asked = replace(asked, memory=like.new_empty(total * widest))
    parameters, held = [], []
    for action, python in zip(table.primitives, known.in_python, strict=True):
        wanted = python and action.num_parameters > 0
        parameters.append(like.new_empty(total, action.num_parameters) if wanted else None)
        held.append(torch.full((total,), -1, dtype=torch.int32) if wanted else None)
    places = [
        torch.tensor([0 if x is None else x.data_ptr() for x in each], dtype=torch.long)
        for each in (parameters, held)
    ]
    succeeded, timed_out = torch.zeros(2, total, dtype=torch.bool)
    executed = torch.zeros(shares, dtype=torch.long)
    caller, outer, outer_first = torch.empty(3, total * (depth > 1), depth, dtype=torch.int32)
    waiting = structure("Waiting", known.dtype)(
        program=program, environment=environment, memory=known.memory,
        deterministic=known.deterministic, graphs=sizes[0], count=sizes[1],
        max_transitions=limits[0], max_steps=limits[1], most_idle=limits[2],
        percept=lanes.percept, message=lanes.message, common=lanes.memory,
        state=lanes.state, has_message=lanes.has_message, step=lanes.step,
        percept_size=like.shape[1], message_size=lanes.message.shape[1],
        memory_size=lanes.memory.shape[1],
        state_bytes=lanes.state.shape[1] * lanes.state.element_size(),
        state_is_real=int(lanes.state.dtype == known.dtype),
        kinds=torch.empty(nodes, dtype=torch.int32),
        successors=torch.empty(nodes * table.outcomes * 2, dtype=torch.int32),
        places=torch.empty(total * PLACE, dtype=torch.int32), caller=caller, outer=outer,
        outer_first=outer_first, queue=torch.empty(count * total, dtype=torch.int32),
        waiting=torch.zeros(shares * count, dtype=torch.long), executed=executed,
        succeeded=succeeded, timed_out=timed_out,
        kind=-1, asked=0, everyone=0, silent=0, offset=torch.empty(shares, dtype=torch.long),
        first_percept=first.percept, first_state=first.state, first_scenario=first.scenario,
        firsts=len(first),
        asked_scenario=asked.scenario, asked_step=asked.step, asked_percept=asked.percept,
        asked_message=asked.message, asked_memory=asked.memory, asked_state=asked.state,
        asked_has=asked.has_message, parameters=places[0], held=places[1],
        **dict.fromkeys([name for _, name in FIELDS]), **dict.fromkeys(OUTCOMES), over=None,
        wrong=0, num_wrong=0, wrong_outcome=0,
    )  # fmt: skip
    waiting.kept.extend(held)
    return WaitingRollouts(lanes, asked, tuple(parameters), waiting, succeeded, timed_out, executed)
