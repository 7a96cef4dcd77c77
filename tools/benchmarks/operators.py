"""Crossover and mutation of a whole population against the same on networkx graphs."""

from functools import partial
from random import Random

import torch
from torch import Tensor

from benchmarks.measure import (
    WALL,
    Comparison,
    DisagreementError,
    Effort,
    Line,
    cores,
    in_turns,
    run_threads,
)
from benchmarks.networkx_operators import Individual, Kinds, individuals, kinds_of
from benchmarks.networkx_operators import offspring as networkx_offspring
from benchmarks.workload import CAPACITY, later_population, populations, workload
from cgtorch.evolution import Population
from cgtorch.evolution.operators import offspring
from cgtorch.graphs import ActionSet, Graphs, concatenate, from_networkx, valid

PAIRS = 200  # that networkx is asked for
MANY = 10_000
ERRORS = 5.0  # standard errors that the means of two samples of children may differ


def operators_vs_networkx(effort: Effort) -> Line:
    """Children per second, crossover and mutation together."""
    work = workload()
    with run_threads(cores()):
        parts = tuple(
            _compared(population, work.actions, label, effort)
            for label, population in {**populations(), "later": later_population(MANY)}.items()
        )
    return Line(
        name="operators_vs_networkx",
        compared=f"crossover and mutate, seconds per child of a population / per child of {PAIRS} "
        "pairs of networkx graphs, same operators in plain Python",
        unit="x faster",
        target=100.0,
        clock="wall",
        threads=cores(),
        parts=parts,
    )


def _compared(population: Population, actions: ActionSet, label: str, effort: Effort) -> Comparison:
    generator, random = torch.Generator().manual_seed(5), Random(5)  # noqa: S311
    few, half = 2 * PAIRS, len(population) // 2
    parents, kinds = individuals(population[:few], actions), kinds_of(actions)
    batched = partial(children, population, actions, generator)
    one_by_one = partial(networkx_children, parents, kinds, random)
    gap = apart(
        statistics_of(children(population[:few], actions, generator).graphs, actions),
        statistics_of(as_graphs(one_by_one(), actions), actions),
    )
    ours, other = in_turns([batched, one_by_one], effort.repeats, WALL, calls=[10, 1])
    mine, theirs = 2 * half / ours.median, few / other.median
    return Comparison(
        label=f"{label}, {len(population)}",
        ours=ours,
        other=other,
        ratio=mine / theirs,
        difference=None,
        sizes={
            "children": 2 * half,
            "children of the other": few,
            "children_per_second": mine,
            "children_per_second of the other": theirs,
            "largest difference of two means, standard errors": gap,
        },
        note=f"{mine:.3g} / {theirs:.3g} children/s",
    )


def children(population: Population, actions: ActionSet, generator: torch.Generator) -> Population:
    """Two children of each pair of one from the first half and one from the second."""
    parents = torch.arange(len(population) // 2 * 2)
    return offspring(population, parents[:0], parents, actions, generator, CAPACITY)


def networkx_children(parents: list[Individual], kinds: Kinds, random: Random) -> list[Individual]:
    """The same of individuals that are networkx graphs."""
    half = len(parents) // 2
    pairs = zip(parents[:half], parents[half:], strict=True)
    return [child for pair in pairs for child in networkx_offspring(*pair, kinds, CAPACITY, random)]


def as_graphs(individuals: list[Individual], actions: ActionSet) -> Graphs:
    """Networkx graphs as tensors.

    Raises:
        DisagreementError: one of them is not valid.
    """
    graphs = concatenate([from_networkx(i.graph, actions, CAPACITY) for i in individuals])
    if not bool(valid(graphs, actions).all()):
        raise DisagreementError("a child that is a networkx graph is not valid; nothing was timed")
    return graphs


def statistics_of(graphs: Graphs, actions: ActionSet) -> Tensor:
    """(P, S) what is compared of children.

    Nodes, edges to the node itself, size of parameters, then nodes of each action.
    """
    itself = (graphs.edges == torch.arange(graphs.capacity)[:, None]).sum((1, 2))
    size = graphs.parameters.abs().clamp_max(10).sum((1, 2))
    each = [(graphs.action == a).sum(1) for a in range(len(actions))]
    return torch.stack([graphs.num_nodes, itself, size, *each], 1).double()


def apart(ours: Tensor, other: Tensor) -> float:
    """The largest difference of the means of two samples (n, S), in standard errors.

    Raises:
        DisagreementError: it is more than chance explains.
    """
    error = (ours.var(0) / len(ours) + other.var(0) / len(other)).sqrt()
    gap = float(((ours.mean(0) - other.mean(0)).abs() / error.clamp_min(1e-12)).max())
    if not gap <= ERRORS:
        raise DisagreementError(
            f"children differ by {gap:.1f} standard errors, more than {ERRORS:g}; nothing was timed"
        )
    return gap
