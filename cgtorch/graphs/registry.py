"""Finding actions by name, and checking their interface."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from importlib.metadata import EntryPoint, entry_points

import torch
from torch import Generator, Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.action_set import ActionSet
from cgtorch.graphs.networks import BranchingNN, ContinuousNN, DelayNN, LinearNN, RecurrentNN
from cgtorch.graphs.routines import Step
from cgtorch.ground.dry_run import (
    ROWS,
    copied,
    expect,
    expect_lanes,
    expect_pair,
    reason,
    returned,
    two_rows,
)
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import ActionError

ENTRY_POINTS = "cgtorch.actions"
VISITS = 3
"""Times that an action is tried on the same lanes, as its memory may be used from the second on."""
MOST_DELAYED = 4096
"""The most parameters of the network that reads changes: every node has room for the largest."""
BUILT_IN: Mapping[str, Callable[[int, int], Action]] = {
    "LinearNN": LinearNN,
    "DelayNN": lambda percept, control: DelayNN(percept, outputs=control),
    "RecurrentNN": lambda percept, control: RecurrentNN(percept, outputs=control),
}
"""Actions for any domain by name; each is made from the lengths of its percepts and controls."""


def reward_actions(percept: int, control: int, hidden: int = 8) -> ActionSet:
    """The actions of domains with rewards, for percepts and controls of these lengths.

    Four networks send a control: a linear one, one with a hidden layer, one that reads the latest
    changes, and a recurrent one. A step carries the control out, and a network branches. Where
    there would be more than `MOST_DELAYED` parameters, none reads changes.

    Args:
        percept: Number of values of a percept.
        control: Number of values of a control.
        hidden: Number of units in the hidden layer of `Aim`.
    """
    delayed = DelayNN(percept, outputs=control)
    changes = {"Delay": delayed} if delayed.num_parameters <= MOST_DELAYED else {}
    actions = {
        "Linear": LinearNN(percept, control),
        "Aim": ContinuousNN(percept, hidden, control),
        **changes,
        "Recur": RecurrentNN(percept, outputs=control),
        "Step": Step(control),
        "Branch": BranchingNN(percept),
    }
    return ActionSet(tuple(actions), tuple(actions.values()))


def resolve_actions(names: Sequence[str], basic: ActionSet, sizes: tuple[int, int]) -> ActionSet:
    """The `basic` actions, such as those of a domain, followed by those named.

    A name is that of a built-in action, which is made for percepts and controls of these `sizes`;
    that of an entry point of the group "cgtorch.actions"; or "package.module:Class". An action that
    is named twice, or is already basic, is added once. ActionError if a name is unknown or cannot
    be made into an action.
    """
    actions = basic
    declared = {e.name: e for e in entry_points(group=ENTRY_POINTS)}
    for spec in dict.fromkeys(names):
        if spec in actions.names:
            continue
        if spec in BUILT_IN:
            actions = actions.extended([spec], [BUILT_IN[spec](*sizes)])
            continue
        if ":" not in spec and spec not in declared:
            known = ", ".join(sorted({*actions.names, *BUILT_IN, *declared}))
            raise ActionError(
                f"unknown action {spec!r}; known are {known}, or give 'package.module:Class'"
            )
        name = spec.rpartition(":")[2].rpartition(".")[2]
        entry = declared.get(spec) or EntryPoint(name, spec, ENTRY_POINTS)
        actions = actions.extended([entry.name], [_made(spec, entry)])
    return actions


def _made(spec: str, entry: EntryPoint) -> Action:
    try:
        found = entry.load()
    except Exception as e:  # whatever a foreign module raises when it is imported
        raise ActionError(
            f"cannot import action {spec!r} ({reason(e)}); is it spelt right and its package "
            "installed or on PYTHONPATH?"
        ) from e
    if not (isinstance(found, type) and issubclass(found, Action)):
        raise ActionError(f"action {spec!r} is {found!r:.80}; give a subclass of Action")
    try:
        return found()
    except Exception as e:
        raise ActionError(
            f"action {spec!r} cannot be made as {found.__name__}() ({reason(e)}); give it a "
            "constructor that needs no arguments and implement forward"
        ) from e


def check_action(
    name: str, action: Action, environment: Environment, device: torch.device | str = "cpu"
) -> None:
    """Try an action on two fresh lanes, and again on what becomes of them; ActionError says why."""
    parameters = _parameters(name, action)
    scenario = two_rows(environment.num_scenarios, device)
    lanes = start_lanes(environment, scenario, action.message_size, action.memory_size)
    parameters = parameters.to(lanes.percept)
    for _ in range(VISITS):
        lanes, outcome = _visited(name, action, lanes, parameters, environment)
        if any(action.outcomes[i] in action.terminal for i in outcome.tolist()):
            break  # a skill that has ended visits no further node
        lanes = replace(lanes, step=lanes.step + 1)


def _visited(
    name: str, action: Action, lanes: Lanes, parameters: Tensor, environment: Environment
) -> tuple[Lanes, Tensor]:
    who, kept = f"action {name!r}: forward", copied(lanes)
    result = returned(ActionError, who, action, lanes, parameters, environment)
    after, outcome = expect_pair(ActionError, who, "lanes, outcomes", result)
    expect_lanes(ActionError, who, lanes, kept, after)
    expect(ActionError, who, "outcomes", outcome, (ROWS,), torch.long)
    if not ((outcome >= 0) & (outcome < len(action.outcomes))).all():
        raise ActionError(
            f"{who} returned outcomes {outcome.tolist()}; they index {action.outcomes}, so give 0 "
            f"to {len(action.outcomes) - 1}"
        )
    turned = torch.tensor([1, 0], device=outcome.device)
    given = lanes.rows(turned), parameters[turned], environment
    _expect_same(
        who, (after.rows(turned), outcome[turned]), returned(ActionError, who, action, *given)
    )
    return after, outcome


def _expect_same(who: str, once: tuple[Lanes, Tensor], again: tuple[Lanes, Tensor]) -> None:
    """ActionError unless both results are equal, since rows must not influence one another."""
    pairs = [(getattr(once[0], f.name), getattr(again[0], f.name)) for f in fields(Lanes)]
    for first, second in [*pairs, (once[1], again[1])]:
        if not torch.equal(first.nan_to_num(), second.nan_to_num()):
            raise ActionError(
                f"{who} did something else with the same two lanes in another order; treat each "
                "lane by itself, and draw random numbers with self.uniform(lanes, environment, "
                "size)"
            )


def _parameters(name: str, action: Action) -> Tensor:
    who = f"action {name!r}: initial_parameters"
    for attribute in ("num_parameters", "message_size", "memory_size"):
        value = getattr(action, attribute)
        if not isinstance(value, int) or value < 0:
            raise ActionError(f"action {name!r}: {attribute} is {value!r}; give a whole number")
    given = ROWS, Generator().manual_seed(0)
    values: Tensor = returned(ActionError, who, action.initial_parameters, *given)
    expect(ActionError, who, "values", values, (ROWS, action.num_parameters), torch.float32)
    if not values.isfinite().all():
        raise ActionError(f"{who} returned numbers that are not finite")
    return values
