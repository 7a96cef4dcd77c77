"""The networks of section VI and others; a node's parameters are the network's weights."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.numerics import sigmoid

WEIGHT, BIAS, CHANGE = 0.5, 0.01, 10.0
"""The factors of weights, biases and changes; `native/engine/networks.h` has the same."""


def network_parameters(inputs: int, hidden: int, outputs: int) -> int:
    """Number of weights of a network with one hidden layer: W1, b1, W2, b2."""
    return hidden * (inputs + 1) + outputs * (hidden + 1)


def one_hidden_layer(x: Tensor, weights: Tensor, hidden: int, outputs: int) -> Tensor:
    """One network per row of x (n, inputs): sigmoid hidden layer, linear output (n, outputs).

    `weights` is (n, network_parameters(inputs, hidden, outputs)). Each row contains W1 (hidden,
    inputs), b1, W2 (outputs, hidden), b2, flattened in this order.
    """
    inputs = x.shape[-1]
    w1, b1, w2, b2 = weights.split([hidden * inputs, hidden, outputs * hidden, outputs], dim=-1)
    # Networks this small are bound by memory traffic: a product and a sum beat a batched matmul.
    h = sigmoid((w1.unflatten(-1, (hidden, inputs)) * x[..., None, :]).sum(-1) + b1)
    return (w2.unflatten(-1, (outputs, hidden)) * h[..., None, :]).sum(-1) + b2


def light_layer(x: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """A linear layer with scaled parameters, whose outputs are (n, units).

    It multiplies the matrices `weights` (n, units * inputs), times 0.5, by x (n, inputs) and adds
    `biases` (n, units) times 0.01, as the constant input 1 of a bias is far larger than a percept
    near its goal.
    """
    rows = weights.unflatten(-1, (biases.shape[-1], x.shape[-1]))
    return WEIGHT * (rows * x[..., None, :]).sum(-1) + BIAS * biases


def percept_and_changes(x: Tensor, earlier: Tensor) -> Tensor:
    """The inputs of a `DelayNN`, (n, (d + 1) * D): percepts, then ten times the latest changes.

    `x` (n, D) are percepts, and `earlier` (n, d * D) are the d percepts before them, the latest
    first. The changes have the same order.
    """
    window = torch.cat([x, earlier], -1).unflatten(-1, (-1, x.shape[-1]))
    changes = CHANGE * (window[..., :-1, :] - window[..., 1:, :])
    return torch.cat([x, changes.flatten(-2)], -1)


def recurrent_parameters(inputs: int, hidden: int, outputs: int) -> int:
    """Number of parameters of an Elman network: W with R, b, V, c."""
    return hidden * (inputs + hidden + 1) + outputs * (hidden + 1)


def recurrent_step(
    x: Tensor, state: Tensor, parameters: Tensor, outputs: int
) -> tuple[Tensor, Tensor]:
    """One step of a network per row, from x (n, inputs) and state h (n, hidden).

    `parameters` is (n, recurrent_parameters(inputs, hidden, outputs)). Each row contains W with R
    as one matrix (hidden, inputs + hidden), b, V (outputs, hidden), c, flattened in this order.
    Returned are the next state h' = tanh(W x + R h + b) (n, hidden), and V h' + c (n, outputs).
    """
    hidden = state.shape[-1]
    seen = torch.cat([x, state], -1)
    sizes = [hidden * seen.shape[-1], hidden, outputs * hidden, outputs]
    w, b, v, c = parameters[..., : sum(sizes)].split(sizes, dim=-1)
    after = 2 * sigmoid(2 * light_layer(seen, w, b)) - 1
    return after, light_layer(after, v, c)


def _sent(lanes: Lanes, said: Tensor) -> tuple[Lanes, Tensor]:
    """The lanes with a message that begins with `said` (n, outputs), and outcome 0."""
    message = lanes.message.clone()
    message[:, : said.shape[1]] = said
    has = torch.ones_like(lanes.has_message)
    return replace(lanes, message=message, has_message=has), lanes.step.new_zeros(len(lanes))


class _Network(Action):
    """A network with one hidden layer whose weights are the node's parameters."""

    first_step = 4.0  # strong actions are found soon; docs/decisions/search.md has the others

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.inputs, self.hidden, self.outputs = inputs, hidden, outputs
        self.percept_size = inputs
        self.num_parameters = network_parameters(inputs, hidden, outputs)

    def sees(self, percept: Tensor) -> Tensor:
        """The numbers (n, inputs) of percepts (n, D) that the network reads."""
        return percept[:, : self.inputs]

    def network(self, lanes: Lanes, parameters: Tensor) -> Tensor:
        """(n, outputs), before any output activation."""
        seen = self.sees(lanes.percept)
        return one_hidden_layer(seen, parameters, self.hidden, self.outputs)


