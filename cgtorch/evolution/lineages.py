"""Lineages: the best structures of a population have their parameters tuned, in a race.

Operators on structure change a parameter of a node here and there, by one step size for all of a
graph. That finds structures, and tunes them badly. So the search goes in turns. A population is
bred and evaluated as in Algorithm 2. Its best structures found lineages, in each of which the graph
stays and CMA-ES (`cgtorch.evolution.cma`) moves its parameters. All are sampled in every
generation; after `RUNGS` generations the better half of them stay (successive halving: Jamieson and
Talwalkar, AISTATS 2016), the best of each kind of graph before others, as some kinds get better
later than others. The last one goes on until it stalls. What they have come to joins the
structures that they came from as parents of the next population, tuned parameters included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.cma import (
    Distribution,
    initial_distribution,
    sampled,
    updated,
    usual_count,
)
from cgtorch.evolution.evaluated import Evaluated
from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.evolution.population import Population, join, slim
from cgtorch.graphs import Graphs, compacted

RUNGS = (5, 40)
"""After how many generations the worse half of the lineages is given up."""
SEVERAL = 8
"""Individuals looked at for each lineage that is to be founded."""
STALL = 40
"""Generations without progress after which a lineage is given up."""
MOST_UPDATES = 120
"""Generations of a lineage at most: one that gets better for ever still can be on a wrong way."""
LEAST_STEP = 1e-4
RECENT = 8
"""Generations whose better quarters say how far a lineage has come."""
LEAST_PROGRESS = 0.01
"""Of what a lineage has come to, which counts as progress."""


@dataclass(frozen=True, eq=False)  # equality would have to be one of tensors
class Lineage:
    """A graph whose parameters are tuned.

    Attributes:
        best: the best individual so far, a population of one.
        fitness: what it had, -inf before the first sample.
        scores: (B,) what that is the mean of.
        distribution: of the parameters of its nodes.
        recent: mean fitness of the better quarter of samples in each of the last generations.
        level: the most that the mean of these has been.
        since: generations since then.
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
        """How good samples have been lately."""
        return sum(self.recent) / len(self.recent) if self.recent else self.fitness

    @property
    def kind(self) -> tuple[int, ...]:
        """Which actions its nodes have, in any order."""
        return tuple(sorted(self.best.graphs.action[0].tolist()))

    @property
    def over(self) -> bool:
        """Whether there is nothing left to tune."""
        tuned = self.distribution.step < LEAST_STEP or self.distribution.updates >= MOST_UPDATES
        return tuned or self.since >= STALL


def new_lineages(evaluated: Evaluated, actions: ActionSet, count: int) -> tuple[Lineage, ...]:
    """Up to `count` lineages of the best of P individuals, one of each kind before a second one.

    An individual without parameters founds none, and none does whose fitness says that it has not
    finished.
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
    """The lineages in the same order, but the first of each kind come before the others."""
    first = {each.kind: each for each in reversed(lineages)}.values()
    return sorted(lineages, key=lambda each: all(each is not one for one in first))


def tunable(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(N, K) bool, which parameters of a single graph its nodes have."""
    action = graphs.action[0]
    count = actions.num_parameters[action.clamp_min(0)] * (action >= 0)
    return torch.arange(graphs.parameters.shape[2]) < count[:, None]


def samples(lineages: Sequence[Lineage], actions: ActionSet, generator: Generator) -> Population:
    """Samples of all lineages, one lineage after the other."""
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
    """The lineages after their `samples` were evaluated, all of them in their order."""
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
    """Individuals, and what lineages have come to after them."""
    if not lineages:
        return evaluated
    best = join(*(each.best for each in lineages))
    fitness = evaluated.fitness.new_tensor([each.fitness for each in lineages])
    scores = torch.stack([each.scores for each in lineages]).to(evaluated.scores)
    return evaluated.with_others(Evaluated(best, fitness, scores))


def successive_halving(
    lineages: Sequence[Lineage],
) -> tuple[tuple[Lineage, ...], tuple[Lineage, ...]]:
    """Which lineages go on, and which are given up."""
    going = [each for each in lineages if not each.over]
    if going and max(each.distribution.updates for each in going) in RUNGS:
        best = sorted(going, key=lambda each: -each.recent_fitness)
        stay = one_of_each_kind_first(best)[: -(-len(going) // 2)]
        going = [each for each in going if any(each is x for x in stay)]
    return tuple(going), tuple(each for each in lineages if not any(each is x for x in going))
