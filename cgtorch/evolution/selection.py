"""Selection and elitism (Algorithm 2, lines 7 and 12): ways to choose parents."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled
from cgtorch.graphs import Graphs
from cgtorch.ground.errors import SettingsError

Selection: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""From (P,) individuals from best to worst, their scores (P, B), how many parents to choose, and
the generator of the choices, to the parents (count,)."""


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """(P,) long, from best to worst by fitness (P,), no NaN; of equal ones the smaller first."""
    if compiled.takes_scores(fitness) and compiled.is_whole(graphs.action):
        return compiled.ranking(fitness, graphs)
    return ranked(fitness, graphs)


def ranked(fitness: Tensor, graphs: Graphs) -> Tensor:
    """The same in torch; `native/engine/ranking.c` sorts faster."""
    by_size = torch.argsort(graphs.num_nodes, stable=True)
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
