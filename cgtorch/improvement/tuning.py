"""Tuning the parameters of a graph by CMA-ES, for as long as its mean wins races."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Generator, Tensor

from cgtorch.evolution.cma import (
    Distribution,
    initial_distribution,
    sampled,
    updated,
    usual_count,
)
from cgtorch.evolution.lineages import tunable
from cgtorch.graphs import ActionSet, Graphs, concatenate, trimmed, widened
from cgtorch.improvement.horizon import Horizon, Played, played_until
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.spread import MANY, Need

MOST = 2048  # scenarios of an update
MOST_FULL = 64  # parameters of which covariances are learned, as there are few updates
SAMPLES = 20  # of an update at least, as luck is in what they are worth
PARTS = 2  # smaller updates in place of one of many parameters, as each moves the mean
FEW = 8  # random parameters from which none is better
EVERY = 5  # updates between two races of the mean
CONVERGED = 0.02  # step size below which samples that can be told apart need no more scenarios
PATIENCE = 6  # races lost in a row after which there are twice as many scenarios
DOUBTFUL = 4  # races lost in a row after which a tuning is no longer preferred to others
PROGRESS = 0.1  # relative improvement of samples that counts
WIDER, WIDEST = 1.4, 1e4  # by which steps grow where samples are alike, and their limit
SEVERAL = 8  # scenarios on which a quarter of samples is not alike by luck
RELATIVE = 0.5  # first steps in units of parameters that are larger than usual
RECENT = 4  # updates by which tunings are compared
TRAIL = 4  # of the latest means that tell together what a mean is worth
FIRM, EXACT = 0.5, 0.99  # shares of the variance of values that lengths of episodes explain


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Tuning:
    """A graph whose parameters are tuned.

    Attributes:
        graph: The graph, a single one.
        distribution: The distribution of its parameters.
        scenarios: Number of fresh scenarios of an update.
        toll: What each transition takes from the value of an episode. It is above 0 where values
            are mainly the lengths of episodes, so that a skill that does nothing for long is worth
            no more than one that fails early (Mania et al., "Simple random search provides a
            competitive approach to reinforcement learning", 2018, section 4.1).
        alone: Whether its mean races from the start, without being compared with other rivals.
        lost: Races that the mean has lost in a row.
        reliability: How well samples of the last updates could be told apart.
        recent: The mean values of the better half of samples, in each of the last updates, or in
            the last one with whole episodes.
        mark: The level when races were last lost in a row.
        horizon: How far episodes of updates are played, most of the time.
        trail: What its mean was worth on fresh scenarios after each of the last `TRAIL` races that
            were due.
    """

    graph: Graphs
    distribution: Distribution
    scenarios: int
    toll: float
    alone: bool
    lost: int = 0
    reliability: float = Need.reliability
    recent: tuple[float, ...] = ()
    mark: float = -math.inf
    horizon: Horizon = field(default_factory=Horizon)
    trail: tuple[float, ...] = ()

    def mean(self, actions: ActionSet) -> Graphs:
        """The graph with the mean of the distribution as its parameters."""
        mean = self.distribution.mean.float()[None]
        return with_parameters(self.graph, tunable(self.graph, actions), mean)

    def raced(self, won: bool) -> "Tuning":
        """The tuning after a race of its mean."""
        return replace(self, lost=0 if won else self.lost + 1)

    def seen(self, worth: float) -> "Tuning":
        """The tuning after its mean was worth so much on fresh scenarios."""
        return replace(self, trail=(*self.trail, worth)[-TRAIL:])

    def fits(self, graph: Graphs) -> bool:
        """Whether a graph differs in parameters only."""
        names, graph = ("action", "edges", "start"), trimmed(graph)
        return all(torch.equal(getattr(self.graph, name), getattr(graph, name)) for name in names)

    def distance(self, graph: Graphs, actions: ActionSet) -> float:
        """How far its mean is from the parameters of a graph that fits."""
        return float((self.distribution.mean.float() - _parameters(graph, actions)).norm())

    def moved(self, graph: Graphs, actions: ActionSet) -> "Tuning":
        """The tuning with the parameters of a graph that fits as its mean."""
        if self.distance(graph, actions) == 0:
            return replace(self, lost=0)
        distribution = replace(self.distribution, mean=_parameters(graph, actions).double())
        return replace(self, lost=0, trail=(), distribution=distribution)

    def counted(self, before: "Tuning") -> "Tuning":
        """The tuning after one update more than before."""
        updates = before.distribution.updates + 1
        return replace(self, distribution=replace(self.distribution, updates=updates))

    @property
    def apart(self) -> bool:
        """Whether of its parameters variances only are learned."""
        return self.distribution.covariance.dim() == 1

    @property
    def kind(self) -> tuple[int, ...]:
        """The actions of the nodes, sorted."""
        return tuple(sorted(self.graph.action[self.graph.used].tolist()))

    @property
    def level(self) -> float:
        """The mean of `recent`, -inf before the first update."""
        return sum(self.recent) / len(self.recent) if self.recent else -math.inf

    @property
    def due(self) -> bool:
        """Whether it is time for a race of the mean."""
        return self.distribution.updates % EVERY == 0

    @property
    def winning(self) -> bool:
        """Whether the mean has won a race lately, or has not had the time to."""
        return self.lost < DOUBTFUL

    @property
    def stalled(self) -> bool:
        """Whether the mean has lost several races in a row."""
        return self.lost >= PATIENCE

    @property
    def improving(self) -> bool:
        """Whether samples have become better since races were last lost in a row."""
        return self.level > self.mark + PROGRESS * min(abs(self.mark), 1e9)

    def more(self) -> "Tuning | None":
        """The tuning after it has stalled, with twice as many scenarios if luck hides differences.

        While its samples become better, it goes on as it is. None where neither further scenarios
        nor further updates would help.
        """
        after = replace(self, lost=0, mark=max(self.mark, self.level))
        if self.improving:
            return after
        if self.scenarios >= MOST or (
            self.reliability > MANY and self.distribution.step < CONVERGED
        ):
            return None
        return replace(after, scenarios=min(MOST, 2 * self.scenarios))


def begun(
    graph: Graphs, actions: ActionSet, scenarios: int, toll: float = 0.0, alone: bool = False
) -> Tuning | None:
    """The tuning of a graph; None if it has no parameters.

    The first steps are the smaller the more parameters there are, so that what all of them change
    together has the same size.
    """
    where = tunable(graph, actions)
    if not where.any():
        return None
    steps = torch.tensor([action.first_step for action in actions.actions])[graph.action[0]]
    own = graph.parameters[0].square().sum(1) / where.sum(1)
    deviation = torch.maximum(steps, RELATIVE * own.sqrt())[:, None].expand(where.shape)[where]
    deviation = deviation / math.sqrt(len(deviation))
    mean = graph.parameters[0][where]
    return Tuning(graph, initial_distribution(mean, deviation, MOST_FULL), scenarios, toll, alone)


def _parameters(graph: Graphs, actions: ActionSet) -> Tensor:
    """(n,) the parameters of a graph that can be tuned."""
    return graph.parameters[0][tunable(graph, actions)]


def calmed(graph: Graphs, actions: ActionSet) -> Graphs:
    """A random graph without its parameters if there are many, which chance has not chosen well."""
    if int(tunable(graph, actions).sum()) < FEW:
        return graph
    return replace(graph, parameters=torch.zeros_like(graph.parameters))


def update(
    tunings: Sequence[Tuning],
    actions: ActionSet,
    fresh: Fresh,
    generator: Generator,
    most: int = MOST,
) -> list[tuple[Tuning, bool]]:
    """The tunings after one update each, by samples that all meet the same fresh scenarios.

    Of many parameters, variances only are learned, and each sample tells of few of them. There as
    many samples are divided among several small updates that follow one another, unless a rollout
    of all samples takes hardly longer. They count as one.

    If luck hides what differs between samples, the next update has more scenarios, up to `most`.
    Where steps are what costs, most updates have truncated episodes (`improvement.horizon`).
    With each tuning is returned whether the values of its samples were `mainly_lengths`.
    """
    divides = not fresh.pace.together and all(each.apart for each in tunings)
    parts = PARTS if divides else 1
    whole = any(each.horizon.whole for each in tunings)
    found = [(each, False) for each in tunings]
    for _ in range(parts):
        after = [tuning for tuning, _ in found]
        found = _updated(after, actions, fresh, generator, whole, most, parts)
    return [(new.counted(old), long) for old, (new, long) in zip(tunings, found, strict=True)]


def _updated(
    tunings: Sequence[Tuning],
    actions: ActionSet,
    fresh: Fresh,
    generator: Generator,
    whole: bool,
    most: int,
    parts: int,
) -> list[tuple[Tuning, bool]]:
    """The tunings after an update by one of so many parts of the samples, whole or truncated."""
    drawn = [_samples(each, parts, generator) for each in tunings]
    graphs = [
        with_parameters(each.graph, tunable(each.graph, actions), rows)
        for each, rows in zip(tunings, drawn, strict=True)
    ]
    nodes = max(each.capacity for each in graphs)
    every = concatenate([widened(each, nodes) for each in graphs])
    scenarios = max(each.scenarios for each in tunings)
    starts = max(each.horizon.starts for each in tunings)
    before = max(each.horizon.steps for each in tunings)
    counts, about = [len(x) for x in drawn], (fresh, every, actions)
    if not whole:
        some = played_until(before, *about, fresh.world(max(scenarios, starts), generator))
        rows = zip(tunings, drawn, some.split(counts), strict=True)
        return [(_after_truncated(*row, most, parts), False) for row in rows]
    ranked = played = played_until(math.inf, *about, fresh.world(scenarios, generator), before)
    if starts > scenarios:
        others = played_until(before, *about, fresh.world(starts - scenarios, generator))
        ranked = played.until(before).beside(others)
    each = zip(tunings, drawn, played.split(counts), ranked.split(counts), strict=True)
    return [_after_whole(*row, most) for row in each]


def _samples(tuning: Tuning, parts: int, generator: Generator) -> Tensor:
    """(λ, n) parameters, one of so many parts of what is usual."""
    count = max(SAMPLES, usual_count(len(tuning.distribution.mean))) // parts
    return sampled(tuning.distribution, count, generator)


def _after(tuning: Tuning, drawn: Tensor, ranked: Played, values: Tensor, most: int) -> Tuning:
    """A tuning after samples (λ, n) are ranked, with more scenarios if luck is in values (λ, B)."""
    distribution = updated(tuning.distribution, drawn, ranked.worth(tuning.toll))
    need = Need(tuning.scenarios, tuning.reliability).after(values, most)
    scenarios = max(tuning.scenarios, need.scenarios)
    return replace(
        tuning, distribution=distribution, scenarios=scenarios, reliability=need.reliability
    )


def _after_truncated(
    tuning: Tuning, drawn: Tensor, played: Played, most: int, parts: int
) -> Tuning:
    """A tuning after samples (λ, n), one of so many parts, have played up to its horizon."""
    after = _after(tuning, drawn, played, played.values[:, : tuning.scenarios], most)
    horizon = tuning.horizon.truncated(played, flat(played.values), 1 / parts)
    return replace(after, horizon=horizon)


def _after_whole(
    tuning: Tuning, drawn: Tensor, played: Played, ranked: Played, most: int
) -> tuple[Tuning, bool]:
    """A tuning after samples (λ, n) have played whole episodes, and are ranked by these or less."""
    values = played.values
    after = _after(tuning, drawn, ranked, values, most)
    grown = WIDER if flat(values) else 1.0
    step = min(WIDEST, after.distribution.step * grown)
    upper = values.mean(1).sort(descending=True).values[: len(values) // 2]
    earlier = tuning.recent if tuning.horizon.steps == math.inf else ()
    after = replace(
        after,
        distribution=replace(after.distribution, step=step),
        recent=(*earlier, float(upper.mean()))[-RECENT:],
        horizon=tuning.horizon.chosen(played, tuning.toll),
    )
    return after, mainly_lengths(values, played.lengths)


def flat(values: Tensor) -> bool:
    """Whether the best quarter of samples have the same values (P, B), so that steps are too small.

    On few scenarios all samples have to, as luck makes some alike. Hansen's program has such a
    rule, without scenarios (`cmaes.c`, https://github.com/CMA-ES/c-cmaes).
    """
    best = values[values.mean(1).argmax()]
    alike = int((values == best).all(1).sum())
    return alike >= (len(values) // 4 if values.shape[1] >= SEVERAL else len(values))


def mainly_lengths(values: Tensor, lengths: Tensor) -> bool:
    """Whether values (P, B) are mainly, but not wholly, the lengths (P, B) of episodes.

    These explain at least half of the variance of values, which grow with them, and leave some.
    """
    x, y = lengths.double().flatten(), values.double().flatten()
    x, y = x - x.mean(), y - y.mean()
    both, long, large = float(x @ y), float(x @ x), float(y @ y)
    return both > 0 and FIRM <= both * both / (long * large) <= EXACT


def with_parameters(graph: Graphs, where: Tensor, parameters: Tensor) -> Graphs:
    """A graph with other parameters (λ, n) at the entries `where` (N, K), as λ graphs."""
    many = graph[torch.zeros(len(parameters), dtype=torch.long)]
    changed = many.parameters.clone()
    changed[:, where] = parameters
    return replace(many, parameters=changed)
