"""Gating: branching nodes, trained by gradient, send each scenario to a member that solves it.

Node j takes a scenario for its member with probability sigmoid(SHARPNESS (o_1 - o_2)) of its two
outputs, else the next node decides; the last member takes the rest. The loss is the negative
log-probability that a scenario reaches a member that solves it, as in hierarchical mixtures of
experts (Jordan & Jacobs, Neural Computation 6, 1994).
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.graphs import BranchingNN
from cgtorch.graphs.networks import one_hidden_layer
from cgtorch.ground.numerics import sigmoid
from cgtorch.native import function, structure, threads
from cgtorch.native.library import VECTOR

RESTARTS, EPOCHS, RATE, BLUR = 8, 1000, 0.1, 0.01
LITTLE = 0.1
"""The standard deviation of an input that varies, where the largest is no smaller."""
COPIES, MARGIN = 20, 0.04
"""The noisy copies of each percept on which restarts are compared, and the standard deviation of
the noise, in units of that of the percepts."""
SHARPNESS = 4.0
IMPOSSIBLE = 1e-6
"""The least reliability, without which a scenario that no member solves would have no logarithm."""

Gradient: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""The gradient (R, M - 1, K) for R sets of parameters of the same shape and percepts (B, D)."""


def train_gating(
    branch: BranchingNN, percepts: Tensor, solves: Tensor, weight: Tensor, generator: Generator
) -> Tensor:
    """(M - 1, K) parameters of the branching nodes, the best of several restarts.

    Args:
        branch: The action of the branching nodes.
        percepts: (B, D) first percepts.
        solves: (B, M) how reliably each member solves each scenario, in [0, 1].
        weight: (B,) the weight of each scenario.
        generator: Draws initial parameters and noise on percepts.
    """
    if solves.shape[1] == 1:
        return percepts.new_zeros(0, branch.num_parameters)
    x = branch.sees(percepts)
    centre, scale, blur = x.mean(0), *_scale_and_blur(x)
    weight = weight * (solves.amax(1) > 0)
    tries = _descend(branch, (x - centre) / scale, solves, weight, blur / scale, generator)
    ends = [_unscaled(branch, parameters, centre, scale) for parameters in tries]
    return ends[_most_reliable(branch, ends, percepts, solves, weight, generator)]


def _scale_and_blur(x: Tensor) -> tuple[Tensor, float]:
    """The units (K,) of inputs (B, K), and the noise on them that training adds.

    Inputs that vary little are no more than noise, as long as others vary by `LITTLE` or more. Else
    the unit of all is small, and the noise with it.
    """
    spread = x.std(0)
    share = min(1.0, float(spread.max()) / LITTLE) or 1.0
    return spread.clamp_min(LITTLE * share), BLUR * share


def _most_reliable(
    branch: BranchingNN,
    tries: list[Tensor],
    percepts: Tensor,
    solves: Tensor,
    weight: Tensor,
    generator: Generator,
) -> int:
    """The index of the try that sends the least weight of scenarios to members that fail.

    Several tries often send none to a member that always fails. Of these, the one is best that errs
    least on noisy copies of the percepts, since its borders are far from the scenarios.
    """
    rows = weight.nonzero()[:, 0]
    copies = rows.repeat(COPIES)
    noise = torch.randn(len(copies), percepts.shape[1], generator=generator)
    noisy = percepts[copies] + MARGIN * percepts[rows].std(0, correction=0) * noise

    def rates(parameters: Tensor, x: Tensor, rows: Tensor) -> Tensor:
        return solves[rows].gather(1, selected_members(branch, parameters, x)[:, None])[:, 0]

    def score(parameters: Tensor) -> tuple[float, float]:
        hopeless = rates(parameters, percepts[rows], rows) == 0
        failing = 1 - rates(parameters, noisy, copies)
        return float((weight[rows] * hopeless).sum()), float((weight[copies] * failing).sum())

    scores = [score(parameters) for parameters in tries]
    return scores.index(min(scores))


def _descend(
    branch: BranchingNN,
    x: Tensor,
    solves: Tensor,
    weight: Tensor,
    blur: Tensor,
    generator: Generator,
) -> Tensor:
    """(RESTARTS, M - 1, K) parameters, by Adam from several random starts at once.

    The learning rate follows half a cosine (Loshchilov & Hutter, "SGDR", ICLR 2017).
    """
    shape = (RESTARTS, solves.shape[1] - 1, branch.num_parameters)
    parameters, rate = torch.randn(shape, generator=generator), RATE
    mean, square = torch.zeros(shape), torch.zeros(shape)
    gradient = gradient_of(branch, solves, weight, RESTARTS)
    for epoch in range(EPOCHS):
        noisy = x + torch.randn(x.shape, generator=generator) * blur
        slope = gradient(parameters, noisy)
        # Adam, without the calls around it, which take longer than its arithmetic.
        mean.lerp_(slope, 1 - 0.9)
        square.mul_(0.999).addcmul_(slope, slope, value=1 - 0.999)
        size = rate / (1 - 0.9 ** (epoch + 1))
        spread = (square.sqrt() / math.sqrt(1 - 0.999 ** (epoch + 1))).add_(1e-8)
        parameters.addcdiv_(mean, spread, value=-size)
        turn = math.pi / EPOCHS
        rate *= (1 + math.cos(turn * (epoch + 1))) / (1 + math.cos(turn * epoch))
    return parameters


def selected_members(branch: BranchingNN, parameters: Tensor, percepts: Tensor) -> Tensor:
    """(B,) long, the member to which each percept is sent, by parameters (M - 1, K)."""
    x = branch.sees(percepts)
    # As in the running skill, where the sigmoid rounds large outputs to the same number.
    out = [sigmoid(one_hidden_layer(x, p, branch.hidden, 2)) for p in parameters]
    last = torch.ones(len(x), dtype=torch.bool)
    return torch.stack([*(o[:, 0] >= o[:, 1] for o in out), last]).long().argmax(0)


def _unscaled(branch: BranchingNN, parameters: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """The same networks for percepts in their own units."""
    size, hidden = branch.hidden * branch.inputs, branch.hidden
    w1, b1, rest = parameters.tensor_split([size, size + hidden], 1)
    w1 = w1.unflatten(1, (hidden, branch.inputs)) / scale
    return torch.cat([w1.flatten(1), b1 - w1 @ centre, rest], 1)


def gradient_in_torch(branch: BranchingNN, solves: Tensor, weight: Tensor) -> Gradient:
    """The gradient by automatic differentiation; for (B, M) and (B,) see `train_gating`."""
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
    passed = pad(second.cumsum(-1), (1, 0))
    return passed + pad(first, (0, 1))
