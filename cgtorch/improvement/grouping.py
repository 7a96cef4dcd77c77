"""Choosing scenarios by their first percepts: groups of missed scenarios, and a coreset of W.

Specialists are evolved on groups. Members of a team are tried on a coreset of W, and branching
nodes are trained on it, so W can grow without bound. A new skill is tried on all of W before it is
accepted, and what it loses joins the coreset (`cgtorch.improvement.improve`).
"""

import torch
from torch import Generator, Tensor


def broad_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of missed scenarios, drawn at random; for the arguments see `local_group`."""
    rows = missed.nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=generator)[:size]]


def local_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices (n,), at most `size`, of a random `missed` (B,) scenario and its nearest missed ones.

    Distances are those of first percepts (B, D).
    """
    rows = missed.nonzero()[:, 0]
    seed = rows[torch.randint(len(rows), (1,), generator=generator)]
    distance = torch.cdist(percepts[rows], percepts[seed])[:, 0]
    return rows[distance.argsort(stable=True)[:size]]


def cover(percepts: Tensor, size: int) -> tuple[Tensor, float]:
    """(n,) long, ascending, scenarios that cover first percepts (B, D) (Gonzalez 1985).

    The first scenario is chosen, then repeatedly the one farthest from those chosen, up to `size`.
    The largest distance to a chosen one is at most twice that of the best choice of as many. Of
    equal percepts, only one is chosen. The largest distance is returned, too.
    """
    if len(percepts) <= size:
        return torch.arange(len(percepts)), 0.0
    distance = torch.full((len(percepts),), torch.inf)
    rows = [0]
    while True:
        distance = torch.minimum(distance, (percepts - percepts[rows[-1]]).norm(dim=1))
        if len(rows) == size or not distance.any():
            return torch.tensor(rows).sort()[0], float(distance.max())
        rows.append(int(distance.argmax()))
