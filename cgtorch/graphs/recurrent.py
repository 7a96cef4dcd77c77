"""A recurrent network, whose hidden state is in the memory of a lane."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs.action import Action
from cgtorch.graphs.light import light_layer
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.numerics import sigmoid


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


class RecurrentNN(Action):
    """Maps the percept and a hidden state to a motion: an Elman network, 7-3-3.

    h' = tanh(W x + R h + b), and V h' + c is sent (Elman, "Finding structure in time", Cognitive
    Science 14, 1990). Here x is the percept, and h is the state: `hidden` numbers of the lane's
    memory, zero when a skill begins. The state belongs to the action, not to a node. All nodes of
    the action, also those in sub-skills, share the state, and each has its own weights.

    Weights and biases are scaled as in `cgtorch.graphs.light`; without this, double pole balancing
    is not learned.
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
