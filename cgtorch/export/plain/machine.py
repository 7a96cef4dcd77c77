"""State machines in the manner of SMACH and YASMIN, in plain Python.

What is added is a limit on transitions, after which a skill hands back to the one it is in.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

SUCCESS, FAILURE, TIMEOUT = "success", "failure", "timeout"

log = logging.getLogger("skill")
"""Tells every action at level DEBUG: machine, label, outcome."""


@dataclass
class Userdata:
    """What all states share.

    Attributes:
        percept: what the robot perceives now.
        message: what one action says to a later one.
        has_message: whether one has said something yet.
        memory: the common memory.
        steps: actions executed so far.
    """

    percept: list[float]
    message: list[float] = field(default_factory=list)
    has_message: bool = False
    memory: list[float] = field(default_factory=list)
    steps: int = 0


class State:
    """What a node does; `parameters` are those of the node."""

    outcomes: tuple[str, ...] = ()

    def __init__(self, parameters: Sequence[float] = ()):
        self.parameters = parameters

    def execute(self, userdata: Userdata) -> str:
        """Do it, keep what is perceived in `userdata.percept`, and return one of `outcomes`."""
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
        """Run from the start to an end; timeout after too many transitions or actions."""
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
