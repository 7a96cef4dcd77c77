"""State machines similar to those of SMACH and YASMIN, in plain Python.

In addition, the number of transitions is limited: a skill that exceeds its limit returns to the one
that contains it.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

SUCCESS, FAILURE, TIMEOUT = "success", "failure", "timeout"

log = logging.getLogger("skill")
"""Logs every action at level DEBUG: machine, label, outcome."""


@dataclass
class Userdata:
    """The data that all states share.

    Attributes:
        percept: The present percept.
        message: The message of an earlier action.
        has_message: Whether a message has been sent yet.
        memory: The common memory.
        steps: Number of actions executed so far.
    """

    percept: list[float]
    message: list[float] = field(default_factory=list)
    has_message: bool = False
    memory: list[float] = field(default_factory=list)
    steps: int = 0


class State:
    """The action of a node, with the node's `parameters`."""

    outcomes: tuple[str, ...] = ()

    def __init__(self, parameters: Sequence[float] = ()):
        self.parameters = parameters

    def execute(self, userdata: Userdata) -> str:
        """Execute the action, store a new percept in `userdata.percept`, and return an outcome."""
        raise NotImplementedError(f"{type(self).__name__} is to be filled in")


class StateMachine(State):
    """States and where their outcomes lead: to a state by its label, or to an end."""

    outcomes = (SUCCESS, FAILURE, TIMEOUT)

    def __init__(self, name: str, start: str, max_transitions: int, max_steps: int):
        super().__init__()
        self.name, self.start = name, start
        self.max_transitions, self.max_steps = max_transitions, max_steps
        self.states: dict[str, State] = {}
        self.transitions: dict[str, Mapping[str, str]] = {}

    def add(self, label: str, state: State, transitions: Mapping[str, str]) -> None:
        """Add a state and where each of its outcomes leads."""
        self.states[label], self.transitions[label] = state, transitions

    def execute(self, userdata: Userdata) -> str:
        """Run from the start to an end, or to a timeout after too many transitions or actions."""
        label = self.start
        for _ in range(self.max_transitions):
            if userdata.steps >= self.max_steps:
                break
            state = self.states[label]
            outcome = state.execute(userdata)
            if isinstance(state, StateMachine):
                outcome = SUCCESS if outcome == SUCCESS else FAILURE
            else:
                userdata.steps += 1
                log.debug("%s: %s -> %s", self.name, label, outcome)
            if outcome not in self.transitions[label]:
                raise ValueError(f"{label} returned {outcome!r}; return one of {state.outcomes}")
            label = self.transitions[label][outcome]
            if label in self.outcomes:
                return label
        return TIMEOUT
