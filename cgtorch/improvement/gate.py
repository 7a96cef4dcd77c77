"""Branching by gradient: from the first percept to a sub-skill that solves the scenario."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import BranchingNN
from cgtorch.actions.networks import one_hidden_layer, sigmoid

RESTARTS, EPOCHS, RATE, BLUR = 4, 400, 0.05, 0.01
SHARPNESS = 4.0


def train_branches(
    branch: BranchingNN, percepts: Tensor, solves: Tensor, weight: Tensor, generator: Generator
) -> tuple[Tensor, Tensor]:
    """Parameters of M - 1 branches that send each scenario to a member that solves it.

    The branches are asked in turn: the first that says "out1" hands over to its member, the last
    member takes what is left. During training each says so with a probability, and the loss is
    the negative log-probability that a scenario reaches a member that solves it.

    Args:
        branch: the action, which gives the shape of the networks.
        percepts: (B, D) first percepts, in m.
        solves: (B, M) float, how surely each member solves each scenario, in [0, 1].
        weight: (B,) how much each scenario counts.
        generator: of initial weights and of the noise added to percepts.

    Returns:
        (M - 1, K) parameters and (B,) long, the member that each scenario is sent to.
    """
    if solves.shape[1] == 1:
        empty = percepts.new_zeros(0, branch.num_parameters)
        return empty, torch.zeros(len(percepts), dtype=torch.long)
    x = percepts[:, : branch.inputs]
    centre, scale = x.mean(0), x.std(0).clamp_min(0.1)
    useful = solves.amax(1) > 0
    best_loss, best = float("inf"), torch.zeros(solves.shape[1] - 1, branch.num_parameters)
    for _ in range(RESTARTS):
        parameters, loss = _descend(
            branch, (x - centre) / scale, solves, weight * useful, BLUR / scale, generator
        )
        if loss < best_loss:
            best_loss, best = loss, parameters
    best = _unscaled(branch, best, centre, scale)
    return best, sent_to(branch, best, percepts)


def _descend(
    branch: BranchingNN,
    x: Tensor,
    solves: Tensor,
    weight: Tensor,
    blur: Tensor,
    generator: Generator,
) -> tuple[Tensor, float]:
    """Adam from one random start; the parameters and how much weight is sent wrong."""
    shape = (solves.shape[1] - 1, branch.num_parameters)
    parameters = torch.randn(shape, generator=generator).requires_grad_()
    optimiser = torch.optim.Adam([parameters], lr=RATE)
    for _ in range(EPOCHS):
        noisy = x + torch.randn(x.shape, generator=generator) * blur
        chosen = _log_chosen(branch, parameters, noisy)
        reached = torch.logsumexp(chosen + solves.clamp_min(1e-6).log(), 1)
        loss = -(weight * reached).sum() / weight.sum().clamp_min(1) + 1e-4 * (parameters**2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    final = parameters.detach()
    member = sent_to(branch, final, x)
    wrong = (weight * (1 - solves.gather(1, member[:, None])[:, 0])).sum()
    return final, float(wrong) + 1e-3 * float(loss.detach())


def _outputs(branch: BranchingNN, parameters: Tensor, x: Tensor) -> Tensor:
    """(M - 1, B, 2) outputs of all branches, before the sigmoid, which keeps their order."""
    return torch.stack([one_hidden_layer(x, p, branch.hidden, 2) for p in parameters])


def _log_chosen(branch: BranchingNN, parameters: Tensor, x: Tensor) -> Tensor:
    """(B, M) log-probability that each member is chosen."""
    first, second = (SHARPNESS * _outputs(branch, parameters, x)).log_softmax(-1).unbind(-1)
    passed = torch.cat([torch.zeros_like(second[:1]), second.cumsum(0)])
    taken = torch.cat([first, torch.zeros_like(first[:1])])
    return (passed + taken).T


def sent_to(branch: BranchingNN, parameters: Tensor, percepts: Tensor) -> Tensor:
    """(B,) long, the member that each percept is sent to."""
    x = percepts[:, : branch.inputs]
    # The sigmoid rounds large outputs to the same number, as it does when the skill runs.
    out = sigmoid(_outputs(branch, parameters, x))
    takes = out[..., 0] >= out[..., 1]
    return torch.cat([takes, torch.ones_like(takes[:1])]).long().argmax(0)


def _unscaled(branch: BranchingNN, parameters: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """The same networks, on percepts in metres."""
    size, hidden = branch.hidden * branch.inputs, branch.hidden
    w1, b1, rest = parameters.tensor_split([size, size + hidden], 1)
    w1 = w1.unflatten(1, (hidden, branch.inputs)) / scale
    return torch.cat([w1.flatten(1), b1 - w1 @ centre, rest], 1)
