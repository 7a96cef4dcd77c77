"""Choosing scenarios by what the robot sees at first: groups of missed ones, and a coreset of W.

Specialists are evolved on groups. Members of a team are tried on, and branches trained by, a
coreset, so that W can grow without bound: a new skill is tried on all of W before it is accepted,
and what it loses joins the coreset (`cgtorch.improvement.improve`).
"""

import torch
from torch import Generator, Tensor


def broad_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of missed scenarios, drawn at random; the arguments are those of `local_group`."""
    rows = missed.nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=generator)[:size]]


def local_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices (n,), at most `size`, of a random `missed` (B,) scenario and those nearest to it.

    Near is what the robot sees at first, `percepts` (B, D).
    """
    rows = missed.nonzero()[:, 0]
    seed = rows[torch.randint(len(rows), (1,), generator=generator)]
    distance = torch.cdist(percepts[rows], percepts[seed])[:, 0]
    return rows[distance.argsort(stable=True)[:size]]


def cover(percepts: Tensor, size: int) -> tuple[Tensor, float]:
    """(n,) long, ascending, scenarios spread over first percepts (B, D) in m (Gonzalez 1985).

    The first is kept, then again and again the one that is farthest from all that are kept, up to
    `size` of them: it is at most twice as far from them as with the best choice of as many. Of the
    same percept, only one is kept. Every other row is within the distance (m) that is returned too.
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
