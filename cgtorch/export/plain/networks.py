"""The networks of `cgtorch.graphs`, one percept at a time, in plain Python."""

import math
from collections.abc import Sequence

from cgtorch.export.plain.machine import SUCCESS, State, Userdata


class Network(State):
    """One hidden layer; the parameters are W1, b1, W2, b2, row by row."""

    def __init__(self, parameters: Sequence[float], inputs: int, hidden: int, outputs: int):
        super().__init__(parameters)
        self.inputs, self.hidden, self.outputs = inputs, hidden, outputs

    def sees(self, percept: list[float]) -> list[float]:
        """The part of the percept that the network reads."""
        return percept[: self.inputs]

    def output(self, percept: list[float]) -> list[float]:
        """Sigmoid hidden layer, linear output."""
        first = self.hidden * (self.inputs + 1)
        hidden = layer(self.parameters[:first], self.sees(percept))
        return layer(self.parameters[first:], [sigmoid(x) for x in hidden])


class ContinuousNN(Network):
    """Maps the percept to a motion, which is sent as a message."""

    outcomes = (SUCCESS,)

    def motion(self, percept: list[float]) -> list[float]:
        """The motion."""
        return self.output(percept)

    def execute(self, userdata: Userdata) -> str:
        """Send the motion."""
        userdata.message[: self.outputs] = self.motion(userdata.percept)
        userdata.has_message = True
        return SUCCESS


class BranchingNN(Network):
    """Maps the percept to one of two branches: the larger output decides."""

    outcomes = ("out1", "out2")

    def execute(self, userdata: Userdata) -> str:
        """Select a branch."""
        one, two = map(sigmoid, self.output(userdata.percept))
        return self.outcomes[two > one]


class RecurrentNN(State):
    """Maps the percept and its part of the memory to a motion, which is sent as a message.

    The parameters are W with R, b, V, c, row by row.
    """

    outcomes = (SUCCESS,)

    def __init__(
        self,
        parameters: Sequence[float],
        inputs: int,
        hidden: int,
        outputs: int,
        memory: range = range(0),
    ):
        super().__init__(parameters)
        self.inputs, self.outputs, self.memory = inputs, outputs, memory[:hidden]
        self.first = hidden * (inputs + hidden + 1)

    def execute(self, userdata: Userdata) -> str:
        """Update the memory and send the motion."""
        seen = userdata.percept[: self.inputs] + [userdata.memory[i] for i in self.memory]
        state = [math.tanh(x) for x in light_layer(self.parameters[: self.first], seen)]
        for i, x in zip(self.memory, state, strict=True):
            userdata.memory[i] = x
        userdata.message[: self.outputs] = light_layer(self.parameters[self.first :], state)
        userdata.has_message = True
        return SUCCESS


class DelayNN(State):
    """Maps the percept and its latest changes to a motion, which is sent as a message.

    The parameters are V row by row, then c. Its part of the memory contains earlier percepts.
    """

    outcomes = (SUCCESS,)

    def __init__(
        self,
        parameters: Sequence[float],
        inputs: int,
        delays: int,
        outputs: int,
        memory: range = range(0),
    ):
        super().__init__(parameters)
        self.inputs, self.outputs, self.memory = inputs, outputs, memory[: inputs * delays]

    def execute(self, userdata: Userdata) -> str:
        """Send the motion and store the percept."""
        n = self.inputs
        window = userdata.percept[:n] + [userdata.memory[i] for i in self.memory]
        changes = [10 * (x - y) for x, y in zip(window, window[n:], strict=False)]
        userdata.message[: self.outputs] = light_layer(self.parameters, window[:n] + changes)
        userdata.has_message = True
        for i, x in zip(self.memory, window, strict=False):
            userdata.memory[i] = x
        return SUCCESS


class LinearNN(DelayNN):
    """Maps the percept to a motion, which is sent; the parameters are V row by row, then c."""


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
