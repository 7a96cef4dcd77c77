"""Populations: graphs with self-adapted strategies, and checks of their tensors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.evolution.first_graphs import random_graphs
from cgtorch.graphs import (
    ActionSet,
    Graphs,
    check_graph,
    compacted,
    concatenate,
    resized,
    trimmed,
    valid,
    widened,
)
from cgtorch.ground.counter_rng import DRIFT, normal_from, words
from cgtorch.ground.dry_run import expect, kind
from cgtorch.ground.errors import GraphError, SettingsError
from cgtorch.ground.numerics import exp2

STRATEGY = (
    "crossover",
    "add_node",
    "delete_node",
    "new_start",
    "replace_node",
    "change_edge",
    "mutate_parameter",
    "sigma",
)
"""Strategy parameters: seven probabilities, and the step size of parameter mutations."""

INITIAL_STRATEGY = (0.5, 0.1, 0.1, 0.1, 0.1, 0.3, 0.2, 0.5)
TAU = 0.05  # variance of the drift in eq. 2
STRATEGY_MIN, PROBABILITY_MAX, SIGMA_MAX = 1e-3, 1.0, 10.0


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Population:
    """P individuals.

    Attributes:
        graphs: Their computational graphs.
        strategy: (P, S) float strategy parameters, in the order of `STRATEGY`.
    """

    graphs: Graphs
    strategy: Tensor

    def __len__(self) -> int:
        """The number of individuals."""
        return len(self.graphs)

    def to(self, device: torch.device | str) -> "Population":
        """The same individuals on another device."""
        return Population(self.graphs.to(device), self.strategy.to(device))

    def __getitem__(self, index: Tensor | slice) -> "Population":
        """The individuals at `index`."""
        return Population(self.graphs[index], self.strategy[index])


Crossover: TypeAlias = Callable[[Population, Population, Generator], Population]
"""Maps Q first parents, Q second ones, and the generator of all random choices to 2 Q children."""

Mutation: TypeAlias = Callable[[Population, ActionSet, Generator, float], Population]
"""Maps P individuals, their actions, the generator of all random choices, and the variance τ of the
drift in eq. 2 to P individuals.

The graphs come compacted, with one free slot in each. They may come back with more slots, up to the
capacity. Nodes that the start does not reach must be pruned (`cgtorch.graphs.pruned`). To add to
the library's mutations, call `cgtorch.evolution.mutate` first."""

FirstGraphs: TypeAlias = Callable[[int, ActionSet, int, tuple[int, int], Generator], Graphs]
"""Maps a number of graphs, their actions, the capacity, the fewest and most nodes before pruning,
and the generator of all random choices to that many valid, pruned graphs."""


def slim(population: Population) -> Population:
    """The same individuals, with only as many slots as the largest graph has nodes."""
    return Population(trimmed(population.graphs), population.strategy)


def initial_strategy(size: int, first: Sequence[float] = INITIAL_STRATEGY) -> Tensor:
    """(size, S) the initial strategy parameters."""
    return torch.tensor(first).repeat(size, 1)


def factors(keys: Tensor, tau: float) -> Tensor:
    """(P, S) the factors exp(N(0, τ)) of eq. 2, with variance τ, for individuals with keys (P,)."""
    random = words(keys[:, None], DRIFT + torch.arange(len(STRATEGY)))
    return exp2(normal_from(random) * torch.tensor(spread(tau)))


def spread(tau: float) -> float:
    """The standard deviation of the binary logarithm of the factors of eq. 2."""
    return tau**0.5 / math.log(2)


def drifted(strategy: Tensor, factors: Tensor) -> Tensor:
    """Eq. 2: (P, S) s ← s exp(N(0, τ)), clamped so that no rate becomes 0."""
    least, most = bounds()
    return torch.minimum(torch.maximum(strategy * factors, least), most)


@cache
def bounds() -> Tensor:
    """(2, S) the lower and the upper bound of each strategy parameter."""
    least, most = torch.full((2, len(STRATEGY)), STRATEGY_MIN).unbind()
    most.fill_(PROBABILITY_MAX)[STRATEGY.index("sigma")] = SIGMA_MAX
    return torch.stack([least, most])


