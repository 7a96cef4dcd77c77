"""Tournament selection and elitism (Algorithm 2, lines 7 and 12)."""

import torch
from torch import Generator, Tensor


def ranking(fitness: Tensor, size: Tensor) -> Tensor:
    """(P,) long, individuals from best to worst; of equal fitness the smaller graph first."""
    by_size = torch.argsort(size, stable=True)
    return by_size[torch.argsort(fitness[by_size], descending=True, stable=True)]


def tournament(order: Tensor, count: int, rounds: int, generator: Generator) -> Tensor:
    """(count,) long, winners of tournaments between `rounds` random individuals each.

    Args:
        order: (P,) individuals from best to worst.
        count: how many winners.
        rounds: individuals in each tournament, with replacement.
        generator: of the random choices.
    """
    place = torch.randint(len(order), (count, rounds), generator=generator)
    return order[place.amin(1)]
