"""Tuning the parameters of a graph by CMA-ES, for as long as its mean wins races."""

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
from cgtorch.evolution.fitness import WORST
from cgtorch.evolution.lineages import Lineage, tunable
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.spread import MANY, reliability

MOST = 2048  # scenarios of an update
CAREFUL = 0.5  # first steps, as a multiple of those of new structures
EVERY = 10  # updates between two races of the mean
LONG = 150  # updates, before which a tuning goes on if samples can be told apart
PATIENCE = 3  # races lost in a row after which there are twice as many scenarios


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Tuning:
    """A graph whose parameters are tuned.

    Attributes:
        graph: The graph, a single one.
        distribution: The distribution of its parameters.
        scenarios: Number of fresh scenarios of an update.
        lost: Races that the mean has lost in a row.
        reliable: Whether samples of the last update could be told apart.
    """

    graph: Graphs
    distribution: Distribution
    scenarios: int
    lost: int = 0
    reliable: bool = False

    def mean(self, actions: ActionSet) -> Graphs:
        """The graph with the mean of the distribution as its parameters."""
        mean = self.distribution.mean.float()[None]
        return with_parameters(self.graph, tunable(self.graph, actions), mean)

    def raced(self, won: bool) -> "Tuning":
        """The tuning after a race of its mean."""
        return replace(self, lost=0 if won else self.lost + 1)

    @property
    def kind(self) -> tuple[int, ...]:
        """The actions of the nodes, sorted."""
        return tuple(sorted(self.graph.action[0].tolist()))

    @property
    def due(self) -> bool:
        """Whether it is time for a race of the mean."""
        return self.distribution.updates % EVERY == 0

    @property
    def stalled(self) -> bool:
        """Whether the mean has lost several races in a row."""
        return self.lost >= PATIENCE

    def more(self) -> "Tuning | None":
        """The tuning after it has stalled, with twice as many scenarios if luck hides differences.

        None where neither these nor further updates would help.
        """
        if self.reliable:
            return replace(self, lost=0) if self.distribution.updates < LONG else None
        if self.scenarios >= MOST:
            return None
        return replace(self, lost=0, scenarios=min(MOST, 2 * self.scenarios))


def begun(graph: Graphs, actions: ActionSet, scenarios: int) -> Tuning | None:
    """The tuning of a graph; None if it has no parameters."""
    where = tunable(graph, actions)
    if not where.any():
        return None
    steps = CAREFUL * torch.tensor([action.first_step for action in actions.actions])
    deviation = steps[graph.action[0]][:, None].expand(where.shape)[where]
    distribution = initial_distribution(graph.parameters[0][where], deviation)
    return Tuning(graph, distribution, scenarios)


def continued(lineage: Lineage) -> Tuning:
    """A tuning of a lineage's graph that may begin, with its distribution."""
    return Tuning(lineage.best.graphs, lineage.distribution, 0)


def update(tuning: Tuning, actions: ActionSet, fresh: Fresh, generator: Generator) -> Tuning:
    """The tuning after one update by samples, which meet the same fresh scenarios."""
    where, count = tunable(tuning.graph, actions), usual_count(len(tuning.distribution.mean))
    drawn = sampled(tuning.distribution, count, generator)
    graphs = with_parameters(tuning.graph, where, drawn)
    values = fresh.values(graphs, actions, fresh.world(tuning.scenarios, generator))
    values = torch.nan_to_num(values, nan=WORST, neginf=WORST).clamp_min(WORST)
    distribution = updated(tuning.distribution, drawn, values.double().mean(1))
    return replace(tuning, distribution=distribution, reliable=reliability(values) > MANY)


def with_parameters(graph: Graphs, where: Tensor, parameters: Tensor) -> Graphs:
    """A graph with other parameters (λ, n) at the entries `where` (N, K), as λ graphs."""
    many = graph[torch.zeros(len(parameters), dtype=torch.long)]
    changed = many.parameters.clone()
    changed[:, where] = parameters
    return replace(many, parameters=changed)
