"""Skills as state machines in plain Python, which exported files contain and `Stepper` runs."""

import logging
import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field

SUCCESS, FAILURE, TIMEOUT = "success", "failure", "timeout"

log = logging.getLogger("skill")
"""Logs every action at level DEBUG: machine, label, outcome."""


@dataclass
class Userdata:
    """The data that all states share."""

    percept: list[float]  # the present one
    message: list[float] = field(default_factory=list)  # of an earlier action
    has_message: bool = False  # whether a message has been sent yet
    memory: list[float] = field(default_factory=list)  # of all actions
    steps: int = 0  # actions executed so far


class State:
    """The action of a node, with the node's `parameters`."""

    outcomes: tuple[str, ...] = ()

    def __init__(self, parameters: Sequence[float] = ()):
        self.parameters = parameters

    def asks(self, userdata: Userdata) -> bool:
        """Whether it now needs a robot."""
        return False

    def execute(self, userdata: Userdata) -> str:
        """Execute the action, store a new percept in `userdata.percept`, and return an outcome."""
        raise NotImplementedError(f"{type(self).__name__} is to be filled in")


class StateMachine(State):
    """States and where their outcomes lead: to a state by its label, or to an end.

    It is similar to those of SMACH and YASMIN. In addition, the number of transitions is limited: a
    skill that exceeds its limit returns to the one that contains it.
    """

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

    def walk(self, userdata: Userdata) -> Generator[State, str, str]:
        """Yield each state to execute, which is answered with its outcome; return the end."""
        label = self.start
        for _ in range(self.max_transitions):
            if userdata.steps >= self.max_steps:
                break
            state = self.states[label]
            if isinstance(state, StateMachine):
                outcome = SUCCESS if (yield from state.walk(userdata)) == SUCCESS else FAILURE
            else:
                outcome = yield state
                userdata.steps += 1
                log.debug("%s: %s -> %s", self.name, label, outcome)
            if outcome not in self.transitions[label]:
                raise ValueError(f"{label} returned {outcome!r}; return one of {state.outcomes}")
            label = self.transitions[label][outcome]
            if label in self.outcomes:
                return label
        return TIMEOUT

    def execute(self, userdata: Userdata) -> str:
        """Run from the start to an end, or to a timeout after too many transitions or actions."""
        walk = self.walk(userdata)
        try:
            state = next(walk)
            while True:
                state = walk.send(state.execute(userdata))
        except StopIteration as end:
            return str(end.value)


class Routine(State):
    """An action of the robot."""

    def asks(self, userdata: Userdata) -> bool:
        """Whether it now needs a robot."""
        return True


class Step(Routine):
    """Carries out the message as a control."""

    outcomes = (SUCCESS, FAILURE)
    control_size = 1

    def asks(self, userdata: Userdata) -> bool:
        """Whether there is a message that is a control; without one the action fails."""
        return userdata.has_message and all(map(math.isfinite, self.control(userdata)))

    def control(self, userdata: Userdata) -> list[float]:
        """The message as a control."""
        return userdata.message[: self.control_size]

    def execute(self, userdata: Userdata) -> str:
        """Fail without a message that is a control; else call `step`."""
        done = self.asks(userdata) and self.step(userdata, *self.control(userdata))
        return SUCCESS if done else FAILURE

    def step(self, userdata: Userdata, *control: float) -> bool:
        """Carry the control out, then store the new percept in `userdata.percept`.

        Return False, without acting, if it cannot be carried out.
        """
        raise NotImplementedError("Step.step is to be filled in")


class Perceive(Routine):
    """Perceives again without acting."""

    outcomes = (SUCCESS,)

    def execute(self, userdata: Userdata) -> str:
        """Store the new percept."""
        userdata.percept = list(self.perceive(userdata))
        return SUCCESS

    def perceive(self, userdata: Userdata) -> list[float]:
        """The new percept."""
        raise NotImplementedError("Perceive.perceive is to be filled in")


class Test(Routine):
    """Tests success."""

    __test__ = False  # for pytest, which takes names like this one for tests

    outcomes = (SUCCESS, FAILURE)

    def execute(self, userdata: Userdata) -> str:
        """Test success."""
        return SUCCESS if self.test(userdata) else FAILURE

    def test(self, userdata: Userdata) -> bool:
        """Whether the task has succeeded."""
        raise NotImplementedError("Test.test is to be filled in")


