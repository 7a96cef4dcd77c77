"""What a crossover and a mutation of one's own have to give."""

from collections.abc import Callable
from typing import TypeAlias

from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment.dry_run import expect, kind
from cgtorch.evolution.population import Population, expected_tensors
from cgtorch.graphs import check_graph, valid
from cgtorch.ground.errors import GraphError, SettingsError

Crossover: TypeAlias = Callable[[Population, Population, Generator], Population]
"""From Q first parents, Q second ones and the generator of all random choices to 2 Q children."""

Mutation: TypeAlias = Callable[[Population, ActionSet, Generator, float], Population]
"""From P individuals, what their nodes can do, the generator of all random choices and the variance
of the drift of strategy parameters to as many individuals.

Graphs come compacted, with one slot that is free in every graph; they may come back with more
slots, up to the capacity. What the start does not lead to must be pruned (`cgtorch.graphs.pruned`).
To add to what the library does, call `cgtorch.evolution.mutate` first."""


def check_offspring(
    offspring: object,
    count: int,
    capacity: int,
    actions: ActionSet,
    who: str = "crossover, mutation",
) -> None:
    """A SettingsError, which says `who`, unless these are so many valid individuals.

    The capacity is the most slots of a graph.
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
    for name, (shape, dtype) in expected_tensors(count, nodes, actions).items():
        expect(SettingsError, who, name, given[name], shape, dtype)
    if not (good := valid(graphs, actions)).all():
        bad = int((~good).nonzero()[0])
        try:
            check_graph(graphs[bad : bad + 1], actions)
        except GraphError as e:
            raise SettingsError(f"{who} made graph {bad} invalid: {e}") from e
