"""Groups of missed scenarios that specialists are evolved on."""

import torch
from torch import Generator, Tensor


def broad_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of missed scenarios, drawn at random; the arguments are those of `local_group`."""
    rows = missed.nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=generator)[:size]]


def local_group(percepts: Tensor, missed: Tensor, size: int, generator: Generator) -> Tensor:
    """Indices of a random missed scenario and the missed ones nearest to it.

    Args:
        percepts: (B, D) first percepts.
        missed: (B,) bool.
        size: the most scenarios in a group.
        generator: of the choice.
    """
    rows = missed.nonzero()[:, 0]
    seed = rows[torch.randint(len(rows), (1,), generator=generator)]
    distance = torch.cdist(percepts[rows], percepts[seed])[:, 0]
    return rows[distance.argsort(stable=True)[:size]]
