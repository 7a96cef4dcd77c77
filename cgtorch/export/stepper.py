"""One skill for one robot: what to do next, request by request."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from math import isfinite
from typing import Any, cast

import torch
from torch import Tensor

from cgtorch.export.plain import Perceive, State, StateMachine, Step, Test, Userdata
from cgtorch.export.state_machine import leads_of, memory_places, plain_arguments
from cgtorch.export.step import Nowhere, control_size_of
from cgtorch.graphs import Action, Skill
from cgtorch.graphs.action import own
from cgtorch.graphs.clusters import Node, clusters_of
from cgtorch.graphs.skill import a_skill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.ground.given import given_seed, shown, truth, whole_number
from cgtorch.simulation import most_steps

MOST_STEPS = 2**63 - 1
NO_ROW = str, bytes, bytearray, dict, set, frozenset
"""Kinds of objects over which one can go, but not as over a row of numbers."""
ROUTINES = {"control": Step, "perceive": Perceive, "test": Test}


@dataclass(frozen=True)
class Request:
    """The next request to a robot, or how the skill has ended.

    Attributes:
        kind: "control", "perceive" or "test"; or "success", "failure" or "timeout" at the end.
        action: The name of the action that asks; "" at the end.
        control: The control to carry out, for "control".
    """

    kind: str
    action: str = ""
    control: tuple[float, ...] = ()

    @property
    def ended(self) -> bool:
        """Whether the skill has ended."""
        return self.kind in StateMachine.outcomes


class Stepper:
    """Tells one robot what to do next, for as long as a skill runs.

    It behaves like `rollout` on one scenario, up to rounding: sub-skills with their own limits,
    messages and the common memory. It runs the state machine that `to_state_machine` writes, and
    calls actions of your own with one row. `act` begins the skill with its first call, and again
    after its end:

        request = stepper.act(percept)
        while not request.ended:
            done, percept = robot(request)  # by request.kind
            request = stepper.act(percept, done)
    """

    def __init__(self, skill: Skill, seed: int = 0, max_steps: int | None = None):
        """Prepare a skill.

        `seed` is that of the numbers that stochastic actions draw, and `max_steps` are the actions
        on all levels after which the skill times out, by default `most_steps`. SettingsError for
        what is no skill or no whole number.
        """
        actions = [action for _, action in a_skill(skill).primitives]
        self.skill, self._seed = skill, given_seed(seed)
        self._places, self._memory_size = memory_places(actions)
        sizes = {size for a in actions if (size := getattr(a, "percept_size", 0))}
        self._percept_size, self._alike = max(sizes, default=0), len(sizes) == 1
        self._requests: dict[State, Request] = {}
        most = most_steps(skill.actions, skill.max_transitions)
        if max_steps is not None:
            most = whole_number(max_steps, "max_steps", 0, MOST_STEPS)
        self._machine = self._built(most)
        self._message_size = skill.actions.message_size
        self._walk: Generator[State, str, str] | None = None
        self._asked: State | None = None

    def act(self, percept: Sequence[float] | Tensor, done: bool = True) -> Request:
        """The next request at a percept (D,), after the last one succeeded or failed.

        DataError for a percept that is not a row of D finite numbers, as its networks read them,
        SettingsError for a `done` that is neither true nor false, ActionError if an action asks its
        environment for more than a robot has.
        """
        seen, done = self._row(percept), truth(done, "done")
        try:
            if self._walk is None or self._asked is None:
                nothing = [0.0] * self._message_size, False, [0.0] * self._memory_size
                self._userdata = Userdata(seen, *nothing)
                self._walk = self._machine.walk(self._userdata)
                state = next(self._walk)
            else:
                self._userdata.percept = seen
                state = self._walk.send(self._asked.outcomes[0 if done else -1])
            while not state.asks(self._userdata):
                impossible = state in self._requests  # a control that is none
                outcome = state.outcomes[-1] if impossible else state.execute(self._userdata)
                state = self._walk.send(outcome)
        except StopIteration as end:
            self._walk = None
            return Request(str(end.value))
        except BaseException:
            self._walk = None
            raise
        self._asked = state
        request = self._requests[state]
        if isinstance(state, Step):
            request = replace(request, control=tuple(state.control(self._userdata)))
        return request

    def __getstate__(self) -> dict[str, Any]:
        """What a copy has; SettingsError within an episode, whose course cannot be copied."""
        if self._walk is not None:
            raise SettingsError(
                "this Stepper is within an episode, which cannot be copied or pickled; do so "
                "before its first act or after the end, or make another of its skill"
            )
        return vars(self)

    def _row(self, percept: Sequence[float] | Tensor) -> list[float]:
        values: Any = percept
        try:
            if isinstance(values, NO_ROW):
                raise TypeError("its elements are no numbers in an order")
            values = values.tolist() if isinstance(values, Tensor) else values
            seen = [float(x) for x in values]
        except (TypeError, ValueError, OverflowError, RuntimeError) as e:
            raise DataError(f"percept is {shown(percept, 80)}; give one row of numbers") from e
        size, needed = len(seen), self._percept_size
        if size < needed or (self._alike and size > needed) or not all(map(isfinite, seen)):
            wanted = f"{needed}" if self._alike else f"{needed} or more"
            raise DataError(
                f"percept is {seen!r:.200}, {size} numbers; give {wanted} finite numbers"
            )
        return seen

    def _built(self, max_steps: int) -> StateMachine:
        """The outermost skill's machine."""
        clusters = clusters_of(self.skill)
        machines = {
            c.key: StateMachine(c.name, c.nodes[c.start].label, c.skill.max_transitions, max_steps)
            for c in clusters
        }
        for cluster in clusters:
            for node in cluster.nodes.values():
                state = machines[node.runs] if node.runs else self._state(node)
                machines[cluster.key].add(node.label, state, leads_of(cluster, node))
        return machines[clusters[0].key]

    def _state(self, node: Node) -> State:
        """The state of a node that is no skill."""
        action, memory = node.action, self._places[id(node.action)]
        if asks := own(action, "request"):
            state = ROUTINES[asks](node.parameters)
            state.outcomes = action.outcomes
            if isinstance(state, Step):
                state.control_size = getattr(action, "control_size", 0)
            self._requests[state] = Request(asks, node.name)
            return state
        if not (module := own(action, "plain_module")):
            who, size = f"action {type(action).__name__}", control_size_of(self.skill)
            nowhere = Nowhere(who, self._percept_size, size, self._seed)
            return _Own(action, node.parameters, memory, nowhere, self.skill.graph.parameters.dtype)
        kind = getattr(import_module(module), type(action).__name__)
        made: State = kind(node.parameters, **plain_arguments(action, memory))
        return made


