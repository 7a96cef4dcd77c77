"""Selection of parents, and ranking for the elite (Algorithm 2, lines 7 and 12)."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled, gpu
from cgtorch.graphs import Graphs
from cgtorch.ground.counter_rng import keys, pick, random_key, uniform_from, words
from cgtorch.ground.errors import SettingsError
from cgtorch.native.gpu import Launcher, launcher_of

Selection: TypeAlias = Callable[[Tensor, Tensor, int, Generator], Tensor]
"""Maps P individuals (P,) from best to worst, their scores (P, B), the number of parents, and the
generator of all random choices to parents (count,)."""

MOST_CANDIDATES = 1024  # individuals that a parent is chosen from at most


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """(P,) long, from best to worst by fitness (P,) without NaN; of equals, the smaller first."""
    if compiled.takes_scores(fitness) and compiled.is_whole(graphs.action):
        return compiled.ranking(fitness, graphs)
    return ranked(fitness, graphs)


def ranked(fitness: Tensor, graphs: Graphs) -> Tensor:
    """`ranking` in torch; `native/engine/ranking.c` sorts faster."""
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

    For each parent, the scenarios are visited in random order. On each, only those candidates
    remain whose score is at most one median absolute deviation below the best. A random candidate
    of those that remain at the end is the parent. So an individual that alone solves a hard
    scenario has children, even if it solves little else (La Cava et al. 2016).

    A population of more than `MOST_CANDIDATES` is split at random into equal groups. Each group
    gives equally many parents, so time and memory grow linearly with the population.

    Args:
        order: (P,) individuals from best to worst; only their number is used.
        scores: (P, B), where more is better.
        count: Number of parents.
        generator: The generator of all random choices.
    """
    groups = -(-len(order) // MOST_CANDIDATES)
    if launcher := launcher_of(scores.device):
        return _on_gpu(launcher, scores, groups, count, generator)
    if groups == 1:
        return _from_all(scores, count, generator)
    members = compiled.shuffled(len(order), random_key(generator)).tensor_split(groups)
    chosen = [
        group[_from_all(scores[group], len(part), generator)]
        for group, part in zip(members, torch.arange(count).tensor_split(groups), strict=True)
    ]
    return torch.cat(chosen)[compiled.shuffled(count, random_key(generator))]


def _on_gpu(
    launcher: Launcher, scores: Tensor, groups: int, count: int, generator: Generator
) -> Tensor:
    """`lexicase` by scores (P, B) on a GPU, with the same random numbers."""
    if groups == 1:
        members = torch.arange(len(scores), device=scores.device)
        return gpu.lexicase(launcher, scores, members, [random_key(generator)], count)
    members = gpu.shuffled(launcher, len(scores), random_key(generator))
    own = [random_key(generator) for _ in range(groups)]
    chosen = gpu.lexicase(launcher, scores, members, own, count)
    return chosen[gpu.shuffled(launcher, count, random_key(generator))]


def deviation(scores: Tensor) -> Tensor:
    """(B,) median absolute deviation from the median of scores (P, B)."""
    return (scores - scores.median(0).values).abs().median(0).values


def _from_all(scores: Tensor, count: int, generator: Generator) -> Tensor:
    """(count,) parents from all P individuals of `scores` (P, B)."""
    if compiled.takes_scores(scores):
        return compiled.lexicase(scores, compiled.deviation(scores), count, random_key(generator))
    scores = scores + 0.0  # there is one zero only
    return parents(scores, deviation(scores), count, random_key(generator))


def parents(scores: Tensor, epsilon: Tensor, count: int, key: int) -> Tensor:
    """(count,) parents, in torch; `native/engine/lexicase.c` selects one at a time.

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
