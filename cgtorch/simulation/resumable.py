"""Algorithm 3 with parts in Python: user-defined actions, worlds or models.

Lanes run compiled until they need something from Python, and wait. The kind of action that most
lanes wait for is then run for all of these at once, and they continue. Results equal those of the
engine in torch. Lanes have a memory here, so networks with a memory run compiled, too.
"""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, fields, replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Graphs
from cgtorch.graphs.action import own
from cgtorch.ground.environment import Environment, Episodic, Lanes, Rewarded, start_lanes
from cgtorch.ground.errors import ActionError
from cgtorch.native import WRONG_GRAPHS, constants, function, structure, threads
from cgtorch.native.library import REALS
from cgtorch.simulation.compiled import (
    LARGEST,
    NETWORKS,
    WITH_MEMORY,
    CompiledActions,
    CompiledEngine,
    compiled_actions,
    is_whole,
    program_of,
)
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import ActionTable, check_numbers
from cgtorch.simulation.torch_engine import Rollouts, finished_returns

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
    """

    lanes: Lanes
    asked: Lanes
    parameters: tuple[Tensor | None, ...]
    waiting: Any
    succeeded: Tensor  # (L,) bool
    timed_out: Tensor  # (L,) bool
    executed: Tensor  # (S,) long, whose sum is the number of executed actions


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


def _laid_out(
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


Asked: TypeAlias = Callable[[int], tuple[Lanes, Tensor]]
"""Gives the n lanes (n, ...) that wait for an action, and its parameters (n, K)."""

Answer: TypeAlias = tuple[Lanes, Tensor, str]
"""Lanes (n, ...) afterwards, outcomes (n,), and their kind among `OUTCOMES`."""


def resumable_rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenarios: Tensor,
    limits: tuple[int, int, int],
    engine: CompiledEngine | None,
) -> Rollouts | None:
    """The result of `rollout` on scenarios (B,), or None if it has to run in torch.

    It has to without a compiler, on another device, or for other types of numbers. ActionError if
    an action returns an outcome that it does not have.

    Args:
        graphs: P graphs.
        actions: The action set of the graphs.
        environment: Where they run.
        scenarios: (B,) long.
        limits: The maximum number of transitions of each graph, of actions of a lane, and, with
            episodes, of actions in a row that leave the state as it is.
        engine: The compiled engine of these actions and this environment, if there is one.
    """
    dtype, (p, b) = graphs.parameters.dtype, (len(graphs), len(scenarios))
    if dtype not in REALS or not 0 < p * b <= LARGEST or not is_whole(scenarios):
        return None
    # Γ predicts percepts, and gives every graph the same first lanes.
    in_models = type(environment) is ModelEnvironment
    kinds = (*NETWORKS, *WITH_MEMORY, *(("PERCEIVE",) if in_models else ()))
    size = environment.percept_size
    known = engine.known if engine else compiled_actions(actions, size, dtype, kinds)
    program = known and program_of(graphs, known, limits[:2])
    if known is None or program is None:
        return None
    episodes = environment if isinstance(environment, Episodic) else None
    rewards = environment if isinstance(environment, Rewarded) else None
    first = start_lanes(environment, scenarios if in_models else scenarios.repeat(p), 0, 0)
    if first.percept.dtype != dtype or not (first.percept.is_cpu and first.state.is_cpu):
        return None
    if episodes is not None and episodes.over(first).any():
        return None
    models, idle = engine and engine.environment, limits[2] if episodes else 0
    rollouts = _laid_out(program, models, known, first, (p, b), (*limits[:2], idle))
    if function("begin_waiting", dtype)(rollouts.waiting, threads()) == WRONG_GRAPHS:
        check_numbers(graphs, len(actions))
    resume = function(f"{engine.models.name if engine else 'worlds'}_resumed", dtype)
    with torch.no_grad():
        _run(rollouts, resume, known, environment, episodes)
        return _ended(rollouts, (p, b), rewards)


def _run(
    rollouts: WaitingRollouts,
    resume: Any,
    known: CompiledActions,
    environment: Environment,
    episodes: Episodic | None,
) -> None:
    """Run all lanes to their ends."""
    table, waiting, count = known.table, rollouts.waiting, threads()
    asked = [_asked(rollouts, part, i) for i, part in enumerate(table.memory)]
    sent: AbstractSet[str] = set()
    resume(waiting, count)
    while (kind := waiting.kind) >= 0:
        given, parameters = asked[kind](waiting.asked)
        action = table.primitives[kind]
        after, outcome, what = _done(action, given, parameters, environment, waiting)
        news = {} if after is given else _news(given, after)
        news[what] = (outcome.long() if what == "outcome" else outcome).contiguous()
        if episodes is not None and after.state is not given.state:
            news["over"] = _over(environment, episodes, after)
        for name in sent - news.keys():
            setattr(waiting, name, None)
        for name, value in news.items():
            setattr(waiting, name, value.data_ptr())
        sent = news.keys()
        resume(waiting, count)
        if waiting.num_wrong:
            raise ActionError(
                f"action {type(action).__name__} returned outcome {waiting.wrong_outcome}; "
                f"return 0 to {len(action.outcomes) - 1}"
            )


def _asked(rollouts: WaitingRollouts, part: slice, kind: int) -> Asked:
    """A function that gives the lanes waiting for a primitive with this part of the memory."""
    everyone, size = rollouts.lanes.with_memory(part), part.stop - part.start
    room, parameters = rollouts.asked, rollouts.parameters[kind]
    numbers = everyone.percept.new_empty(len(everyone), 0) if parameters is None else parameters
    last = everyone, numbers

    def given(n: int) -> tuple[Lanes, Tensor]:
        nonlocal last
        if n == len(everyone):
            return everyone, numbers
        if len(last[0]) != n:
            rows = {f.name: getattr(room, f.name)[:n] for f in fields(Lanes)}
            rows["memory"] = room.memory[: n * size].view(n, size)
            last = Lanes(**rows), numbers[:n]
        return last

    return given


def _done(
    action: Action, lanes: Lanes, parameters: Tensor, environment: Environment, waiting: Any
) -> Answer:
    """Run an action for n lanes; routines call the environment directly, which is faster."""
    hooked = action._forward_hooks or action._forward_pre_hooks
    request = "" if hooked else own(action, "request")
    if request == "control" and not waiting.silent:
        control = lanes.message[:, : environment.control_size]
        return *environment.step(lanes, control), "done"
    if request == "test":
        return *environment.success(lanes), "chance"
    return *action(lanes, parameters, environment), "outcome"


def _news(before: Lanes, after: Lanes) -> dict[str, Tensor]:
    """The fields of a `Waiting` that an action has changed in lanes."""
    return {
        name: _like(value, old)
        for field, name in FIELDS
        if (value := getattr(after, field)) is not (old := getattr(before, field))
    }


def _like(value: Tensor, before: Tensor) -> Tensor:
    """A contiguous tensor of the shape and type of another."""
    if value.dtype == before.dtype and value.shape == before.shape and value.is_contiguous():
        return value
    return value.new_empty(before.shape, dtype=before.dtype).copy_(value)


def _over(environment: Environment, episodes: Episodic, lanes: Lanes) -> Tensor:
    """(n,) uint8, 1 if an episode ended with success, 2 if it ended without, else 0."""
    rows = episodes.over(lanes).nonzero()[:, 0]
    over = torch.zeros(len(lanes), dtype=torch.uint8)
    if not len(rows):
        return over
    succeeded = environment.success(lanes.rows(rows))[1] > 0.5
    return over.index_copy_(0, rows, torch.where(succeeded, 1, 2).to(over))


def _ended(rollouts: WaitingRollouts, sizes: tuple[int, int], rewards: Rewarded | None) -> Rollouts:
    """The results of all lanes."""
    lanes, returns = rollouts.lanes, None
    if rewards is not None:
        returns = finished_returns(rewards, lanes).view(sizes)
    return Rollouts(
        succeeded=rollouts.succeeded.view(sizes),
        timed_out=rollouts.timed_out.view(sizes),
        percept=lanes.percept.view(*sizes, -1),
        state=lanes.state.view(*sizes, -1),
        transitions=lanes.step.view(sizes),
        executed=int(rollouts.executed.sum()),
        returns=returns,
    )