def join(*parts: Population) -> Population:
    """One population of all individuals, with as many slots as the widest."""
    nodes = max(part.graphs.capacity for part in parts)
    graphs = concatenate([widened(part.graphs, nodes) for part in parts])
    return Population(graphs, torch.cat([p.strategy for p in parts]))


def random_population(
    size: int,
    actions: ActionSet,
    capacity: int,
    initial_nodes: tuple[int, int],
    generator: Generator,
    strategy: Sequence[float] = INITIAL_STRATEGY,
) -> Population:
    """Valid random graphs; the number of nodes before pruning is uniform within `initial_nodes`."""
    graphs = random_graphs(size, actions, capacity, initial_nodes, generator)
    return Population(widened(graphs, capacity), initial_strategy(size, strategy))


def seeded_population(
    size: int,
    seeds: Population,
    actions: ActionSet,
    capacity: int,
    initial_nodes: tuple[int, int],
    generator: Generator,
    strategy: Sequence[float] = INITIAL_STRATEGY,
) -> Population:
    """Half copies of the seeds in turn, half random (section IV-B).

    GraphError if a seed has more nodes than `capacity`.
    """
    half = size // 2
    about = actions, capacity, initial_nodes, generator, strategy
    fresh = random_population(size - half, *about)
    shape = (capacity, actions.outcome_capacity, actions.parameter_capacity)
    copies = seeds[torch.arange(half) % len(seeds)]
    return join(Population(resized(compacted(copies.graphs), *shape), copies.strategy), fresh)


def _expected_tensors(
    count: int, nodes: int, actions: ActionSet
) -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """Shapes and types of the tensors of `count` individuals with `nodes` slots, by name."""
    return {
        "action": ((count, nodes), torch.long),
        "edges": ((count, nodes, actions.outcome_capacity), torch.long),
        "parameters": ((count, nodes, actions.parameter_capacity), torch.float32),
        "start": ((count,), torch.long),
        "strategy": ((count, len(STRATEGY)), torch.float32),
    }


def population_from(tensors: dict[str, Tensor], actions: ActionSet) -> Population:
    """A population from untrusted tensors, such as those of a file, by field name.

    They are action (P, N), edges (P, N, O), parameters (P, N, K), start (P,) and strategy (P, S).
    GraphError if they do not make at least one valid graph.
    """
    p, n = (*tensors["action"].shape, 0, 0)[:2]
    expected = _expected_tensors(p, n, actions)
    graphs = Graphs(*(tensors[name] for name in list(expected)[:-1]))
    whole = (
        p * n > 0
        and all((tensors[name].shape, tensors[name].dtype) == e for name, e in expected.items())
        and bool(graphs.parameters.isfinite().all() and tensors["strategy"].isfinite().all())
        and bool(valid(graphs, actions).all())
    )
    if not whole:
        raise GraphError("these tensors are not those of valid graphs; restore the file")
    return Population(graphs, tensors["strategy"])


def check_offspring(
    offspring: object,
    count: int,
    capacity: int,
    actions: ActionSet,
    who: str = "crossover, mutation",
) -> None:
    """A SettingsError that names `who`, unless these are `count` valid individuals.

    The capacity is the largest number of slots of a graph.
    """
    if not isinstance(offspring, Population):
        raise SettingsError(f"{who} returned {kind(offspring)}; return a Population")
    graphs = offspring.graphs
    nodes = graphs.action.shape[1] if graphs.action.dim() == 2 else capacity
    if nodes > capacity:
        raise SettingsError(
            f"{who} returned graphs of {nodes} slots; return {capacity} at most, the capacity"
        )
    given: dict[str, Tensor] = {**vars(graphs), "strategy": offspring.strategy}
    for name, (shape, dtype) in _expected_tensors(count, nodes, actions).items():
        expect(SettingsError, who, name, given[name], shape, dtype)
    if not (good := valid(graphs, actions)).all():
        bad = int((~good).nonzero()[0])
        try:
            check_graph(graphs[bad : bad + 1], actions)
        except GraphError as e:
            raise SettingsError(f"{who} made graph {bad} invalid: {e}") from e
