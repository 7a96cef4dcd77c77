"""Rollouts of the batched engine, beside other implementations of the same work."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from benchmarks import paper_way as paper
from benchmarks import strong_cpu as strong
from benchmarks.measure import (
    WALL,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    Timing,
    cores,
    in_turns,
    run_threads,
    torch_threads,
)
from benchmarks.plain_models import plain_models
from benchmarks.tensor_way import tensor_rollout
from benchmarks.workload import Workload, populations, workload
from cgtorch.graphs import Graphs
from cgtorch.simulation import MAX_TRANSITIONS, Rollouts, rollout

PAPER_SAMPLE = 40  # individuals that run the paper's way, half of them in a quick run
QUICK_SAMPLE = 100  # individuals that run the strong CPU way in a quick run
CLOSE = 0.01  # m: networks turn the rounding of float32 into more with each of twenty motions
EQUAL = 0.999
"""The share of lanes that must end equally: another order of arithmetic changes some decisions."""

Way = Callable[[], tuple[Any, Any, Any]]
"""Success, last percepts and transitions of some individuals on all scenarios."""

Case = Callable[[Workload, Graphs, str, Effort], Comparison]


def paper_way(effort: Effort) -> Line:
    """A state machine that takes one row at a time, with scikit-learn's SVR and SVC."""
    return _line(
        "paper_way",
        f"transitions per second, a population / {PAPER_SAMPLE} of its individuals (quick: half of "
        "them) one row at a time in a state machine with sklearn's SVR and SVC, same support "
        "vectors, one thread",
        1000.0,
        _paper_way,
        effort,
    )


def strong_cpu(effort: Effort) -> Line:
    """NumPy over scenarios, scikit-learn's batched predictions, a process per core."""
    return _line(
        "strong_cpu",
        "transitions per second, a population / the same (quick: "
        f"{QUICK_SAMPLE} of its individuals), NumPy and sklearn batched over the scenarios of each "
        "individual, a process per core",
        40.0,
        _strong_cpu,
        effort,
    )


def tensor_way(effort: Effort) -> Line:
    """Every action for every lane at every step, chosen by torch.where."""
    return _line(
        "tensor_way",
        "rollouts of a population / the same, every action computed for every lane, torch.where, "
        "no early exit, with the same Γ and C",
        5.0,
        _tensor_way,
        effort,
    )


def _line(name: str, compared: str, target: float, case: Case, effort: Effort) -> Line:
    work = workload()
    with run_threads(cores()):
        parts = tuple(
            case(work, population.graphs, label, effort)
            for label, population in populations().items()
        )
    return Line(name, compared, "x faster", target, "wall", cores(), parts)


def _paper_way(work: Workload, graphs: Graphs, label: str, effort: Effort) -> Comparison:
    simulation, b = paper.Simulation(plain_models(work)), work.environment.num_scenarios

    def works_on(some: Graphs) -> Way:
        machines = paper.state_machines(some, work.actions)
        return partial(paper.run_all, simulation, machines, b, MAX_TRANSITIONS)

    return _sampled(work, graphs, works_on, int(PAPER_SAMPLE * effort.size), label, effort)


def _strong_cpu(work: Workload, graphs: Graphs, label: str, effort: Effort) -> Comparison:
    count = cores()
    with strong.processes(plain_models(work), count) as pool:

        def works_on(some: Graphs) -> Way:
            arrays = strong.array_graphs(some, work.actions)
            return partial(strong.run_all, pool, count, arrays, MAX_TRANSITIONS)

        size = len(graphs) if effort.size == 1 else QUICK_SAMPLE
        return _sampled(work, graphs, works_on, size, label, effort)


def _sampled(
    work: Workload,
    graphs: Graphs,
    works_on: Callable[[Graphs], Way],
    size: int,
    label: str,
    effort: Effort,
) -> Comparison:
    """The engine on all individuals, the slow way on a random sample; compared are rates."""
    pick = torch.randperm(len(graphs), generator=torch.Generator().manual_seed(4))[:size]
    engine = partial(rollout, graphs, work.actions, work.environment)
    slowly, runs = works_on(graphs[pick]), engine()
    gap, differ = alike(taken(runs, pick), *slowly())
    ours, other = in_turns([engine, slowly], effort.repeats, WALL, warm_up=0)
    return _comparison(label, runs, ours, other, gap, differ, pick)


def _tensor_way(work: Workload, graphs: Graphs, label: str, effort: Effort) -> Comparison:
    engine = partial(rollout, graphs, work.actions, work.environment)

    def everything() -> Rollouts:
        with torch_threads(cores()):
            return tensor_rollout(graphs, work.actions, work.environment, MAX_TRANSITIONS)

    runs, others = engine(), everything()
    gap, differ = alike(runs, others.succeeded, others.percept, others.transitions)
    ours, other = in_turns([engine, everything], effort.repeats, WALL, warm_up=0)
    return _comparison(label, runs, ours, other, gap, differ)


def alike(runs: Rollouts, succeeded: Any, percept: Any, transitions: Any) -> tuple[float, float]:
    """Compare the engine's rollouts with others, given as arrays or tensors of the same shapes.

    Returns:
        The largest difference (m) of last percepts of lanes that end alike, and the share
        of lanes that do not.

    Raises:
        DisagreementError: more than one lane in a thousand does not.
    """
    away = (torch.as_tensor(percept).double() - runs.percept.double()).abs().amax(-1)
    same = torch.as_tensor(succeeded) == runs.succeeded
    same &= (torch.as_tensor(transitions) == runs.transitions) & (away <= CLOSE)
    share = float(same.double().mean())
    if not share >= EQUAL:
        raise DisagreementError(
            f"only {share:.2%} of the lanes end alike, fewer than {EQUAL:.1%}; nothing was timed"
        )
    return float(away[same].max()), 1 - share


def taken(runs: Rollouts, rows: Tensor) -> Rollouts:
    """The rollouts of some individuals."""
    parts = {n: x[rows] if isinstance(x, Tensor) else x for n, x in vars(runs).items()}
    return Rollouts(**parts)


def _comparison(
    label: str,
    runs: Rollouts,
    ours: Timing,
    other: Timing,
    gap: float,
    differ: float,
    pick: Tensor | None = None,
) -> Comparison:
    """A case where the other side ran all individuals, or only those of `pick`."""
    (p, b), done = runs.succeeded.shape, int(runs.transitions.sum())
    theirs = done if pick is None else int(runs.transitions[pick].sum())
    rates = done / ours.median, theirs / other.median
    return Comparison(
        label=f"{label}, {p} x {b}",
        ours=ours,
        other=other,
        ratio=rates[0] / rates[1],
        difference=gap,
        sizes={
            "population": p,
            "scenarios": b,
            "transitions": done,
            "transitions of the other": theirs,
            "individuals of the other": p if pick is None else len(pick),
            "executed_per_second": runs.executed / ours.median,
            "transitions_per_second, endless loops counted": rates[0],
            "transitions_per_second of the other": rates[1],
            "share of lanes that end otherwise": differ,
            "share of lanes that succeed": float(runs.succeeded.double().mean()),
        },
        note=f"{runs.executed / ours.median:.3g} executed transitions/s",
    )
