"""The gradient of the loss of gating networks, compiled where it can be.

Gating networks choose one member after the other. Node j takes a scenario with probability p_j =
sigmoid(SHARPNESS (o_1 - o_2)) of its two outputs, and otherwise the next node decides; the last
member takes the rest. The loss of a scenario is the negative log-probability that it reaches a
member that solves it, as in hierarchical mixtures of experts (Jordan & Jacobs, Neural Computation
6, 1994).
"""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import BranchingNN
from cgtorch.native import function, structure, threads
from cgtorch.native.library import VECTOR

SHARPNESS = 4.0
IMPOSSIBLE = 1e-6
"""The least reliability, without which a scenario that no member solves would have no logarithm."""

Gradient: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""The gradient (R, M - 1, K) for R sets of parameters of the same shape and percepts (B, D)."""


def gradient_in_torch(branch: BranchingNN, solves: Tensor, weight: Tensor) -> Gradient:
    """The gradient by automatic differentiation.

    Args:
        branch: The action of the nodes, with K parameters.
        solves: (B, M) how reliably each member solves each scenario, in [0, 1].
        weight: (B,) the weight of each scenario.
    """
    log_solves, share = solves.clamp_min(IMPOSSIBLE).log(), _shares(weight)

    def gradient(parameters: Tensor, percepts: Tensor) -> Tensor:
        with torch.enable_grad():
            leaf = parameters.detach().requires_grad_()
            reached = torch.logsumexp(_log_chosen(branch, leaf, percepts) + log_solves, -1)
            return torch.autograd.grad(-(share * reached).sum(), leaf)[0]

    return gradient


def gradient_of(branch: BranchingNN, solves: Tensor, weight: Tensor, restarts: int) -> Gradient:
    """The same gradient for so many `restarts`, in C unless nothing can be compiled.

    The tensor that a call returns is overwritten by the next call.
    """
    call, dtype = function("gating_gradients", solves.dtype), solves.dtype
    if call is None:
        return gradient_in_torch(branch, solves, weight)
    count, members = solves.shape
    width = VECTOR // dtype.itemsize
    filled, shape = -(-count // width) * width, (restarts, members - 1, branch.num_parameters)
    columns, share = torch.ones(members, filled, dtype=dtype), torch.zeros(filled, dtype=dtype)
    columns[:, :count], share[:count] = solves.clamp_min(IMPOSSIBLE).T, _shares(weight)
    x, given, made = (torch.zeros(s, dtype=dtype) for s in ((branch.inputs, filled), shape, shape))
    memory = torch.empty(*shape[:2], shape[2] + 1, width, dtype=dtype)
    gating = structure("Gating", dtype)(
        x=x, solves=columns, weight=share, parameters=given, gradient=made, memory=memory,
        sharpness=SHARPNESS, scenarios=filled, restarts=restarts, nodes=members - 1,
        inputs=branch.inputs, hidden=branch.hidden,
    )  # fmt: skip

    def gradient(parameters: Tensor, percepts: Tensor) -> Tensor:
        given.copy_(parameters)
        x[:, :count] = percepts.T
        call(gating, threads())
        return made

    return gradient


def _shares(weight: Tensor) -> Tensor:
    """Weights (B,) that add up to 1, unless they are all 0."""
    return weight / weight.sum().clamp_min(1)


def _outputs(branch: BranchingNN, parameters: Tensor, x: Tensor) -> Tensor:
    """(..., M - 1, B, 2) outputs of all branching nodes (..., M - 1, K) before the last sigmoid."""
    size, hidden = branch.hidden * branch.inputs, branch.hidden
    w1, b1, w2, b2 = parameters.tensor_split([size, size + hidden, size + 3 * hidden], -1)
    h = torch.sigmoid(x @ w1.unflatten(-1, (hidden, branch.inputs)).mT + b1[..., None, :])
    return h @ w2.unflatten(-1, (2, hidden)).mT + b2[..., None, :]


def _log_chosen(branch: BranchingNN, parameters: Tensor, x: Tensor) -> Tensor:
    """(..., B, M) log-probability that each member is selected."""
    out = (SHARPNESS * _outputs(branch, parameters, x)).log_softmax(-1)
    first, second = out.movedim(-3, -1).unbind(-2)
    passed = torch.nn.functional.pad(second.cumsum(-1), (1, 0))
    return passed + torch.nn.functional.pad(first, (0, 1))
