"""Groups of missed scenarios that specialists are evolved on."""

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