class Network(State):
    """A network of `parameters`: matrices row by row, each followed by its biases."""

    outcomes: tuple[str, ...] = (SUCCESS,)

    def __init__(
        self,
        parameters: Sequence[float],
        inputs: int,
        hidden: int = 0,
        outputs: int = 0,
        delays: int = 0,
        memory: range = range(0),
    ):
        super().__init__(parameters)
        self.inputs, self.hidden, self.outputs = inputs, hidden, outputs
        self.memory = memory[: hidden or inputs * delays]

    def sees(self, percept: list[float]) -> list[float]:
        """The part of the percept that the network reads."""
        return percept[: self.inputs]

    def output(self, percept: list[float]) -> list[float]:
        """Sigmoid hidden layer, linear output."""
        first = self.hidden * (self.inputs + 1)
        hidden = layer(self.parameters[:first], self.sees(percept))
        return layer(self.parameters[first:], [sigmoid(x) for x in hidden])

    def send(self, userdata: Userdata, message: list[float]) -> str:
        """Send a message."""
        userdata.message[: self.outputs] = message
        userdata.has_message = True
        return SUCCESS

    def remember(self, userdata: Userdata, numbers: Sequence[float]) -> None:
        """Store the first numbers in the network's part of the memory."""
        for i, x in zip(self.memory, numbers, strict=False):
            userdata.memory[i] = x


class ContinuousNN(Network):
    """Maps the percept to a motion, which is sent as a message."""

    def motion(self, percept: list[float]) -> list[float]:
        """The motion."""
        return self.output(percept)

    def execute(self, userdata: Userdata) -> str:
        """Send the motion."""
        return self.send(userdata, self.motion(userdata.percept))


class BranchingNN(Network):
    """Maps the percept to one of two branches: the larger output decides."""

    outcomes = ("out1", "out2")

    def execute(self, userdata: Userdata) -> str:
        """Select a branch."""
        one, two = map(sigmoid, self.output(userdata.percept))
        return self.outcomes[two > one]


class RecurrentNN(Network):
    """Maps the percept and its part of the memory to a motion, which is sent as a message."""

    def execute(self, userdata: Userdata) -> str:
        """Update the memory and send the motion."""
        seen = self.sees(userdata.percept) + [userdata.memory[i] for i in self.memory]
        first = self.hidden * (len(seen) + 1)
        state = [math.tanh(x) for x in light_layer(self.parameters[:first], seen)]
        self.remember(userdata, state)
        return self.send(userdata, light_layer(self.parameters[first:], state))


class DelayNN(Network):
    """Maps the percept and its latest changes to a motion, which is sent as a message.

    Its part of the memory contains earlier percepts.
    """

    def execute(self, userdata: Userdata) -> str:
        """Send the motion and store the percept."""
        window = self.sees(userdata.percept) + [userdata.memory[i] for i in self.memory]
        n = self.inputs
        changes = [10 * (x - y) for x, y in zip(window, window[n:], strict=False)]
        self.remember(userdata, window)
        return self.send(userdata, light_layer(self.parameters, window[:n] + changes))


class LinearNN(DelayNN):
    """Maps the percept to a motion, which is sent."""


def sigmoid(x: float) -> float:
    """The logistic function."""
    return 1 / (1 + math.exp(min(-x, 80)))


def light_layer(parameters: Sequence[float], inputs: list[float]) -> list[float]:
    """A linear layer with parameters multiplied by 0.5 for weights and 0.01 for biases."""
    weights = len(parameters) // (len(inputs) + 1) * len(inputs)
    light = [x * (0.5 if i < weights else 0.01) for i, x in enumerate(parameters)]
    return layer(light, inputs)


def layer(weights: Sequence[float], inputs: Sequence[float]) -> list[float]:
    """W x + b, with the rows of W and then b in `weights`."""
    n = len(inputs)
    units = len(weights) // (n + 1)
    rows = [weights[i * n : (i + 1) * n] for i in range(units)]
    biases = weights[units * n :]
    return [
        bias + sum(w * x for w, x in zip(row, inputs, strict=True))
        for row, bias in zip(rows, biases, strict=True)
    ]
