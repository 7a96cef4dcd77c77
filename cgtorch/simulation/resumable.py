"""Algorithm 3 with parts in Python: user-defined actions, worlds or models.

Lanes run compiled until they need something from Python, and wait. The kind of action that most
lanes wait for is then run for all of these at once, and they continue. Results equal those of the
engine in torch, which runs everything without a compiler and on other devices. Lanes have a memory
here, so networks with a memory run compiled, too.
"""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import fields
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import Action, ActionSet, Graphs
from cgtorch.ground.environment import Environment, Lanes, Rewarded
from cgtorch.ground.errors import ActionError
from cgtorch.native import WRONG_GRAPHS, function, threads
from cgtorch.native.library import REALS
from cgtorch.simulation.compiled import CompiledEngine, is_whole, program_of
from cgtorch.simulation.compiled_actions import (
    LARGEST,
    NETWORKS,
    WITH_MEMORY,
    CompiledActions,
    compiled_actions,
)
from cgtorch.simulation.model import ModelEnvironment
from cgtorch.simulation.program import check_numbers
from cgtorch.simulation.rollouts import Rollouts
from cgtorch.simulation.waiting import FIELDS, WaitingRollouts, first_lanes, laid_out

Asked: TypeAlias = Callable[[int], tuple[Lanes, Tensor]]
"""Gives the n lanes (n, ...) that wait for an action, and its parameters (n, K)."""

Answer: TypeAlias = tuple[Lanes, Tensor, str]
"""Lanes (n, ...) afterwards, outcomes (n,), and their kind among `OUTCOMES` of waiting.py."""


def resumable_rollout(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    scenarios: Tensor,
    limits: tuple[int, int, int],
    engine: CompiledEngine | None,
) -> Rollouts | None:
    """The result of `cgtorch.simulation.rollout`, or None if it has to run in torch.

    It has to without a compiler, on another device, or for other types of numbers.

    Args:
        graphs: P valid graphs.
        actions: The action set of the graphs.
        environment: Where they run.
        scenarios: (B,) long.
        limits: The maximum number of transitions of each graph, of actions of a lane, and, with
            rewards, of actions in a row that leave the state as it is.
        engine: The compiled engine of these actions and this environment, if there is one.

    Raises:
        GraphError: An action, a head or a start does not exist.
        ActionError: An action returns an outcome that it does not have.
    """
    dtype, (p, b) = graphs.parameters.dtype, (len(graphs), len(scenarios))
    if dtype not in REALS or not 0 < p * b <= LARGEST or not is_whole(scenarios):
        return None
    known = engine.known if engine else _known(actions, environment, dtype)
    program = known and program_of(graphs, known, limits[:2])
    if known is None or program is None:
        return None
    rewards = environment if isinstance(environment, Rewarded) else None
    first = first_lanes(environment, scenarios, p, known, rewards)
    if first is None:
        return None
    models, idle = engine and engine.environment, limits[2] if rewards else 0
    rollouts = laid_out(program, models, known, first, (p, b), (*limits[:2], idle))
    if function("begin_waiting", dtype)(rollouts.waiting, threads()) == WRONG_GRAPHS:
        check_numbers(graphs, len(actions))
    resume = function(f"{engine.models.name if engine else 'worlds'}_resumed", dtype)
    with torch.no_grad():
        _run(rollouts, resume, known, environment, rewards)
        return _ended(rollouts, (p, b), rewards)


def _known(
    actions: ActionSet, environment: Environment, dtype: torch.dtype
) -> CompiledActions | None:
    """The compiled actions, where the environment is in Python."""
    # Γ predicts what would be perceived.
    more = ("PERCEIVE",) if type(environment) is ModelEnvironment else ()
    kinds = (*NETWORKS, *WITH_MEMORY, *more)
    return compiled_actions(actions, environment.percept_size, dtype, kinds)


def _run(
    rollouts: WaitingRollouts,
    resume: Any,
    known: CompiledActions,
    environment: Environment,
    rewards: Rewarded | None,
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
        if rewards is not None and after.state is not given.state:
            news["over"] = _over(environment, rewards, after)
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
    request = "" if hooked else vars(type(action)).get("request", "")
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


def _over(environment: Environment, rewards: Rewarded, lanes: Lanes) -> Tensor:
    """(n,) uint8, 1 if an episode ended with success, 2 if it ended without, else 0."""
    rows = rewards.over(lanes).nonzero()[:, 0]
    over = torch.zeros(len(lanes), dtype=torch.uint8)
    if not len(rows):
        return over
    succeeded = environment.success(lanes.rows(rows))[1] > 0.5
    return over.index_copy_(0, rows, torch.where(succeeded, 1, 2).to(over))


def _ended(rollouts: WaitingRollouts, sizes: tuple[int, int], rewards: Rewarded | None) -> Rollouts:
    """The results of all lanes."""
    lanes, returns = rollouts.lanes, None
    if rewards is not None:
        gained = rewards.returns(lanes).to(lanes.percept)
        finished = rewards.over(lanes) & gained.isfinite()
        returns = torch.where(finished, gained, -torch.inf).view(sizes)
    return Rollouts(
        succeeded=rollouts.succeeded.view(sizes),
        timed_out=rollouts.timed_out.view(sizes),
        percept=lanes.percept.view(*sizes, -1),
        state=lanes.state.view(*sizes, -1),
        transitions=lanes.step.view(sizes),
        executed=int(rollouts.executed.sum()),
        returns=returns,
    )
