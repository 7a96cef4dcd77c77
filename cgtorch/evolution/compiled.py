"""Operators in C (`cgtorch/native`), one individual after the other; in torch they are the same.

Where there is no compiler, or graphs are not of a size or type that the sources take, the batched
ones in torch run (`cgtorch.evolution.structure`, `parameters`, `crossover`, `lexicase`). Both give
the same children to the last bit.
"""

import ctypes
from ctypes import POINTER, addressof, byref, c_int64, c_void_p
from typing import Any

import torch
from torch import Tensor

from cgtorch import native
from cgtorch.actions import ActionSet
from cgtorch.evolution.drift import bounds
from cgtorch.evolution.operator_draws import Choices
from cgtorch.evolution.population import Population
from cgtorch.evolution.sampling import quantiles
from cgtorch.graphs import Graphs

MOST_NODES, MOST_OUTCOMES = 64, 16  # as in native/graph.h
NO_PARENT = 2  # as in native/operators.c


class _Pointers(ctypes.Structure):
    """`Graphs` in native/graph.h."""

    _fields_ = tuple((name, c_void_p) for name in ("action", "edges", "marks", "start"))


class _Breeding(ctypes.Structure):
    """`Breeding` in native/operators.c."""

    _fields_ = (
        *((name, _Pointers) for name in ("before", "after")),
        *(
            (name, c_void_p)
            for name in ("elite", "parents", "strategy", "theirs", "has_edge", "first")
        ),
        *((name, c_int64) for name in ("people", "nodes", "outcomes", "elites", "pairs")),
        *((name, c_int64) for name in ("actions", "pair_key", "key", "slots")),
    )


class _Children(ctypes.Structure):
    """`Children` in native/parameters.c."""

    _fields_ = (
        *((name, c_void_p) for name in ("action", "num_parameters", "marks", "old", "fresh")),
        *((name, c_void_p) for name in ("strategy", "factors", "bounds", "quantiles")),
        *((name, c_void_p) for name in ("parameters", "drifted")),
        *((name, c_int64) for name in ("rows", "nodes", "most", "actions", "same", "key")),
    )


_G, _P, _I = POINTER(_Pointers), c_void_p, c_int64
_TYPES: dict[str, tuple[Any, ...]] = {
    "mutated": (_G, _G, _P, _P, _I, _I, _P, _I, _P, _I, _I),
    "bred": (POINTER(_Breeding), _I),
    "changed": (POINTER(_Children), _I),
    "deviation": (_P, _I, _I, _P, _I),
    "lexicase": (_P, _I, _I, _P, _I, _I, _P, _I),
    "ranking": (_P, _P, _I, _I, _P),
}


def takes(graphs: Graphs, parameters: Tensor, slots: int = 0) -> bool:
    """Whether graphs, and parameters of such a type, are worked on by compiled operators.

    Args:
        graphs: P of them.
        parameters: theirs.
        slots: of what comes out, if it may be more than they have.
    """
    _, n, o = graphs.edges.shape
    return (
        max(n, slots) <= MOST_NODES
        and o <= MOST_OUTCOMES
        and all(is_whole(x) for x in (graphs.action, graphs.edges, graphs.start))
        and _function("changed", parameters.dtype) is not None
        and _function("bred", torch.float32) is not None
    )


def is_whole(numbers: Tensor) -> bool:
    """Whether numbers are of the type that compiled code takes for indices."""
    return numbers.is_cpu and numbers.dtype == torch.long


def takes_scores(scores: Tensor) -> bool:
    """Whether parents are chosen by compiled code from scores."""
    return scores.device.type == "cpu" and _function("lexicase", scores.dtype) is not None


def restructured(
    graphs: Graphs, choices: Choices, actions: ActionSet, capacity: int
) -> tuple[Graphs, list[int]]:
    """See `cgtorch.evolution.structure.restructured` and `parameters.mark_new`.

    The capacity is that of the graphs.
    """
    graphs, out = _contiguous(graphs), _room(len(graphs), capacity, graphs.edges.shape[2])
    first = (c_int64 * (len(actions) + 1))()
    _call(
        "mutated", torch.float32,
        byref(_pointers(graphs)), byref(_pointers(out)), _shape(graphs), choices.strategy,
        choices.key, choices.width, actions.has_edge, len(actions), first, len(graphs),
    )  # fmt: skip
    return out, list(first)


def swapped(graphs: Graphs, strategy: Tensor, key: int) -> Graphs:
    """Children of first and second parents (2 Q); see `cgtorch.evolution.crossover.swapped`."""
    every, slots = torch.arange(len(graphs)), graphs.capacity
    return bred(Population(graphs, strategy), every[:0], every, (key, 0), None, slots)[0]


