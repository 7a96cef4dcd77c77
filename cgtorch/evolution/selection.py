"""Selection and elitism (Algorithm 2, lines 7 and 12): ways to choose parents."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.errors import SettingsError
from cgtorch.evolution.sampling import choose

Selection: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""From (P,) individuals from best to worst, their scores (P, B), how many parents to choose, and
the generator of the choices, to the parents (count,)."""


def ranking(fitness: Tensor, size: Tensor) -> Tensor:
    """(P,) long, individuals from best to worst; of equal fitness the smaller graph first."""
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


def lexicase(order: Tensor, scores: Tensor, count: int, generator: Generator) -> Tensor:
    """Parents that are among the best on one scenario after the other (La Cava et al. 2016).

    Each parent is chosen by itself: from all individuals those stay whose score on a random
    scenario is the best of them, or less by no more than the scenario's median absolute
    deviation, then of these those good on the next scenario, and so on through all in random
    order; of what stays at the end, a random one. So who alone solves a hard scenario has
    children, however little else it solves.

    Memory is (count, P). Arguments and result are those of `Selection`.
    """
    cases, epsilon = scores.T, deviation(scores)
    turns = torch.rand(count, len(cases), generator=generator).argsort(1)
    alive = torch.ones(count, len(order), dtype=torch.bool)
    for case in turns.T:
        score = cases[case]
        best = score.masked_fill(~alive, float("-inf")).amax(1, keepdim=True)
        alive &= score >= best - epsilon[case, None]
    return choose(alive, generator)


def deviation(scores: Tensor) -> Tensor:
    """(B,) median absolute deviation from the median of scores (P, B)."""
    return (scores - scores.median(0).values).abs().median(0).values
