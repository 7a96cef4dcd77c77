"""Horizons: samples are compared by their returns up to a horizon, where that suffices.

Most of an episode often tells little of which samples are better. So only some updates play whole
episodes. They choose the horizon of the next ones: the shortest up to which returns would have
selected samples that are worth almost as much. The steps that are saved pay for further updates.
(Arza, Le Goff and Hart, "Generalized Early Stopping in Evolutionary Direct Policy Search", ACM
TELO, 2024, end each episode by itself.)
"""

from dataclasses import dataclass
from math import inf

import torch
from torch import Tensor

from cgtorch.evolution.cma import recombination_weights
from cgtorch.evolution.fitness import WORST
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import Environment, Rewarded
from cgtorch.improvement.paired_race import Fresh, what_counts
from cgtorch.improvement.truncated import truncated

HORIZONS = tuple(2**k for k in range(4, 14))  # steps in the world
KEPT = 0.8  # share of selection's gain that selection by truncated episodes has to have
LENGTHS = 2.0  # of a horizon at least, in units of the mean length of episodes that ended early
SHORTEST = 1 / 8  # of the longest episode, as shorter ones save little beside whole ones


@dataclass(frozen=True)
class Played:
    """What P graphs got on B scenarios.

    Attributes:
        values: (P, B) what counts: whether they succeed, or returns up to the horizon.
        lengths: (P, B) the transitions of their episodes.
        steps: (P, B) steps in the world; 0 where they are not counted.
        early: (P, B, H) returns up to each of `HORIZONS` if episodes were whole, else (P, B, 0).
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

    def horizon(self, before: float, toll: float) -> float:
        """The horizon that later episodes need, after an earlier one; inf if they have to be whole.

        It is at least twice as long as episodes that ended early, as else nothing was known of
        samples that end later than usual (Salimans et al., "Evolution strategies as a scalable
        alternative to reinforcement learning", 2017, section 2.1). It is at least half of what was
        played before, and an eighth of the longest episode, as few samples may agree by chance.
        """
        if not self.early.shape[2]:
            return inf
        longest = float(self.steps.max())
        ended = self.steps[self.steps < longest]
        least = LENGTHS * float(ended.mean()) if len(ended) else 0.0
        shares = (torch.tensor(HORIZONS) / self.steps[..., None].clamp_min(1)).clamp_max(1)
        early = (self.early - toll * self.lengths[..., None] * shares).mean(1)
        needed = inf
        for horizon, seen in reversed(list(zip(HORIZONS, early.unbind(1), strict=True))):
            if selected_gain(seen, self.worth(toll)) < KEPT:
                break
            needed = horizon
        return max(needed, least, SHORTEST * longest, min(before, longest) / 2)


def selected_gain(seen: Tensor, values: Tensor) -> float:
    """The share of selection's gain in values (P,) that is left if it goes by what is seen (P,).

    Selection gains the weighted mean of the better half over the mean of all. The share is 0 where
    nothing can be gained.
    """
    weights = recombination_weights(len(values))
    most = weights @ values.sort(descending=True).values[: len(weights)] - values.mean()
    chosen = values[seen.argsort(descending=True, stable=True)[: len(weights)]]
    return float((weights @ chosen - values.mean()) / most) if most > 0 else 0.0


def played_until(
    horizon: float, fresh: Fresh, graphs: Graphs, actions: ActionSet, world: Environment
) -> Played:
    """What P graphs get on all B scenarios of a world, in episodes up to a horizon (steps, or inf).

    Without rewards, and where steps are not what costs, all episodes are whole.
    """
    if fresh.pace.together or not isinstance(world, Rewarded):
        runs = fresh.runs(graphs, actions, world)
        added = runs.state.new_zeros(*runs.transitions.shape, 1)
    else:
        place = truncated(world, horizon, HORIZONS if horizon == inf else ())
        runs = fresh.runs(graphs, actions, place)
        added = place.added(runs.state)
    values = torch.nan_to_num(what_counts(runs), nan=WORST).clamp_min(WORST).double()
    return Played(values, runs.transitions, added[..., 0].double(), added[..., 1:].double())
