"""One skill for one robot: what to do next, request by request."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NoReturn, cast

import torch
from torch import Tensor

from cgtorch.graphs import Action, Skill, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, DataError
from cgtorch.simulation.action_table import action_table
from cgtorch.simulation.rollout import most_steps

SUCCESS, FAILURE, TIMEOUT = "success", "failure", "timeout"


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
        return self.kind in (SUCCESS, FAILURE, TIMEOUT)


@dataclass
class _Frame:
    """A skill that is running: the node where it is, and the transitions it has left."""

    skill: Skill
    nodes: list[int]
    edges: list[list[int]]
    node: int
    left: int


class Stepper:
    """Tells one robot what to do next, for as long as a skill runs.

    It behaves like `rollout` on one scenario: sub-skills with their own limits, messages and the
    common memory. `act` begins the skill with its first call, and again after its end:

        request = stepper.act(percept)
        while not request.ended:
            done, percept = robot(request)  # by request.kind
            request = stepper.act(percept, done)
    """

    def __init__(self, skill: Skill, seed: int = 0):
        """Prepare a skill; `seed` is that of the numbers that stochastic actions draw."""
        self.skill = skill
        self._table = action_table(skill.actions)
        self._most = most_steps(skill.actions, skill.max_transitions)
        self._place = cast(Environment, _Nowhere(skill, seed))
        self._frames: list[_Frame] = []
        self._steps = 0
        self._mind: Lanes | None = None

    def act(self, percept: Sequence[float] | Tensor, done: bool = True) -> Request:
        """The next request at a percept (D,), after the last one succeeded or failed.

        DataError for a percept that is not a row of numbers, ActionError if an action asks its
        environment for more than a robot has.
        """
        seen = torch.as_tensor(percept, dtype=torch.float32)
        if seen.dim() != 1:
            raise DataError(f"percept has shape {tuple(seen.shape)}; give one row of numbers")
        if self._frames and self._mind is not None:
            self._mind = replace(self._mind, percept=seen[None])
            self._follow(0 if done else 1)
        else:
            self._begin(seen[None])
        with torch.no_grad():
            return self._next()

    def _begin(self, percept: Tensor) -> None:
        nothing, zero = percept[:, :0], torch.zeros(1, dtype=torch.long)
        message = percept.new_zeros(1, self._table.message_size)
        memory = percept.new_zeros(1, self._table.memory_size)
        self._mind = Lanes(percept, nothing, message, zero.bool(), memory, zero, zero)
        self._frames, self._steps, self._end = [], 0, ""
        self._enter(self.skill)

    def _enter(self, skill: Skill) -> None:
        """Open a skill, and the one at its start if that is a skill."""
        graph = skill.graph
        nodes, edges = graph.action[0].tolist(), graph.edges[0].tolist()
        start = int(graph.start[0])
        self._frames.append(_Frame(skill, nodes, edges, start, skill.max_transitions))
        if isinstance(action := self._here(), SubSkill):
            self._enter(action.skill)

    def _here(self) -> Action:
        frame = self._frames[-1]
        return frame.skill.actions.actions[frame.nodes[frame.node]]

    def _next(self) -> Request:
        """Think until the robot is needed or the skill has ended."""
        while self._frames:
            action, mind = self._here(), self._mind
            asks = vars(type(action)).get("request", "")
            if mind is None or not asks:
                self._follow(self._thought(action))
                continue
            size = getattr(action, "control_size", 0)
            control = mind.message[0, :size]
            if asks == "control" and not (mind.has_message[0] and control.isfinite().all()):
                self._follow(1)
                continue
            frame = self._frames[-1]
            name = frame.skill.actions.names[frame.nodes[frame.node]]
            return Request(asks, name, tuple(control.tolist()) if asks == "control" else ())
        return Request(self._end)

    def _thought(self, action: Action) -> int:
        """The outcome of an action that only computes, after it has."""
        assert self._mind is not None  # noqa: S101  it has begun
        frame, mind = self._frames[-1], self._mind
        part = self._table.memory[self._table.numbers[id(action)]]
        values = frame.skill.graph.parameters[0, frame.node, : action.num_parameters]
        step = torch.tensor([self._steps])
        given = replace(mind, memory=mind.memory[:, part], step=step)
        after, outcome = action(given, values[None], self._place)
        memory = mind.memory.clone()
        memory[:, part] = after.memory
        self._mind = replace(
            mind, message=after.message, has_message=after.has_message, memory=memory
        )
        return int(outcome[0])

    def _follow(self, outcome: int) -> None:
        """Go along the edge of an outcome, out of skills that end and into those that begin."""
        self._steps += 1
        while self._frames:
            frame = self._frames[-1]
            frame.left -= 1
            actions, index = frame.skill.actions, frame.nodes[frame.node]
            head = frame.edges[frame.node][outcome]
            ended = bool(actions.terminal[index, outcome])
            end = SUCCESS if ended and bool(actions.succeeds[index, outcome]) else FAILURE
            if not ended and frame.left > 0:
                frame.node = head
                if isinstance(action := self._here(), SubSkill):
                    self._enter(action.skill)
                break
            self._end = end if ended else TIMEOUT
            self._frames.pop()
            outcome = 0 if self._end == SUCCESS else 1  # of the skill that contains it
        if self._frames and self._steps >= self._most:
            self._frames, self._end = [], TIMEOUT


class _Nowhere:
    """The environment of a skill without a world, which has sizes and a seed only."""

    def __init__(self, skill: Skill, seed: int):
        every = action_table(skill.actions).primitives
        sizes = (getattr(each, "percept_size", 0) for each in every)
        self.num_scenarios, self.percept_size = 1, max(sizes, default=0)
        self.control_size = skill.actions.message_size
        self.seeds = torch.tensor([seed])

    def __getattr__(self, name: str) -> NoReturn:
        raise ActionError(f"an action asks its environment for {name!r}, which a stepper lacks")