def bred(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """See `cgtorch.evolution.offspring.bred`; without actions nothing is mutated."""
    graphs, count = _contiguous(population.graphs), len(elite) + len(parents)
    n, o = graphs.edges.shape[1:]
    given = elite, parents, population.strategy.float()
    kept = [tensor.contiguous() for tensor in given]
    room, theirs = _room(count, min(n + 1, capacity), o), torch.empty(count, kept[2].shape[1])
    kinds, has_edge = (0, None) if actions is None else (len(actions), actions.has_edge.data_ptr())
    first = (c_int64 * (kinds + 1))()
    breeding = _Breeding(
        _pointers(graphs, marks=False), _pointers(room), *(x.data_ptr() for x in (*kept, theirs)),
        has_edge, addressof(first), len(graphs), n, o, len(elite), len(parents) // 2, kinds, *keys,
        capacity,
    )  # fmt: skip
    _call("bred", torch.float32, byref(breeding))
    return _in_slots(room, breeding.slots), theirs, list(first)


def changed(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    factors: Tensor,
    same: int,
    key: int,
) -> tuple[Tensor, Tensor]:
    """See `cgtorch.evolution.parameters.parameters` and `drift.drifted`: what both give."""
    (p, n), k = graphs.action.shape, old.shape[2]
    made, drifted = old.new_empty(p, n, k), torch.empty(p, factors.shape[1])
    given = (
        graphs.action, actions.num_parameters, graphs.parameters, old, fresh, strategy.float(),
        factors, bounds(), quantiles(), made, drifted,
    )  # fmt: skip
    kept = [tensor.contiguous() for tensor in given]
    children = _Children(*(x.data_ptr() for x in kept), p, n, k, len(actions), same, key)
    _call("changed", old.dtype, byref(children))
    return made, drifted


def deviation(scores: Tensor) -> Tensor:
    """See `cgtorch.evolution.lexicase.deviation`."""
    out = scores.new_empty(scores.shape[1])
    _call("deviation", scores.dtype, scores, *scores.shape, out)
    return out


def lexicase(scores: Tensor, epsilon: Tensor, count: int, key: int) -> Tensor:
    """See `cgtorch.evolution.lexicase.parents`."""
    chosen = torch.empty(count, dtype=torch.long)
    _call("lexicase", scores.dtype, scores, *scores.shape, epsilon, key, count, chosen)
    return chosen


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """See `cgtorch.evolution.selection.ranking`."""
    order = torch.empty(len(graphs), dtype=torch.long)
    _call("ranking", fitness.dtype, fitness, graphs.action, graphs.capacity, len(graphs), order)
    return order


def _function(name: str, dtype: torch.dtype) -> Any:
    return native.function(name, dtype, *_TYPES[name])


def _call(name: str, dtype: torch.dtype, *arguments: Any) -> None:
    """Call with tensors, whose values are read in order, in place of pointers.

    Where one more argument is expected, it is how many threads may work.
    """
    kept = [a.contiguous() if isinstance(a, Tensor) else a for a in arguments]
    plain = [a.data_ptr() if isinstance(a, Tensor) else a for a in kept]
    more = len(_TYPES[name]) - len(plain)
    why = _function(name, dtype)(*plain, *[native.threads()] * more)
    if why == NO_PARENT:
        raise IndexError("a parent is none of the individuals; choose indices from 0 on")
    if why:
        raise MemoryError(f"no memory to run {name}")


def _contiguous(graphs: Graphs) -> Graphs:
    return Graphs(*(x.contiguous() for x in vars(graphs).values()))


def _room(count: int, nodes: int, outcomes: int) -> Graphs:
    """Room for so many marked graphs."""
    sizes = (count, nodes), (count, nodes, outcomes), (count, nodes, 1), (count,)
    return Graphs(*(torch.empty(size, dtype=torch.long) for size in sizes))


def _in_slots(room: Graphs, slots: int) -> Graphs:
    """The graphs that lie in this room with fewer slots each than there is room for."""
    if slots == room.capacity:
        return room
    p, _, o = room.edges.shape
    return Graphs(
        room.action.as_strided((p, slots), (slots, 1)),
        room.edges.as_strided((p, slots, o), (slots * o, o, 1)),
        room.parameters.as_strided((p, slots, 1), (slots, 1, 1)),
        room.start,
    )


def _pointers(graphs: Graphs, marks: bool = True) -> _Pointers:
    g = graphs
    third = g.parameters.data_ptr() if marks else None
    return _Pointers(g.action.data_ptr(), g.edges.data_ptr(), third, g.start.data_ptr())


def _shape(graphs: Graphs) -> Tensor:
    """N and O."""
    return torch.tensor(graphs.edges.shape[1:])