class _Own(State):
    """An action in torch, for one row of numbers of a type."""

    def __init__(
        self,
        action: Action,
        parameters: Sequence[float],
        memory: range,
        nowhere: Nowhere,
        dtype: torch.dtype,
    ):
        super().__init__(parameters)
        self.action, self.memory = action, slice(memory.start, memory.stop)
        self.dtype, self.nowhere = dtype, cast(Environment, nowhere)

    def row(self, numbers: Sequence[float]) -> Tensor:
        """The numbers as a batch of one."""
        return torch.tensor([numbers], dtype=self.dtype)

    def execute(self, userdata: Userdata) -> str:
        """See `Action.forward`."""
        percept, message = self.row(userdata.percept), self.row(userdata.message)
        memory, zero = self.row(userdata.memory[self.memory]), torch.zeros(1, dtype=torch.long)
        has, step = torch.tensor([userdata.has_message]), torch.tensor([userdata.steps])
        lanes = Lanes(percept, percept[:, :0], message, has, memory, zero, step)
        with torch.no_grad():
            after, outcome = self.action(lanes, self.row(self.parameters), self.nowhere)
        userdata.message, userdata.has_message = after.message[0].tolist(), bool(after.has_message)
        userdata.memory[self.memory] = after.memory[0].tolist()
        return self.action.outcomes[int(outcome)]
