"""Lineages: CMA-ES tunes the parameters of the best structures of a population.

Mutations find structures, but tune their parameters badly. So the search alternates:

1. A population is bred and evaluated as in Algorithm 2.
2. Its best structures start lineages, in which CMA-ES (`cgtorch.evolution.cma`) adapts the
   parameters. All lineages are sampled in every generation. After each of `RUNGS` generations only
   the better half continues (successive halving: Jamieson and Talwalkar, AISTATS 2016), the best of
   each kind of graph first, as some kinds improve later. The last continues until it stalls.
3. The best individuals of all lineages become parents of the next population.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution.cma import (
    Distribution,
    initial_distribution,
    sampled,
    updated,
    usual_count,
)
from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.evolution.population import Population, join, slim
from cgtorch.evolution.selection import Evaluated
from cgtorch.graphs import ActionSet, Graphs, compacted

RUNGS = (5, 40)  # generations after which the worse half of the lineages ends
SEVERAL = 8  # individuals considered for each lineage to start
STALL = 40  # generations without progress after which a lineage ends
MOST_UPDATES = 120  # generations of a lineage
LEAST_STEP = 1e-4  # step size at which a lineage has converged
RECENT = 8  # generations over which the progress of a lineage is averaged
LEAST_PROGRESS = 0.01  # relative improvement of the average fitness that counts as progress


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Lineage:
    """A graph whose parameters are tuned.

    Attributes:
        best: The best individual so far, a population of one.
        fitness: The fitness of `best`.
        scores: (B,) the scores of `best`, whose mean is its fitness.
        distribution: The distribution of the parameters of its nodes.
        recent: The mean fitness of the better quarter of the samples, in each of the last
            generations.
        level: The highest mean of `recent` so far.
        since: Generations since `level` was reached.
    """

    best: Population
    fitness: float
    scores: Tensor
    distribution: Distribution
    recent: tuple[float, ...] = ()
    level: float = float("-inf")
    since: int = 0

    @property
    def recent_fitness(self) -> float:
        """The mean of `recent`, or the fitness before the first sample."""
        return sum(self.recent) / len(self.recent) if self.recent else self.fitness

    @property
    def kind(self) -> tuple[int, ...]:
        """The actions of its nodes, sorted."""
        return tuple(sorted(self.best.graphs.action[0].tolist()))

    @property
    def over(self) -> bool:
        """Whether the lineage has converged, stalled, or had its maximum number of generations."""
        tuned = self.distribution.step < LEAST_STEP or self.distribution.updates >= MOST_UPDATES
        return tuned or self.since >= STALL


def next_lineages(
    lineages: tuple[Lineage, ...],
    parents: Evaluated | None,
    evaluated: Evaluated,
    count: int,
    actions: ActionSet,
) -> tuple[tuple[Lineage, ...], Evaluated]:
    """The lineages to sample next, and what will be the parents of the next new structures.

    `evaluated` are samples of `lineages` if there are any; else up to `count` lineages start.
    """
    if not lineages:
        after = evaluated if parents is None else evaluated.with_others(parents)
        return new_lineages(evaluated, actions, count), after
    assert parents is not None  # noqa: S101  they are there with lineages
    going, ended = successive_halving(after_samples(lineages, evaluated, actions))
    return going, with_lineages(parents, ended)


def new_lineages(evaluated: Evaluated, actions: ActionSet, count: int) -> tuple[Lineage, ...]:
    """Up to `count` lineages of the best of P individuals; the best of each kind come first.

    Individuals without parameters start no lineage. Nor do those whose fitness shows that they did
    not finish an episode.
    """
    population, fitness, scores = evaluated.population, evaluated.fitness, evaluated.scores
    found: list[Lineage] = []
    for row in evaluated.order.tolist():
        if len(found) == SEVERAL * count or float(fitness[row]) < WORTHLESS:
            break
        one = population[row : row + 1]
        one = slim(Population(compacted(one.graphs), one.strategy))
        where = tunable(one.graphs, actions)
        if not where.any():
            continue
        steps = torch.tensor([action.first_step for action in actions.actions])
        deviation = steps[one.graphs.action[0]][:, None].expand(where.shape)[where]
        distribution = initial_distribution(one.graphs.parameters[0][where], deviation)
        found.append(Lineage(one, float(fitness[row]), scores[row].clone(), distribution))
    return tuple(one_of_each_kind_first(found)[:count])


def one_of_each_kind_first(lineages: Sequence[Lineage]) -> list[Lineage]:
    """The lineages in the same order, except that the first of each kind come before all others."""
    first = {each.kind: each for each in reversed(lineages)}.values()
    return sorted(lineages, key=lambda each: all(each is not one for one in first))


def tunable(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(N, K) bool, which entries of a single graph's parameters its nodes use."""
    action = graphs.action[0]
    count = actions.num_parameters[action.clamp_min(0)] * (action >= 0)
    return torch.arange(graphs.parameters.shape[2]) < count[:, None]


