"""Races: individuals run on one scenario after the other, up to their first failure.

So most cost a single rollout, for worlds in which each rollout takes its time (Maron & Moore,
"Hoeffding races", NIPS 1994, with a failure as what decides).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cgtorch.evolution.fitness import WORST, Evaluation, Evaluator, evaluator
from cgtorch.graphs import ActionSet, Graphs, compacted
from cgtorch.ground.environment import Environment, Rewarded

WAVE = 4  # individuals that run side by side

MakeEvaluator: TypeAlias = Callable[..., Evaluator]
"""Makes the evaluation of individuals, `evaluator` or `race`, from the arguments of `evaluator`."""


@dataclass
class Runs:
    """What an individual has done: its scores, successes, and whether it ran, (B,) each."""

    scores: Tensor
    succeeded: Tensor
    ran: Tensor


def race(actions: ActionSet, environment: Environment, keep: Tensor, **about: Any) -> Evaluator:
    """An evaluation in which an individual leaves at its first failure, until one solves all.

    The first individual, which is the best one of earlier generations, meets the scenarios in their
    order. The others begin with that on which it has failed, `WAVE` individuals at once. Who fails
    there, too, but with a higher score, goes on with what the best one has solved. As soon as one
    has solved all scenarios, nobody else runs. What is known of an individual is not run again.
    Where an individual has not run, it has not succeeded, and its score is 0, or `WORST` with
    rewards. With some of W (`keep` (B,) bool) there is no race. For the arguments see
    `cgtorch.evolution.fitness.evaluator`.
    """
    if keep.any():
        return evaluator(actions, environment, keep, **about)
    alone = [
        evaluator(actions, environment, keep[row], scenarios=row, **about)
        for row in torch.arange(len(keep), device=keep.device).split(1)
    ]
    least = WORST if isinstance(environment, Rewarded) else 0.0
    known: dict[bytes, Runs] = {}

    def unknown(home: torch.device) -> Runs:
        scores = torch.full((len(keep),), least, device=home)
        no = torch.zeros_like(scores, dtype=torch.bool)
        return Runs(scores, no, no.clone())

    def evaluation(graphs: Graphs) -> Evaluation:
        home, names, counts = graphs.start.device, contents(graphs), torch.zeros(3).long()
        runs = [known.setdefault(name, unknown(home)) for name in names]

        def run(rows: Sequence[int], scenario: int) -> None:
            new = list({names[row]: row for row in rows if not runs[row].ran[scenario]}.values())
            if not new:
                return
            found = alone[scenario](graphs[torch.tensor(new, device=home)])
            for row, score, good in zip(new, found.scores, found.succeeded, strict=True):
                runs[row].scores[scenario], runs[row].ran[scenario] = score[0], True
                runs[row].succeeded[scenario] = good[0]
            counts.add_(torch.tensor([found.transitions, found.executed, found.not_finite]))

        best = runs[0]
        for scenario in range(len(keep)):
            run([0], scenario)
            if not best.succeeded[scenario]:
                break
        solved = best.succeeded.nonzero()[:, 0].tolist()
        order = [scenario, *(i for i in range(len(keep)) if i != scenario)]
        for begin in range(1, len(graphs), WAVE):
            if any(each.succeeded.all() for each in runs):
                break
            rows = list(range(len(graphs))[begin : begin + WAVE])
            run(rows, scenario)
            closer = [row for row in rows if best.scores[scenario] < runs[row].scores[scenario]]
            for where, some in ((order, rows), (solved, closer)):
                for each in where:
                    run(some, each)
                    some = [row for row in some if runs[row].succeeded[each]]
        scores = torch.stack([each.scores for each in runs])
        succeeded = torch.stack([each.succeeded for each in runs])
        return Evaluation(scores.mean(1), scores, succeeded, *counts.tolist())

    return evaluation


def contents(graphs: Graphs) -> list[bytes]:
    """What tells each graph apart, whatever the number of its free slots."""
    whole = compacted(graphs)
    tensors, counts = [x.cpu().numpy() for x in vars(whole).values()], whole.num_nodes.tolist()
    return [
        b"".join((x[row, :count] if x.ndim > 1 else x[row]).tobytes() for x in tensors)
        for row, count in enumerate(counts)
    ]
