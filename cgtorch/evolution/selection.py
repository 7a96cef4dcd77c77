"""Selection and elitism (Algorithm 2, lines 7 and 12): ways to choose parents."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.errors import SettingsError
from cgtorch.evolution import compiled

Selection: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""From (P,) individuals from best to worst, their scores (P, B), how many parents to choose, and
the generator of the choices, to the parents (count,)."""


def ranking(fitness: Tensor, size: Tensor) -> Tensor:
    """(P,) long, individuals from best to worst; of equal fitness the smaller graph first."""
    if compiled.takes_scores(fitness):
        return compiled.ranking(fitness, size)
    return ranked(fitness, size)


def ranked(fitness: Tensor, size: Tensor) -> Tensor:
    """The same in torch; `native/ranking.c` sorts faster."""
    by_size = torch.argsort(size, stable=True)
    return by_size[torch.argsort(fitness[by_size], descending=True, stable=True)]


def tournament(rounds: int = 5) -> Selection:
    """Winners of tournaments between `rounds` random individuals each, with replacement.

    Raises:
        SettingsError: fewer than one round.
    """
    if rounds < 1:
        raise SettingsError(f"tournament is {rounds}; give at least 1")

    def choose_winners(order: Tensor, scores: Tensor, count: int, generator: Generator) -> Tensor:
        place = torch.randint(len(order), (count, rounds), generator=generator)
        return order[place.amin(1)]

    return choose_winners
