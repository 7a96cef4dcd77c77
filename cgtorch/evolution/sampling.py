"""Random choices for a whole population at once."""

import torch
from torch import Generator, Tensor


def choose(mask: Tensor, generator: Generator) -> Tensor:
    """(P,) long, for each row of `mask` (P, N) the index of a random True; 0 if there is none."""
    keys = torch.rand(mask.shape, generator=generator)
    return keys.masked_fill_(~mask, -1.0).argmax(1)


def choose_many(mask: Tensor, shape: tuple[int, ...], generator: Generator) -> Tensor:
    """(P, *shape) long, independent random True indices of each row of `mask` (P, N)."""
    draw = torch.rand(len(mask), *shape, generator=generator)
    order = torch.argsort((~mask).long(), dim=1, stable=True)
    count = mask.sum(1).clamp_min(1)
    pick = (draw.flatten(1) * count[:, None]).long()
    # In float32 a draw close to 1 can round up to the count itself.
    pick = torch.minimum(pick, count[:, None] - 1)
    return order.gather(1, pick).view(draw.shape)


def bernoulli(probability: Tensor, shape: tuple[int, ...], generator: Generator) -> Tensor:
    """(P, *shape) bool, each True with its row's probability (P,)."""
    draw = torch.rand(len(probability), *shape, generator=generator)
    return draw < probability.view(-1, *[1] * len(shape))
