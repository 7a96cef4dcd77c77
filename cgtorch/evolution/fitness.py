"""The fitness of eq. 3, and the interface for other fitness functions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground import distributed as ranks
from cgtorch.ground.environment import Environment, Lanes, Rewarded
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.numerics import row_means
from cgtorch.simulation import MAX_TRANSITIONS, Rollouts, most_steps, rollout
from cgtorch.simulation.gpu_engine import GpuEngine
from cgtorch.simulation.rollout import engine_of

Fitness: TypeAlias = Callable[[Rollouts, Tensor], Tensor]
"""Maps the rollouts of P graphs on B scenarios, and C(p_t) (P, B) at their ends, to their values
(P, B).

More is better. Without rewards, negative values count as 0, and an individual that loses W gets 0.
With rewards, values may be any numbers, and an individual that loses W gets `WORST`. Rows must not
influence one another, and equal arguments must give equal results."""

WORST = -1e30
"""The value of an episode that did not finish; it is finite, so differences can be computed."""

WORTHLESS = WORST / 1e9
"""Even the mean of a billion values is less than this only if one of them is `WORST`."""


@dataclass(frozen=True)
class ChanceOfSuccess:
    """Eq. 3: C(p_t), halved if the rollout did not end in success.

    With a `cost`, each transition takes this share of the value, until `LEAST` of it is left: of
    two skills that succeed equally, the one that asks less of a robot is fitter.
    """

    cost: float = 0.0

    def __call__(self, runs: Rollouts, probability: Tensor) -> Tensor:
        """The values (P, B) of rollouts with C(p_t) (P, B)."""
        value = torch.where(runs.succeeded, probability, probability / 2)
        return value * (1 - self.cost * runs.transitions.to(value)).clamp_min(LEAST)


COST, LEAST = 0.01, 0.2  # of a transition, by default; the smallest factor by transitions
chance_of_success = ChanceOfSuccess()
"""Eq. 3 as published."""


def episode_return(runs: Rollouts, probability: Tensor) -> Tensor:
    """(P, B) returns of episodes, -inf for unfinished ones; SettingsError without rewards."""
    if runs.returns is None:
        raise SettingsError(
            "fitness is episode_return, but the environment gives no rewards; implement over and "
            "returns (`cgtorch.ground.environment.Rewarded`), or use chance_of_success"
        )
    return runs.returns


@dataclass(frozen=True)
class Evaluation:
    """The results of P individuals on B scenarios.

    Attributes:
        fitness: (P,), the mean of the scores; with eq. 3 in [0, 1].
        scores: (P, B) values of the rollouts; all 0, or `WORST`, for an individual that loses W.
        succeeded: (P, B) bool; False where an individual was not run because it had lost W.
        transitions: Number of actions until the ends of all rollouts, those of endless loops
            included.
        executed: How many of these were actually executed; the rest of a loop is only counted.
        not_finite: Number of individuals with parameters, last percepts, C(p_t) or scores that are
            not finite. Their results do not count.
    """

    fitness: Tensor
    scores: Tensor
    succeeded: Tensor
    transitions: int
    executed: int
    not_finite: int = 0


MOST_LANES = 2**16
"""Rollouts that are evaluated at once. This bounds the memory: a rollout needs about 2 kB with the
actions of section VI."""


Evaluator: TypeAlias = Callable[[Graphs], Evaluation]
"""Evaluates P graphs in an environment."""
Parts: TypeAlias = tuple[Tensor, Tensor, Tensor, int, int, int]
"""The fields of an `Evaluation`."""


def evaluator(
    actions: ActionSet,
    environment: Environment,
    keep: Tensor,
    max_transitions: int = MAX_TRANSITIONS,
    most_lanes: int = MOST_LANES,
    group: ranks.Group | None = None,
    fitness: Fitness = chance_of_success,
    scenarios: Tensor | None = None,
) -> Evaluator:
    """The evaluation of eq. 3: 0 if a scenario of W fails, else the mean fitness of rollouts.

    An individual that fails a scenario of W is not run on the others.

    Args:
        actions: What nodes can do.
        environment: B scenarios.
        keep: (B,) bool, True for W and False for M, on the environment's device.
        max_transitions: Transitions after which a rollout fails.
        most_lanes: Number of rollouts at once (at least B); it does not change results.
        group: The ranks that share the individuals; all by default. Each gets all results.
        fitness: The value of a rollout in place of C(p_t).
        scenarios: (B,) long, the only scenarios on which individuals run, to which `keep` (B,) then
            belongs; all by default.

    No argument may be changed in place between two generations. Results come back to the device of
    the graphs.
    """
    engine, cost = None, 0.0
    if isinstance(fitness, ChanceOfSuccess) and scenarios is None:
        engine, cost = engine_of(actions, environment), fitness.cost
    size = max(1, most_lanes // max(1, len(keep)))
    order, kept = torch.argsort(~keep, stable=True), int(keep.sum())  # W first
    about = order, kept, max_transitions, most_steps(actions, max_transitions), cost
    where = torch.arange(len(keep), device=keep.device) if scenarios is None else scenarios

    def parts(graphs: Graphs) -> Parts:
        found = engine and engine.evaluation(graphs, *about)
        return found or _by_rollouts(
            graphs, actions, environment, keep, max_transitions, fitness, where
        )

    def evaluation(graphs: Graphs) -> Evaluation:
        p, mine = len(graphs), graphs[ranks.share(len(graphs), group)]
        # A GPU has the more threads at work the more there is to do, and needs no memory for it.
        whole = isinstance(engine, GpuEngine) and engine.evaluation(mine, *about)
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
    scenarios: Tensor,
) -> Parts:
    """An evaluation by `rollout`, for any fitness, actions, environment and device."""
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
        some, limit, where = graphs[alive], max_transitions, scenarios[part]
        runs = rollout(some, actions, environment, scenarios=where, max_transitions=limit)
        transitions[alive] += runs.transitions.sum(1)
        executed += runs.executed
        succeeded[alive[:, None], part] = runs.succeeded
        probability, real = last_success(runs, environment, where)
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
    """(P, B) C(p_t) where each lane ended, 0 if not finite; (P, B) whether all of it is finite."""
    p, b = runs.succeeded.shape
    percept, state = runs.percept.flatten(0, 1), runs.state.flatten(0, 1)
    nothing, steps = percept[:, :0], runs.transitions.flatten()
    where = scenarios.repeat(p), torch.zeros_like(steps)
    # Not started again, which can take long in a world.
    lanes = Lanes(percept, state, nothing, steps.bool(), nothing, *where)
    probability = environment.success(lanes)[1].view(p, b)
    finite = probability.isfinite() & runs.percept.isfinite().all(-1)
    return torch.where(finite, probability, 0.0).clamp(0, 1), finite
