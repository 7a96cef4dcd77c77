"""Horizons: samples are compared by their returns up to a horizon, where that suffices.

Most of an episode often tells little of which samples are better. So only some updates play whole
episodes. They choose the horizon of the next ones: the shortest up to which returns would have
selected samples that are worth almost as much. The steps that are saved pay for further updates,
and for further starts in each of them, as a sample that fails on few of them is lucky on one.
(Arza, Le Goff and Hart, "Generalized Early Stopping in Evolutionary Direct Policy Search", ACM
TELO, 2024, end each episode by itself.)
"""

from dataclasses import dataclass, replace
from math import ceil, inf

import torch
from torch import Tensor

from cgtorch.evolution.cma import recombination_weights
from cgtorch.evolution.fitness import WORST
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import Environment, Rewarded
from cgtorch.improvement.paired_race import Fresh, what_counts
from cgtorch.improvement.truncated import truncated

HORIZONS = tuple(2**k for k in range(4, 14))  # steps in the world
KEPT = 0.8  # share of the usual gain that selection by truncated episodes has to have
USUAL = 0.9  # share of it that is remembered where samples differ less
LENGTHS = 2.0  # of a horizon at least, in units of the mean length of episodes that ended early
SHORT = 1 / 4  # of the longest episode, if most samples end earlier
SHORTEST = 1 / 16  # of the longest episode, as shorter ones save little beside whole ones
BETWEEN = 4  # updates with truncated episodes at least, between two with whole ones
PAID, MOST_STARTS = 1 / 4, 16  # what the starts of an update cost, in units of a whole episode


@dataclass(frozen=True)
class Played:
    """What P graphs got on B scenarios.

    Attributes:
        values: (P, B) what counts: whether they succeed, or returns up to the horizon.
        lengths: (P, B) the transitions of their episodes.
        steps: (P, B) steps in the world; 0 where they are not counted.
        early: (P, B, H + 1) returns up to each of `HORIZONS`, and to the horizon before, if
            episodes were whole, else (P, B, 0).
    """

    values: Tensor
    lengths: Tensor
    steps: Tensor
    early: Tensor

    def split(self, counts: list[int]) -> list["Played"]:
        """Those of so many graphs each."""
        parts = (x.split(counts) for x in (self.values, self.lengths, self.steps, self.early))
        return [Played(*each) for each in zip(*parts, strict=True)]

    def worth(self, toll: float) -> Tensor:
        """(P,) mean values, from which a toll is taken for each transition."""
        return (self.values - toll * self.lengths).mean(1)

    def early_worth(self, toll: float) -> Tensor:
        """(P, H) the same of episodes up to each of `HORIZONS`."""
        marks = torch.tensor(HORIZONS).to(self.early)
        shares = (marks / self.steps[..., None]).clamp_max(1)
        return (self.early[..., : len(HORIZONS)] - toll * self.lengths[..., None] * shares).mean(1)

    def until(self, horizon: float) -> "Played":
        """The same up to a horizon, whose returns are the last of the early ones.

        Episodes that have not ended, and have fewer steps, stay the worst.
        """
        share = (horizon / self.steps).clamp_max(1)
        steps = self.steps.clamp_max(horizon)
        stuck = (self.values <= WORST) & (self.steps < horizon)
        values = torch.where(stuck, self.values, self.early[..., -1])
        return Played(values, self.lengths * share, steps, self.early[..., :0])

    def beside(self, others: "Played") -> "Played":
        """Those on other scenarios, too."""
        names = "values", "lengths", "steps"
        both = (torch.cat([getattr(self, name), getattr(others, name)], 1) for name in names)
        values, lengths, steps = both
        return Played(values, lengths, steps, values.new_zeros(*values.shape, 0))


