"""The genetic operators in C (`cgtorch/native/engine`), one individual at a time.

The operators in torch run instead if there is no compiler, or if the sizes or types of the graphs
are not supported in C. Both give the same children, bit for bit.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

import torch
from torch import Tensor

from cgtorch.evolution.population import STRATEGY, Population, bounds, spread
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground import counter_rng
from cgtorch.ground.counter_rng import quantiles
from cgtorch.native import NO_PARENT, constants, function, structure, threads
from cgtorch.native.interface import agree


def takes(graphs: Graphs, parameters: Tensor, slots: int = 0) -> bool:
    """Whether the compiled operators support these graphs, parameter types and numbers of slots."""
    _, n, o = graphs.edges.shape
    return (
        function("perturb_parameters", parameters.dtype) is not None
        and function("breed", torch.float32) is not None
        and within_limits(max(n, slots), o)
        and all(is_whole(x) for x in (graphs.action, graphs.edges, graphs.start))
    )


def within_limits(nodes: int, outcomes: int) -> bool:
    """Whether the compiled operators support graphs with so many nodes and outcomes."""
    limits = _limits()
    return nodes <= limits["MOST_NODES"] and outcomes <= limits["MOST_OUTCOMES"]


def is_whole(numbers: Tensor) -> bool:
    """Whether a tensor has the type of indices in compiled code: long, on the CPU."""
    return numbers.is_cpu and numbers.dtype == torch.long


def takes_scores(scores: Tensor) -> bool:
    """Whether compiled code can select parents by these scores."""
    return scores.device.type == "cpu" and function("lexicase", scores.dtype) is not None


def breed(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """See `cgtorch.evolution.offspring.breed`."""
    count, (_, n, o) = len(elite) + len(parents), population.graphs.edges.shape
    size, kinds = (count, min(n + 1, capacity)), 0 if actions is None else len(actions)
    sizes = size, (*size, o), (*size, 1), size[:1]
    room = Graphs(*(torch.empty(each, dtype=torch.long) for each in sizes))
    strategy, first = torch.empty(count, len(STRATEGY)), torch.zeros(kinds + 1, dtype=torch.long)
    given = graphs_structure(population.graphs, None, n)
    breeding = structure("Breeding", torch.float32)(
        given=given, made=graphs_structure(room, room.parameters, capacity),
        elite=elite, parents=parents, strategy=population.strategy.float(),
        parent_strategy=strategy, has_edge=actions and actions.has_edge, first=first,
        standard=actions and actions.standard,
        individuals=len(population), elites=len(elite), pairs=len(parents) // 2, actions=kinds,
        pair_key=keys[0], key=keys[1], width=0,
    )  # fmt: skip
    _call("breed", torch.float32, breeding, threads())
    return _in_slots(room, breeding.made.nodes), strategy, first.tolist()


def perturb_parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    tau: float,
    same: int,
    key: int,
) -> tuple[Tensor, Tensor]:
    """See `cgtorch.evolution.parameters.perturb_parameters_in_torch`."""
    (p, n), k = graphs.action.shape, old.shape[2]
    made, drifted = old.new_empty(p, n, k), torch.empty(p, len(STRATEGY))
    children = structure("Children", old.dtype)(
        action=graphs.action, num_parameters=actions.num_parameters, origins=graphs.parameters,
        old=old, fresh=fresh, strategy=strategy.float(), standard=actions.standard, bounds=bounds(),
        quantiles=quantiles(), parameters=made, drifted=drifted, rows=p, nodes=n, most=k,
        actions=len(actions), same=same, key=key, spread=spread(tau),
    )  # fmt: skip
    _call("perturb_parameters", old.dtype, children, threads())
    return made, drifted


def deviation(scores: Tensor) -> Tensor:
    """See `cgtorch.evolution.selection.deviation`."""
    out = scores.new_empty(scores.shape[1])
    _call("deviation", scores.dtype, scores.contiguous(), *scores.shape, out, threads())
    return out


def lexicase(scores: Tensor, epsilon: Tensor, count: int, key: int) -> Tensor:
    """See `cgtorch.evolution.selection.parents`."""
    chosen, scores = torch.empty(count, dtype=torch.long), scores.contiguous()
    task = scores, *scores.shape, epsilon.contiguous(), key, count, chosen, threads()
    _call("lexicase", scores.dtype, *task)
    return chosen


def shuffled(count: int, key: int) -> Tensor:
    """A shuffled order, compiled if possible; see `cgtorch.ground.counter_rng.shuffled`."""
    if function("shuffled_order", torch.float32) is None:
        return counter_rng.shuffled(count, key)
    order = torch.empty(count, dtype=torch.long)
    _call("shuffled_order", torch.float32, count, key, order, threads())
    return order


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """See `cgtorch.evolution.selection.ranking`."""
    order, action = torch.empty(len(graphs), dtype=torch.long), graphs.action.contiguous()
    _call("ranking", fitness.dtype, fitness.contiguous(), action, *action.shape[::-1], order)
    return order


@cache
def _limits() -> Mapping[str, int]:
    agree(constants("strategy"), {name.upper(): i for i, name in enumerate(STRATEGY)})
    return constants("graph_limits")


def _call(name: str, dtype: torch.dtype, *arguments: Any) -> None:
    failure = function(name, dtype)(*arguments)
    if failure == NO_PARENT:
        raise IndexError("a parent is not in the population; choose indices from 0 to P - 1")
    if failure:
        raise MemoryError(f"no memory to run {name}")


def graphs_structure(graphs: Graphs, origins: Tensor | None, nodes: int) -> Any:
    """The `Graphs` of graph.h, with `nodes` slots per graph and `origins` at the nodes if given."""
    action, edges, start = (x.contiguous() for x in (graphs.action, graphs.edges, graphs.start))
    kind = structure("Graphs", torch.float32)
    sizes = {"nodes": nodes, "outcomes": edges.shape[2]}
    return kind(action=action, edges=edges, origins=origins, start=start, **sizes)


def _in_slots(room: Graphs, slots: int) -> Graphs:
    """The graphs with only their first `slots` slots, as views of the same memory."""
    if slots == room.capacity:
        return room
    p, _, o = room.edges.shape
    return Graphs(
        room.action.as_strided((p, slots), (slots, 1)),
        room.edges.as_strided((p, slots, o), (slots * o, o, 1)),
        room.parameters.as_strided((p, slots, 1), (slots, 1, 1)),
        room.start,
    )