class ContinuousNN(_Network):
    """Maps the percept to a motion: 7-3-3, sigmoid hidden layer, linear output, sent as message."""

    native_kind = "CONTINUOUS"
    plain_module = "cgtorch.export.plain"

    def __init__(self, inputs: int = 7, hidden: int = 3, outputs: int = 3):
        super().__init__(inputs, hidden, outputs)
        self.message_size = outputs

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return _sent(lanes, self.network(lanes, parameters))


class BranchingNN(_Network):
    """Maps the percept to one of two branches: 7-3-2, all sigmoid; the larger output decides."""

    outcomes: tuple[str, ...] = ("out1", "out2")
    native_kind = "BRANCHING"
    plain_module = "cgtorch.export.plain"

    def __init__(self, inputs: int = 7, hidden: int = 3):
        super().__init__(inputs, hidden, outputs=2)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        out = sigmoid(self.network(lanes, parameters))
        return lanes, (out[:, 1] > out[:, 0]).long()


class DelayNN(Action):
    """A linear network of the percept and its latest changes, whose output is sent as a message.

    It sends V s + c. The vector s is the percept x(t) followed by ten times the changes x(t) -
    x(t-1), x(t-1) - x(t-2), and so on: a tapped delay line (Waibel et al., "Phoneme recognition
    using time-delay neural networks", IEEE Trans. ASSP 37, 1989) of backward differences. The
    factor gives all inputs a similar size; without it, double pole balancing is not learned.

    The parameters of a node are V (outputs, (delays + 1) * inputs) row by row, then c. The earlier
    percepts are in the lane's memory, zero when a skill begins. All nodes of the action share them,
    and time counts its executions.

    Attributes:
        delays: Number of changes d; the memory has d * inputs numbers.
    """

    first_step = 2.0
    native_kind = "DELAY"
    plain_module = "cgtorch.export.plain"

    def __init__(self, inputs: int = 7, delays: int = 3, outputs: int = 3):
        super().__init__()
        self.inputs, self.delays, self.outputs = inputs, delays, outputs
        self.percept_size = inputs
        self.num_parameters = outputs * (inputs * (delays + 1) + 1)
        self.message_size, self.memory_size = outputs, inputs * delays

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        memory, size = lanes.memory.clone(), self.memory_size
        x, earlier = lanes.percept[:, : self.inputs], memory[:, :size].clone()
        weights, biases = parameters[:, : self.num_parameters].split(
            [self.num_parameters - self.outputs, self.outputs], -1
        )
        said = light_layer(percept_and_changes(x, earlier), weights, biases)
        memory[:, :size] = torch.cat([x, earlier], -1)[:, :size]
        return _sent(replace(lanes, memory=memory), said)


class LinearNN(DelayNN):
    """A linear network of the percept, V x + c, whose output is sent as a message.

    It has few parameters, so it is tuned in few episodes if it is sufficient.
    """

    native_kind = "DELAY"
    plain_module = "cgtorch.export.plain"

    def __init__(self, inputs: int = 7, outputs: int = 3):
        super().__init__(inputs, 0, outputs)


class RecurrentNN(Action):
    """Maps the percept and a hidden state to a motion: an Elman network, 7-3-3.

    h' = tanh(W x + R h + b), and V h' + c is sent (Elman, "Finding structure in time", Cognitive
    Science 14, 1990), with weights and biases scaled as in `light_layer`. Here x is the percept,
    and h is the state: `hidden` numbers of the lane's memory, zero when a skill begins. All nodes
    of the action, also those in sub-skills, share the state, and each has its own weights.
    """

    first_step = 0.6  # of larger ones hidden states lose all memory but a sign
    native_kind = "RECURRENT"
    plain_module = "cgtorch.export.plain"

    def __init__(self, inputs: int = 7, hidden: int = 3, outputs: int = 3):
        super().__init__()
        self.inputs, self.hidden, self.outputs = inputs, hidden, outputs
        self.percept_size = inputs
        self.num_parameters = recurrent_parameters(inputs, hidden, outputs)
        self.message_size, self.memory_size = outputs, hidden

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        memory = lanes.memory.clone()
        seen, state = lanes.percept[:, : self.inputs], memory[:, : self.hidden]
        memory[:, : self.hidden], said = recurrent_step(seen, state, parameters, self.outputs)
        return _sent(replace(lanes, memory=memory), said)
