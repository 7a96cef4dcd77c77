"""Algorithm 3 where Python has a part in it: actions, worlds or models of others.

Lanes run compiled until they come to something that is Python's, and wait. What most lanes wait for
is then done for all of these at once, and they go on. It says what the engine in torch says, which
runs everything where there is no compiler, and on other devices.
"""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, fields, replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import Action, ActionSet, Grasp, MoveBase
from cgtorch.environment import Environment, Lanes, Rewarded, start_lanes
from cgtorch.graphs import Graphs
from cgtorch.ground.errors import ActionError
from cgtorch.native import WRONG_GRAPHS, constants, function, structure, threads
from cgtorch.native.library import REALS
from cgtorch.simulation.action_table import FAILURE, SUCCESS, ActionTable
from cgtorch.simulation.compiled import CompiledEngine, is_whole, program_of
from cgtorch.simulation.compiled_actions import (
    LARGEST,
    NETWORKS,
    CompiledActions,
    compiled_actions,
)
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts

FIELDS = (
    ("percept", "new_percept"), ("state", "new_state"), ("message", "new_message"),
    ("has_message", "new_has"), ("memory", "new_memory"),
)  # fmt: skip
"""What an action may change of lanes, and where a `Waiting` of waiting.h has it."""
PLACE = 8
"""Numbers that a `Place` of waiting.h has room for."""
OUTCOMES = ("outcome", "done", "chance")

Answer: TypeAlias = tuple[Lanes, Tensor, str]
"""Lanes (n, ...) afterwards, outcomes (n,), and which of `OUTCOMES` these are."""


@dataclass(frozen=True)
class _Rollouts:
    """Rollouts of L lanes that are under way.

    Attributes:
        lanes: all of them, in memory that compiled code writes to.
        asked: the same room once more, for those that wait for an action.
        parameters: by primitive, room (L, K) for what the action gets, None where it gets nothing.
        waiting: a `Waiting` of waiting.h.
        status: (L,) int8, how they have ended.
        executed: (S,) long, actions that were executed, which only sum up to something.
    """

    lanes: Lanes
    asked: Lanes
    parameters: tuple[Tensor | None, ...]
    waiting: Any
    status: Tensor
    executed: Tensor


def resumable_rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenarios: Tensor,
    limits: tuple[int, int, int],
    engine: CompiledEngine | None,
) -> Rollouts | None:
    """What `cgtorch.simulation.rollout` says, or None where it has to be said in torch.

    That is without a compiler, on another device, or for numbers of other types. ActionError if an
    action returns an outcome that no action has.

    Args:
        graphs: P valid ones; GraphError if an action, a head or a start does not exist.
        actions: what their action indices mean.
        environment: where they run.
        scenarios: (B,) long.
        limits: the most transitions of each graph, the most actions of a lane, and in environments
            with rewards the most in a row that leave the state as it is.
        engine: the compiled engine of these actions and this environment, where there is one.
    """
    dtype, (p, b) = graphs.parameters.dtype, (len(graphs), len(scenarios))
    if dtype not in REALS or not 0 < p * b <= LARGEST or not is_whole(scenarios):
        return None
    known = engine.known if engine else _known(actions, environment, dtype)
    program = known and program_of(graphs, known, limits[:2])
    if known is None or program is None:
        return None
    first = _first_lanes(environment, scenarios, p, known)
    if first is None:
        return None
    rewarded, models = isinstance(environment, Rewarded), engine and engine.environment
    limits = (*limits[:2], limits[2] * rewarded)
    rollouts = _laid_out(program, models, known, first, (p, b), limits)
    if function("begin_waiting", dtype)(rollouts.waiting, threads()) == WRONG_GRAPHS:
        check_numbers(graphs, len(actions))
    resume = function(f"{engine.models.name if engine else 'worlds'}_resumed", dtype)
    with torch.no_grad():
        _run(rollouts, resume, known, environment)
        return _ended(rollouts, (p, b), environment)


def _known(
    actions: ActionSet, environment: Environment, dtype: torch.dtype
) -> CompiledActions | None:
    """The actions where Python has the environment."""
    # Γ predicts what would be perceived.
    kinds = (*NETWORKS, "DETECT") if type(environment) is ModelEnvironment else NETWORKS
    return compiled_actions(actions, environment.percept_size, dtype, kinds)


def _first_lanes(
    environment: Environment, scenarios: Tensor, count: int, known: CompiledActions
) -> Lanes | None:
    """Fresh lanes on scenarios (B,) so many times, or None where compiled code cannot run them.

    Of learned models, which give every graph the same, once is enough.
    """
    scenario = scenarios if type(environment) is ModelEnvironment else scenarios.repeat(count)
    lanes = start_lanes(environment, scenario, 0, 0)
    over = isinstance(environment, Rewarded) and bool(environment.over(lanes).any())
    on_cpu = lanes.percept.is_cpu and lanes.state.is_cpu
    return None if over or lanes.percept.dtype != known.dtype or not on_cpu else lanes