@dataclass(frozen=True)
class Horizon:
    """How far the episodes of the next updates are played, and on how many starts.

    Attributes:
        steps: Steps after which episodes are truncated; inf if they have to be whole.
        starts: Number of starts, if that is more than an update has scenarios.
        gain: What selection usually gains in an update with whole episodes.
        cost: Steps of a sample in the last update with whole episodes.
        since: Steps of a sample in the updates since then.
        updates: Their number.
    """

    steps: float = inf
    starts: int = 1
    gain: float = 0.0
    cost: float = 0.0
    since: float = 0.0
    updates: float = 0.0

    @property
    def whole(self) -> bool:
        """Whether it is time for an update with whole episodes."""
        enough = self.updates >= BETWEEN and self.since >= self.cost
        return self.steps == inf or enough

    def truncated(self, played: Played, alike: bool, share: float) -> "Horizon":
        """The one after so large a share of an update up to it, in which samples may be alike."""
        since = self.since + share * float(played.steps.sum(1).mean())
        after = replace(self, since=since, updates=self.updates + share)
        return replace(after, steps=inf, starts=1) if alike else after

    def chosen(self, played: Played, toll: float) -> "Horizon":
        """The one that later episodes need, after an update with whole ones.

        While most samples end early, and under a toll, which is there because most do, it is at
        least twice as long as these. Otherwise nothing was known of samples that end later than
        usual (Salimans et al., "Evolution strategies as a scalable alternative to reinforcement
        learning", 2017, section 2.1). It is at least half of what was played before, and a
        sixteenth of the longest episode, as few samples may agree by chance.
        """
        if not played.early.shape[2]:
            return self
        longest, usual = float(played.steps.max()), float(played.steps.mean())
        ended = played.steps[played.steps < longest]
        stretched = len(ended) > 0 and (toll > 0 or usual < SHORT * longest)
        least = LENGTHS * float(ended.mean()) if stretched else 0.0
        values, needed = played.worth(toll), inf
        most = selection_gain(values, values)
        gain = max(most, USUAL * self.gain)
        early = played.early_worth(toll).unbind(1)
        for horizon, seen in reversed(list(zip(HORIZONS, early, strict=True))):
            if most - selection_gain(seen, values) > (1 - KEPT) * gain or gain <= 0:
                break
            needed = horizon
        steps = max(needed, least, SHORTEST * longest, min(self.steps, longest) / 2)
        starts = min(MOST_STARTS, max(1, int(PAID * usual / steps)))
        return Horizon(steps, starts, gain, float(played.steps.sum(1).mean()))


def selection_gain(seen: Tensor, values: Tensor) -> float:
    """What selection gains in values (P,) if it goes by what is seen (P,).

    That is the weighted mean of the better half over the mean of all.
    """
    weights = recombination_weights(len(values))
    chosen = values[seen.argsort(descending=True, stable=True)[: len(weights)]]
    return float(weights @ chosen - values.mean())


def played_until(
    horizon: float,
    fresh: Fresh,
    graphs: Graphs,
    actions: ActionSet,
    world: Environment,
    before: float = inf,
) -> Played:
    """What P graphs get on all B scenarios of a world, in episodes up to a horizon (steps, or inf).

    Of whole ones, returns up to a horizon `before` are the last of the early ones.
    Without rewards, and where steps are not what costs, all episodes are whole.
    """
    if fresh.pace.together or not isinstance(world, Rewarded):
        runs = fresh.runs(graphs, actions, world)
        added = runs.state.new_zeros(*runs.transitions.shape, 1)
    else:
        last = HORIZONS[-1] if before == inf else ceil(before)
        marks = (*HORIZONS, last) if horizon == inf else ()
        place = truncated(world, horizon, marks)
        runs = fresh.runs(graphs, actions, place)
        added = place.added(runs.state)
    values, early = (
        torch.nan_to_num(each, nan=WORST).clamp_min(WORST).double()
        for each in (what_counts(runs), added[..., 1:])
    )
    return Played(values, runs.transitions, added[..., 0].double(), early)
