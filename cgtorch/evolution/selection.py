"""Evaluated individuals, their ranking, and the selection of parents (Algorithm 2, line 7)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled
from cgtorch.evolution.population import Population, join
from cgtorch.graphs import Graphs
from cgtorch.ground.counter_rng import keys, pick, random_key, uniform_from, words
from cgtorch.ground.errors import SettingsError
from cgtorch.native.gpu import launcher_of

Selection: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""Maps P individuals (P,) from best to worst, their scores (P, B), the number of parents, and the
generator of all random choices to parents (count,)."""

MOST_CANDIDATES = 1024  # individuals that a parent is chosen from at most


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Evaluated:
    """P individuals with their fitness (P,) and scores (P, B), as in `Evaluation`."""

    population: Population
    fitness: Tensor
    scores: Tensor

    def __len__(self) -> int:
        """The number of individuals."""
        return len(self.population)

    @cached_property
    def order(self) -> Tensor:
        """(P,) long, from best to worst; of equally fit individuals, the smaller graph first."""
        return ranking(self.fitness, self.population.graphs)

    def rows(self, index: Tensor | slice) -> "Evaluated":
        """The individuals at `index` (k,)."""
        return Evaluated(self.population[index], self.fitness[index], self.scores[index])

    def with_others(self, others: "Evaluated") -> "Evaluated":
        """These individuals, followed by others."""
        return Evaluated(
            join(self.population, others.population),
            torch.cat([self.fitness, others.fitness]),
            torch.cat([self.scores, others.scores]),
        )


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """(P,) long, from best to worst by fitness (P,) without NaN; of equals, the smaller first."""
    if compiled.takes_scores(fitness) and compiled.is_whole(graphs.action):
        return compiled.ranking(fitness, graphs)
    return ranked(fitness, graphs)


def ranked(fitness: Tensor, graphs: Graphs) -> Tensor:
    """`ranking` in torch; `native/engine/selection.c` sorts faster."""
    by_size = torch.argsort(graphs.num_nodes, stable=True)
    return by_size[torch.argsort(fitness[by_size], descending=True, stable=True)]


def tournament(rounds: int = 5) -> Selection:
    """Selects the best of `rounds` individuals, drawn with replacement; SettingsError below 1."""
    if rounds < 1:
        raise SettingsError(f"tournament is {rounds}; give at least 1")

    def choose_winners(order: Tensor, scores: Tensor, count: int, generator: Generator) -> Tensor:
        place = torch.randint(len(order), (count, rounds), generator=generator)
        return order[place.amin(1)]

    return choose_winners


def lexicase(order: Tensor, scores: Tensor, count: int, generator: Generator) -> Tensor:
    """Epsilon-lexicase selection: parents that are among the best on random scenarios in turn.

    For each parent, the scenarios of `scores` (P, B) are visited in random order. On each, only
    those candidates remain whose score is at most one median absolute deviation below the best. A
    random candidate of those that remain at the end is the parent. So an individual that alone
    solves a hard scenario has children, even if it solves little else (La Cava et al. 2016).

    A population of more than `MOST_CANDIDATES` is split at random into equal groups. Each group
    gives equally many parents, so time and memory grow linearly with the population. Of `order`
    (P,), only the length is used.
    """
    groups, device = -(-len(order) // MOST_CANDIDATES), scores.device
    if groups == 1:
        members = torch.arange(len(order), device=device)
        return _from_groups(scores, members, [random_key(generator)], count)
    members = compiled.shuffled(len(order), random_key(generator), device)
    own = [random_key(generator) for _ in range(groups)]
    chosen = _from_groups(scores, members, own, count)
    return chosen[compiled.shuffled(count, random_key(generator), device)]


def _from_groups(scores: Tensor, members: Tensor, own: Sequence[int], count: int) -> Tensor:
    """(count,) parents from groups of `members` (P,), one for each of their `own` keys."""
    if launcher := launcher_of(scores.device):
        return compiled.lexicase_on_gpu(launcher, scores, members, own, count)
    parts = members.tensor_split(len(own)), torch.arange(count).tensor_split(len(own))
    chosen = []
    for group, part, key in zip(*parts, own, strict=True):
        inside = scores[group]
        if compiled.takes_scores(scores):
            places = compiled.lexicase(inside, compiled.deviation(inside), len(part), key)
        else:
            inside = inside + 0.0  # there is one zero only
            places = parents(inside, deviation(inside), len(part), key)
        chosen.append(group[places])
    return torch.cat(chosen)


def deviation(scores: Tensor) -> Tensor:
    """(B,) median absolute deviation from the median of scores (P, B)."""
    return (scores - scores.median(0).values).abs().median(0).values


def parents(scores: Tensor, epsilon: Tensor, count: int, key: int) -> Tensor:
    """(count,) parents, in torch; `native/engine/selection.c` selects one at a time.

    Individuals with equal scores (P, B) remain or go together, so each set of them is one row.
    `epsilon` (B,) is how far below the best a score may be.
    """
    rows, row_of, size = _distinct(scores)
    cases, own = rows.T.contiguous(), keys(key, count)
    survives = torch.ones(count, len(rows), dtype=torch.bool)
    for case in _case_order(own, scores.shape[1]):
        score = cases[case].masked_fill_(~survives, float("-inf"))
        survives &= score >= (score.amax(1) - epsilon[case])[:, None]
        if survives.sum() == count:  # one for each parent
            break
    # A random individual: of a parent's rows each counts as often as there are of its kind.
    last = (words(own, torch.tensor(scores.shape[1])) >> 11 & 2**53 - 1).double() * 2.0**-53
    ends = (survives * size).cumsum(1)
    place = (last * ends[:, -1]).long()
    row = (ends <= place[:, None]).sum(1)
    within = place - ends.gather(1, row[:, None])[:, 0] + size[row]
    first = size.cumsum(0) - size
    return row_of.argsort(stable=True)[first[row] + within]


def _case_order(own: Tensor, scenarios: int) -> Tensor:
    """(B, count) the order of scenarios for each key (count,), by Fisher and Yates' shuffle."""
    order = torch.arange(scenarios)[:, None].repeat(1, len(own))
    for place in range(scenarios):
        at = place + pick(uniform_from(words(own, torch.tensor(place))), scenarios - place)
        found = order.gather(0, at[None])
        order.scatter_(0, at[None], order[place : place + 1].clone())
        order[place] = found[0]
    return order


def _distinct(scores: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The distinct rows (R, B) in order of appearance, each individual's row (P,), and counts."""
    rows, row_of, size = torch.unique(scores, dim=0, return_inverse=True, return_counts=True)
    where = torch.full_like(size, len(scores))
    where.scatter_reduce_(0, row_of, torch.arange(len(scores)), "amin")
    order = where.argsort()
    return rows[order], order.argsort()[row_of], size[order]