def samples(lineages: Sequence[Lineage], actions: ActionSet, generator: Generator) -> Population:
    """Samples of all lineages, lineage after lineage."""
    parts = []
    for lineage in lineages:
        where = tunable(lineage.best.graphs, actions)
        count = usual_count(int(where.sum()))
        copies = lineage.best[torch.zeros(count, dtype=torch.long)]
        parameters = copies.graphs.parameters.clone()
        parameters[:, where] = sampled(lineage.distribution, count, generator)
        graphs = replace(copies.graphs, parameters=parameters)
        parts.append(Population(graphs, copies.strategy))
    return join(*parts)


def after_samples(
    lineages: Sequence[Lineage], evaluated: Evaluated, actions: ActionSet
) -> tuple[Lineage, ...]:
    """All lineages, in their order, updated with the evaluated `samples`."""
    after, begin = [], 0
    for lineage in lineages:
        where = tunable(lineage.best.graphs, actions)
        end = begin + usual_count(int(where.sum()))
        after.append(_after_samples(lineage, evaluated.rows(slice(begin, end)), where))
        begin = end
    return tuple(after)


def _after_samples(lineage: Lineage, evaluated: Evaluated, where: Tensor) -> Lineage:
    (nodes, k), fitness = where.shape, evaluated.fitness
    parameters = evaluated.population.graphs.parameters[:, :nodes, :k]
    distribution = updated(lineage.distribution, parameters[:, where], fitness)
    better = fitness.sort(descending=True).values[: max(1, len(fitness) // 4)]
    recent = (*lineage.recent, float(better.double().mean()))[-RECENT:]
    lineage = replace(lineage, distribution=distribution, recent=recent, since=lineage.since + 1)
    if lineage.recent_fitness > lineage.level + LEAST_PROGRESS * min(abs(lineage.level), 1e9):
        lineage = replace(lineage, level=lineage.recent_fitness, since=0)
    top = int(fitness.argmax())
    if float(fitness[top]) <= lineage.fitness:
        return lineage
    best, scores = slim(evaluated.population[top : top + 1]), evaluated.scores[top].clone()
    return replace(lineage, best=best, fitness=float(fitness[top]), scores=scores)


def with_lineages(evaluated: Evaluated, lineages: Sequence[Lineage]) -> Evaluated:
    """The individuals, followed by the best individual of each lineage."""
    if not lineages:
        return evaluated
    best = join(*(each.best for each in lineages))
    fitness = evaluated.fitness.new_tensor([each.fitness for each in lineages])
    scores = torch.stack([each.scores for each in lineages]).to(evaluated.scores)
    return evaluated.with_others(Evaluated(best, fitness, scores))


def successive_halving(
    lineages: Sequence[Lineage],
) -> tuple[tuple[Lineage, ...], tuple[Lineage, ...]]:
    """The lineages that continue, and those that end."""
    going = [each for each in lineages if not each.over]
    if going and max(each.distribution.updates for each in going) in RUNGS:
        best = sorted(going, key=lambda each: -each.recent_fitness)
        stay = one_of_each_kind_first(best)[: -(-len(going) // 2)]
        going = [each for each in going if any(each is x for x in stay)]
    return tuple(going), tuple(each for each in lineages if not any(each is x for x in going))