def _room(first: Lanes, total: int, table: ActionTable) -> Lanes:
    """Room for so many lanes like those, without messages and with an empty memory."""
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
) -> _Rollouts:
    """Rollouts that are to be begun; `limits` are those of `Waiting`."""
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
    status, executed = torch.zeros(total, dtype=torch.int8), torch.zeros(shares, dtype=torch.long)
    caller, outer, outer_first = torch.empty(3, total * (depth > 1), depth, dtype=torch.int32)
    waiting = structure("Waiting", known.dtype)(
        program=program, environment=environment, memory=known.memory,
        deterministic=known.deterministic, graphs=sizes[0], count=sizes[1], max_transitions=limits[0], max_steps=limits[1],
        most_idle=limits[2], percept=lanes.percept, message=lanes.message, common=lanes.memory,
        state=lanes.state, has_message=lanes.has_message, step=lanes.step,
        percept_size=like.shape[1], message_size=lanes.message.shape[1],
        memory_size=lanes.memory.shape[1],
        state_bytes=lanes.state.shape[1] * lanes.state.element_size(),
        state_is_real=int(lanes.state.dtype == known.dtype),
        kinds=torch.empty(nodes, dtype=torch.int32),
        ways=torch.empty(nodes * table.outcomes * 2, dtype=torch.int32),
        places=torch.empty(total * PLACE, dtype=torch.int32), caller=caller, outer=outer,
        outer_first=outer_first, queue=torch.empty(count * total, dtype=torch.int32),
        waiting=torch.zeros(shares * count, dtype=torch.long), status=status, executed=executed,
        kind=-1, asked=0, everyone=0, silent=0, offset=torch.empty(shares, dtype=torch.long),
        first_percept=first.percept, first_state=first.state, first_scenario=first.scenario,
        firsts=len(first),
        asked_scenario=asked.scenario, asked_step=asked.step, asked_percept=asked.percept,
        asked_message=asked.message, asked_memory=asked.memory, asked_state=asked.state,
        asked_has=asked.has_message, parameters=places[0], held=places[1],
        **dict.fromkeys([name for _, name in FIELDS]), **dict.fromkeys(OUTCOMES), over=None,
        wrong=0, wrong_outcome=0,
    )  # fmt: skip
    waiting.kept.extend(held)
    return _Rollouts(lanes, asked, tuple(parameters), waiting, status, executed)


def _run(
    rollouts: _Rollouts, resume: Any, known: CompiledActions, environment: Environment
) -> None:
    """Run all lanes to their ends."""
    table, waiting, count = known.table, rollouts.waiting, threads()
    asked = [_asked(rollouts, part, i) for i, part in enumerate(table.memory)]
    rewards = environment if isinstance(environment, Rewarded) else None
    told: AbstractSet[str] = set()
    resume(waiting, count)
    while (kind := waiting.kind) >= 0:
        given, parameters = asked[kind](waiting.asked)
        action = table.primitives[kind]
        after, outcome, what = _done(action, given, parameters, environment, waiting)
        news = {
            name: _like(value, before)
            for field, name in FIELDS
            if (value := getattr(after, field)) is not (before := getattr(given, field))
        }
        news[what] = (outcome.long() if what == "outcome" else outcome).contiguous()
        if rewards is not None and after.state is not given.state:
            news["over"] = _over(environment, rewards, after)
        for name in told - news.keys():
            setattr(waiting, name, None)
        for name, value in news.items():
            setattr(waiting, name, value.data_ptr())
        told = news.keys()
        resume(waiting, count)
        if waiting.wrong_outcome:
            raise ActionError(
                f"action {type(action).__name__} returned outcome {waiting.wrong_outcome - 1}; "
                f"return 0 to {len(action.outcomes) - 1}"
            )


def _asked(rollouts: _Rollouts, part: slice, kind: int) -> Callable[[int], tuple[Lanes, Tensor]]:
    """What gives the lanes that wait for a primitive, and its parameters, if n of them do."""
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
    """Do what n lanes wait for; routines ask the environment themselves, which costs less."""
    kind = None if action._forward_hooks or action._forward_pre_hooks else type(action)
    if kind is MoveBase and not waiting.silent:
        control = lanes.message[:, : environment.control_size]
        return *environment.step(lanes, control), "done"
    if kind is Grasp:
        return *environment.success(lanes), "chance"
    return *action(lanes, parameters, environment), "outcome"


def _like(value: Tensor, before: Tensor) -> Tensor:
    """A contiguous tensor of the shape and type of another."""
    if value.dtype == before.dtype and value.shape == before.shape and value.is_contiguous():
        return value
    return value.new_empty(before.shape, dtype=before.dtype).copy_(value)


def _over(environment: Environment, rewards: Rewarded, lanes: Lanes) -> Tensor:
    """(n,) uint8, 1 where an episode is over with success, 2 without, else 0."""
    rows = rewards.over(lanes).nonzero()[:, 0]
    over = torch.zeros(len(lanes), dtype=torch.uint8)
    if not len(rows):
        return over
    succeeded = environment.success(lanes.rows(rows))[1] > 0.5
    return over.index_copy_(0, rows, torch.where(succeeded, 1, 2).to(over))


def _ended(rollouts: _Rollouts, sizes: tuple[int, int], environment: Environment) -> Rollouts:
    """What the lanes have come to."""
    lanes, status = rollouts.lanes, rollouts.status.view(sizes)
    returns = None
    if isinstance(environment, Rewarded):
        gained = environment.returns(lanes).to(lanes.percept)
        finished = environment.over(lanes) & gained.isfinite()
        returns = torch.where(finished, gained, -torch.inf).view(sizes)
    succeeded = status == SUCCESS
    return Rollouts(
        succeeded=succeeded,
        timed_out=~succeeded & (status != FAILURE),
        percept=lanes.percept.view(*sizes, -1),
        state=lanes.state.view(*sizes, -1),
        transitions=lanes.step.view(sizes),
        executed=int(rollouts.executed.sum()),
        returns=returns,
    )
