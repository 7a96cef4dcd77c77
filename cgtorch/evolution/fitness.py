"""The fitness of eq. 3, or one of one's own in its place."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment, Lanes, Rewarded
from cgtorch.graphs import Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.numerics import row_means
from cgtorch.simulation import MAX_TRANSITIONS, Rollouts, most_steps, rollout
from cgtorch.simulation.engines import engine_of
from cgtorch.simulation.gpu_engine import GpuEngine

Fitness: TypeAlias = Callable[[Rollouts, Tensor], Tensor]
"""From how P graphs did on B scenarios, and C(p_t) (P, B) where each ended, to the worth (P, B) of
each. More is better. What is less than 0 counts as 0, which is what an individual gets that has
lost W; but where the environment gives rewards the worth may be any number, and who has lost W gets
`WORST`. Rows must not influence one another, and equal arguments must give equal results."""

WORST = -1e30
"""The worth of an episode that was not finished: finite, so that differences can be taken."""

WORTHLESS = WORST / 1e9
"""The mean of a billion worths is less than this only if one of them is `WORST`."""


def chance_of_success(runs: Rollouts, probability: Tensor) -> Tensor:
    """Eq. 3: C(p_t), and half of it where an individual has not come to an end with success."""
    return torch.where(runs.succeeded, probability, probability / 2)


def episode_return(runs: Rollouts, probability: Tensor) -> Tensor:
    """(P, B) returns of episodes, -inf where not finished; SettingsError without rewards."""
    if runs.returns is None:
        raise SettingsError(
            "fitness is episode_return, but the environment gives no rewards; implement over and "
            "returns (`cgtorch.environment.Rewarded`), or use chance_of_success"
        )
    return runs.returns


@dataclass(frozen=True)
class Evaluation:
    """What P individuals achieved.

    Attributes:
        fitness: (P,); of eq. 3 in [0, 1].
        scores: (P, B), what `fitness` is the mean of: what each run is worth, and all 0, or
            `WORST`, where W is lost.
        succeeded: (P, B) bool; False where an individual had already lost W and was not run.
        transitions: actions until the ends of all runs, also those of endless loops.
        executed: how many of them were executed, and not only counted.
        not_finite: individuals whose parameters, last percepts, C(p_t) or scores were not all
            finite; nothing of what they did counts.
    """

    fitness: Tensor
    scores: Tensor
    succeeded: Tensor
    transitions: int
    executed: int
    not_finite: int = 0


MOST_LANES = 2**16
"""Runs that are evaluated at once, which bounds the memory whatever the population: about 2 kB each
with the actions of section VI."""


Evaluator: TypeAlias = Callable[[Graphs], Evaluation]
"""What P individuals of an action set achieve in an environment."""

Parts: TypeAlias = tuple[Tensor, Tensor, Tensor, int, int, int]
"""Fields of an `Evaluation`."""


def evaluator(
    actions: ActionSet,
    environment: Environment,
    keep: Tensor,
    max_transitions: int = MAX_TRANSITIONS,
    most_lanes: int = MOST_LANES,
    group: ranks.Group | None = None,
    fitness: Fitness = chance_of_success,
) -> Evaluator:
    """Eq. 3: 0 where a scenario of W fails, else the mean of C(p_t) over all scenarios.

    Where an individual runs out of transitions, C(p_t) counts half, so that getting near is worth
    something and ending in success is worth more. W comes first: who fails there is not run on the
    rest. Another `fitness` says what a run is worth instead of C(p_t).

    Of the environment's scenarios `keep` (B,) bool are those of W and the others those of M.
    Rollouts run on its device, which must be the environment's; results come back to the graphs'.
    Of individuals times scenarios `most_lanes` run at once, B at least, which changes no result. A
    group of ranks (`cgtorch.ground.distributed`), all if not given, shares out the individuals, and
    each rank gets all results. No argument may change in place from one generation to the next.
    """
    engine = engine_of(actions, environment) if fitness is chance_of_success else None
    steps, size = most_steps(actions, max_transitions), max(1, most_lanes // max(1, len(keep)))
    order, kept = torch.argsort(~keep, stable=True), int(keep.sum())  # W first

    def parts(graphs: Graphs) -> Parts:
        found = engine and engine.evaluation(graphs, order, kept, max_transitions, steps)
        return found or _by_rollouts(graphs, actions, environment, keep, max_transitions, fitness)

    def evaluation(graphs: Graphs) -> Evaluation:
        p, mine = len(graphs), graphs[ranks.share(len(graphs), group)]
        # A GPU has the more threads at work the more there is to do, and needs no memory for it.
        whole = isinstance(engine, GpuEngine) and engine.evaluation(
            mine, order, kept, max_transitions, steps
        )
        begins = range(0, max(1, len(mine)), size)
        found = [whole] if whole else [parts(mine[i : i + size]) for i in begins]
        *tensors, transitions, executed, not_finite = zip(*found, strict=True)
        means, scores, succeeded = (
            ranks.all_gather(torch.cat(column) if column[1:] else column[0], p, group)
            for column in tensors
        )
        counts = (
            ranks.all_reduce(sum(each), group) for each in (transitions, executed, not_finite)
        )
        return Evaluation(means, scores, succeeded, *counts)

    return evaluation


def _by_rollouts(
    graphs: Graphs,
    actions: ActionSet,
    environment: Environment,
    keep: Tensor,
    max_transitions: int,
    fitness: Fitness,
) -> Parts:
    """Results of any fitness, actions, environment and device, from what `rollout` says."""
    p, b, home, device = len(graphs), len(keep), graphs.start.device, keep.device
    least = WORST if isinstance(environment, Rewarded) else 0.0
    graphs = graphs.to(device)
    score = torch.zeros(p, b, device=device)
    succeeded = torch.zeros_like(score, dtype=torch.bool)
    alive = torch.arange(p, device=device)
    finite = graphs.parameters.isfinite().flatten(1).all(1)
    transitions, executed = torch.zeros_like(alive), 0
    for part in (keep.nonzero()[:, 0], (~keep).nonzero()[:, 0]):
        if not len(part) or not len(alive):
            continue
        some, limit = graphs[alive], max_transitions
        runs = rollout(some, actions, environment, scenarios=part, max_transitions=limit)
        transitions[alive] += runs.transitions.sum(1)
        executed += runs.executed
        succeeded[alive[:, None], part] = runs.succeeded
        probability, real = last_success(runs, environment, part)
        worth = fitness(runs, probability).float()
        score[alive[:, None], part] = torch.nan_to_num(worth, neginf=least).clamp_min(least)
        finite[alive] &= (real & (worth.isfinite() | (worth == -torch.inf))).all(1)
        alive = alive[succeeded[alive][:, keep].all(1)]
    counts = torch.zeros_like(finite).index_fill_(0, alive, True) & finite
    score = torch.where(counts[:, None], score, least)
    results = row_means(score).to(home), score.to(home), (succeeded & finite[:, None]).to(home)
    return *results, int(transitions.sum()), executed, p - int(finite.sum())


def last_success(
    runs: Rollouts, environment: Environment, scenarios: Tensor
) -> tuple[Tensor, Tensor]:
    """(P, B) C(p_t) where each lane ended, 0 where not finite; (P, B) whether all is finite."""
    p, b = runs.succeeded.shape
    percept, state = runs.percept.flatten(0, 1), runs.state.flatten(0, 1)
    nothing, steps = percept[:, :0], runs.transitions.flatten()
    # Not started again, which can take long in a world.
    lanes = Lanes(
        percept, state, nothing, steps.bool(), nothing, scenarios.repeat(p), torch.zeros_like(steps)
    )
    probability = environment.success(lanes)[1].view(p, b)
    finite = probability.isfinite() & runs.percept.isfinite().all(-1)
    # What is not finite is worth nothing, and no other lane is the worse for it.
    return torch.where(finite, probability, 0.0).clamp(0, 1), finite
