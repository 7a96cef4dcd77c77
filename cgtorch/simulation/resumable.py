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
from cgtorch.simulation.action_table import FAILURE, SUCCESS
from cgtorch.simulation.compiled import compiled_models, is_whole, program_of
from cgtorch.simulation.compiled_actions import (
    LARGEST,
    NETWORKS,
    ROUTINES,
    CompiledActions,
    compiled_actions,
)
from cgtorch.simulation.model import CompiledModels, ModelEnvironment
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts

FIELDS = (
    ("percept", "new_percept"), ("state", "new_state"), ("message", "new_message"),
    ("has_message", "new_has"), ("memory", "new_memory"),
)  # fmt: skip
"""What an action may change of lanes, and where a `Waiting` of waiting.h has it."""
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
        status: (L,) long, how they have ended.
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
    max_transitions: int,
    max_steps: int,
    most_idle: int,
) -> Rollouts | None:
    """What `cgtorch.simulation.rollout` says, or None where it has to be said in torch.

    That is without a compiler, on another device, or for numbers of other types. ActionError if an
    action returns an outcome that no action has.
    """
    dtype, (p, b) = graphs.parameters.dtype, (len(graphs), len(scenarios))
    if dtype not in REALS or not 0 < p * b <= LARGEST or not is_whole(scenarios):
        return None
    models, given = compiled_models(environment) or (None, None)
    size = environment.percept_size
    known = compiled_actions(actions, size, dtype, _kinds(environment, models))
    program = known and program_of(graphs, known, (max_transitions, max_steps))
    if known is None or program is None:
        return None
    lanes = _started(environment, scenarios.repeat(p), known)
    if lanes is None:
        return None
    limits = (max_transitions, max_steps, most_idle * isinstance(environment, Rewarded))
    rollouts = _laid_out(program, given, known, lanes, (p, b), limits)
    if function("begin_waiting", dtype)(rollouts.waiting, threads()) == WRONG_GRAPHS:
        check_numbers(graphs, len(actions))
    resume = function(f"{models.name if models else 'worlds'}_resumed", dtype)
    with torch.no_grad():
        _run(rollouts, resume, known, environment)
        return _ended(rollouts, (p, b), environment)


def _kinds(environment: Environment, models: CompiledModels | None) -> tuple[str, ...]:
    """Kinds of actions that need no Python in an environment."""
    if models is not None:
        return (*NETWORKS, *ROUTINES, *models.networks)
    # Γ predicts what would be perceived.
    same = type(environment) is ModelEnvironment
    return (*NETWORKS, "DETECT") if same else NETWORKS


def _started(environment: Environment, scenario: Tensor, known: CompiledActions) -> Lanes | None:
    """Fresh lanes on scenarios (L,) in memory of their own, or None where compiled code cannot."""
    table = known.table
    lanes = start_lanes(environment, scenario, table.message_size, table.memory_size)
    tensors = {f.name: getattr(lanes, f.name) for f in fields(Lanes)}
    over = isinstance(environment, Rewarded) and bool(environment.over(lanes).any())
    if over or lanes.percept.dtype != known.dtype or not all(t.is_cpu for t in tensors.values()):
        return None
    return Lanes(**{name: value.contiguous().clone() for name, value in tensors.items()})


def _laid_out(
    program: Any,
    environment: Any,
    known: CompiledActions,
    lanes: Lanes,
    sizes: tuple[int, int],
    limits: tuple[int, int, int],
) -> _Rollouts:
    """Room for rollouts of lanes that have just started; `limits` are those of `Waiting`."""
    table, total, like = known.table, len(lanes), lanes.percept
    count, depth = len(table.primitives), table.depth
    nodes = program.nodes * sizes[0] + program.rows
    shares = -(-total // constants("waiting_limits", known.dtype)["SHARE"])
    parts = torch.tensor([[p.start, p.stop - p.start] for p in table.memory])
    widest = int(parts[:, 1].max()) if count else 0
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
    status, executed = torch.zeros(total, dtype=torch.long), torch.zeros(shares, dtype=torch.long)
    numbers, levels = torch.empty(6, total, dtype=torch.int32), (3, total, depth)
    node, first, left, level, idle, waits = numbers.zero_()
    caller, outer, outer_first = torch.empty(levels, dtype=torch.int32)
    waiting = structure("Waiting", known.dtype)(
        program=program, environment=environment, memory=parts,
        deterministic=torch.tensor([int(a.deterministic) for a in table.primitives]),
        graphs=sizes[0], count=sizes[1], max_transitions=limits[0], max_steps=limits[1],
        most_idle=limits[2], percept=lanes.percept, message=lanes.message, common=lanes.memory,
        state=lanes.state, has_message=lanes.has_message, scenario=lanes.scenario, step=lanes.step,
        percept_size=like.shape[1], message_size=lanes.message.shape[1],
        memory_size=lanes.memory.shape[1],
        state_bytes=lanes.state.shape[1] * lanes.state.element_size(),
        state_is_real=int(lanes.state.dtype == known.dtype),
        kinds=torch.empty(nodes, dtype=torch.int32),
        heads=torch.empty(nodes * table.outcomes, dtype=torch.int32),
        node=node, first=first, left=left, level=level, idle=idle, caller=caller, outer=outer,
        outer_first=outer_first, visited=torch.zeros(total, dtype=torch.long), waits=waits,
        queue=torch.empty(count * total, dtype=torch.int32),
        waiting=torch.zeros(shares * count, dtype=torch.long), status=status, executed=executed,
        kind=-1, asked=0, everyone=0, silent=0, rows=torch.empty(total, dtype=torch.long),
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
