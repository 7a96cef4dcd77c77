"""A network that remembers, its hidden state in the memory of a lane, and one without a state."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.actions.action import Action
from cgtorch.environment import Environment, Lanes
from cgtorch.ground.numerics import sigmoid

WEIGHT, BIAS = 0.5, 0.01
"""What parameters count as weights and as biases; `native/engine/recurrent.h` as well."""


def recurrent_parameters(inputs: int, hidden: int, outputs: int) -> int:
    """Number of weights and biases of an Elman network: W with R, b, V, c; without state V, c."""
    return hidden * (inputs + hidden + 1) + outputs * ((hidden or inputs) + 1)


def recurrent_step(
    x: Tensor, state: Tensor, parameters: Tensor, outputs: int
) -> tuple[Tensor, Tensor]:
    """One step of a network per row, from x (n, inputs) and state h (n, hidden).

    Parameters are (n, recurrent_parameters(inputs, hidden, outputs)), each row W with R as one
    matrix (hidden, inputs + hidden), b, V (outputs, hidden), c, flattened in this order. Returned
    are the next state h' = tanh(W x + R h + b) (n, hidden), and V h' + c (n, outputs). Without
    a state (hidden is 0), the parameters are V (outputs, inputs) and c, and V x + c is returned.
    """
    hidden, last = state.shape[-1], state.shape[-1] or x.shape[-1]
    seen = torch.cat([x, state], -1)
    sizes = [hidden * seen.shape[-1], hidden, outputs * last, outputs]
    w, b, v, c = parameters[..., : sum(sizes)].split(sizes, dim=-1)
    after = 2 * sigmoid(2 * _layer(seen, w, b)) - 1
    return after, _layer(after if hidden else x, v, c)


def _layer(x: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """Rows of matrices (n, units * inputs) times x (n, inputs), and biases (n, units)."""
    rows = weights.unflatten(-1, (biases.shape[-1], x.shape[-1]))
    return WEIGHT * (rows * x[..., None, :]).sum(-1) + BIAS * biases


class RecurrentNN(Action):
    """From the percept, and what it remembers, to a motion: an Elman network, 7-3-3.

    h' = tanh(W x + R h + b), and V h' + c is sent (Elman, "Finding structure in time", Cognitive
    Science 14, 1990), where x is the percept and h the state: `hidden` numbers of the lane's
    memory, zero when a skill begins. They are the action's, not a node's: all nodes of the same
    action, also those in earlier skills that are nodes, go on from one state, each with weights of
    its own.

    The parameters of a node are standard normal, as for any action; as weights W, R and V they
    count half, as biases b and c a hundredth. Measured on double pole balancing, small weights and
    smaller biases are what makes it learnable: the constant input 1 of a bias is far larger than a
    percept near its goal.
    """

    first_step = 0.6  # of larger ones hidden states lose all memory but a sign
    native_kind = "RECURRENT"
    plain_module = "cgtorch.export.plain.networks"

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
        message, memory = lanes.message.clone(), lanes.memory.clone()
        seen, state = lanes.percept[:, : self.inputs], memory[:, : self.hidden]
        state, said = recurrent_step(seen, state, parameters, self.outputs)
        message[:, : self.outputs], memory[:, : self.hidden] = said, state
        has = torch.ones_like(lanes.has_message)
        lanes = replace(lanes, message=message, has_message=has, memory=memory)
        return lanes, lanes.step.new_zeros(len(lanes))


class LinearNN(RecurrentNN):
    """From the percept to a motion: V x + c, the recurrent network without a hidden layer.

    The fewest parameters that a reaction to every number of a percept can have, and so what is
    tuned in the fewest episodes where it is enough.
    """

    first_step = 2.0
    native_kind = "RECURRENT"
    plain_module = "cgtorch.export.plain.networks"

    def __init__(self, inputs: int = 7, outputs: int = 3):
        super().__init__(inputs, 0, outputs)
