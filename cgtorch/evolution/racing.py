"""Races: individuals run on few scenarios, and the better half of them on more.

This is successive halving (Jamieson & Talwalkar, "Non-stochastic best arm identification and
hyperparameter optimization", AISTATS 2016), for worlds in which each rollout takes its time.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.evolution.fitness import WORST, Evaluation, Evaluator, evaluator
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import Environment, Rewarded

FEWEST = 2  # individuals that run on all scenarios

MakeEvaluator: TypeAlias = Callable[..., Evaluator]
"""Makes the evaluation of individuals, `evaluator` or `race`, from the arguments of `evaluator`."""


def race(actions: ActionSet, environment: Environment, keep: Tensor, **about: Any) -> Evaluator:
    """An evaluation in which half the individuals leave before each doubling of the scenarios.

    All run on the first scenario, the better half of them on the second, the better half of these
    on two more, and so on; where nobody has solved anything, only the best goes on. Who has solved
    everything so far stays, and so does the first individual, which is the best one of earlier
    generations. Where an individual has not run, it has not succeeded, and its score is 0, or
    `WORST` with rewards. With some of W (`keep` (B,) bool) there is no race. For the
    arguments see `cgtorch.evolution.fitness.evaluator`.
    """
    if keep.any() or len(keep) < 2:
        return evaluator(actions, environment, keep, **about)
    legs = [
        (rows, evaluator(actions, environment, keep[rows], scenarios=rows, **about))
        for rows in _doubling(len(keep), keep.device)
    ]
    least = WORST if isinstance(environment, Rewarded) else 0.0

    def evaluation(graphs: Graphs) -> Evaluation:
        home, count = graphs.start.device, len(graphs)
        scores = torch.full((count, len(keep)), least, device=home)
        succeeded = torch.zeros_like(scores, dtype=torch.bool)
        alive, counts = torch.arange(count, device=home), [0, 0, 0]
        last, ran = 0, 0
        for rows, evaluate in legs:
            if ran:
                better = scores[alive, :ran].mean(1).argsort(descending=True, stable=True)
                stays = succeeded[alive, :ran].all(1)
                solved = bool(succeeded[alive, last:ran].any())
                stays[better[: max(FEWEST, len(alive) // 2) if solved else 1]] = True
                stays[0] = True
                alive = alive[stays]
            found = evaluate(graphs[alive])
            scores[alive[:, None], rows.to(home)] = found.scores
            succeeded[alive[:, None], rows.to(home)] = found.succeeded
            last, ran = ran, ran + len(rows)
            more = found.transitions, found.executed, found.not_finite
            counts = [a + b for a, b in zip(counts, more, strict=True)]
        return Evaluation(scores.mean(1), scores, succeeded, *counts)

    return evaluation


def _doubling(count: int, device: torch.device) -> list[Tensor]:
    """Indices of 1, 1, 2, 4, ... scenarios, `count` in all."""
    ends = [1]
    while ends[-1] < count:
        ends.append(min(2 * ends[-1], count))
    begins = [0, *ends[:-1]]
    return [torch.arange(a, b, device=device) for a, b in zip(begins, ends, strict=True)]
