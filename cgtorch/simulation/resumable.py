"""Algorithm 3 where Python has a part in it: actions, worlds or models of others.

Lanes run compiled until they come to something that is Python's, and wait. What most lanes wait for
is then done for all of these at once, and they go on. It says what the engine in torch says, which
runs everything where there is no compiler, and on other devices. Lanes have a memory here, so that
networks with one run here compiled, too.
"""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import fields
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import Action, ActionSet, Grasp, MoveBase
from cgtorch.environment import Environment, Lanes, Rewarded
from cgtorch.graphs import Graphs
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
"""Gives the lanes (n, ...) that wait for an action, and its parameters (n, K), if n of them do."""

Answer: TypeAlias = tuple[Lanes, Tensor, str]
"""Lanes (n, ...) afterwards, outcomes (n,), and which of `OUTCOMES` of waiting.py these are."""


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
    """The actions where Python has the environment."""
    # Γ predicts what would be perceived.
    more = ("DETECT",) if type(environment) is ModelEnvironment else ()
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
    """What gives the lanes that wait for a primitive that has this part of the memory."""
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


def _news(before: Lanes, after: Lanes) -> dict[str, Tensor]:
    """What an action has changed of lanes, by fields of a `Waiting`."""
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
    """(n,) uint8, 1 where an episode is over with success, 2 without, else 0."""
    rows = rewards.over(lanes).nonzero()[:, 0]
    over = torch.zeros(len(lanes), dtype=torch.uint8)
    if not len(rows):
        return over
    succeeded = environment.success(lanes.rows(rows))[1] > 0.5
    return over.index_copy_(0, rows, torch.where(succeeded, 1, 2).to(over))


def _ended(rollouts: WaitingRollouts, sizes: tuple[int, int], rewards: Rewarded | None) -> Rollouts:
    """What the lanes have come to."""
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
