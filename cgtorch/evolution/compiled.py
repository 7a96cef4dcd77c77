"""Operators in C (`cgtorch/native`), one individual after the other; in torch they are the same.

Where there is no compiler, or graphs are not of a size or type that the sources take, the batched
ones in torch run (`cgtorch.evolution.structure`, `parameters`, `crossover`, `lexicase`). Both give
the same children to the last bit.
"""

import ctypes
from ctypes import POINTER, byref, c_int64, c_void_p
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from cgtorch import native
from cgtorch.actions import ActionSet
from cgtorch.evolution.choices import Choices, Pairs
from cgtorch.evolution.sampling import quantiles
from cgtorch.graphs import Graphs

MOST_NODES, MOST_OUTCOMES = 64, 16  # as in native/graph.h


class _Pointers(ctypes.Structure):
    """`Graphs` in native/graph.h."""

    _fields_ = tuple((name, c_void_p) for name in ("action", "edges", "marks", "start"))


_G, _P, _I = POINTER(_Pointers), c_void_p, c_int64
_TYPES: dict[str, tuple[Any, ...]] = {
    "most_nodes": (_P, _I, _P, _I, _P),
    "mutated": (_G, _G, _P, _P, _I, _I, _P, _I, _I, _I),
    "bred": (_G, _P, _I, _P, _G, _P, _P, *[_I] * 4, _P, _I, _I, _I),
    "mark_new": (_P, _P, _I, _I, _P, _P),
    "parameters_of": (_P, _P, _I, *[_P] * 3, _I, _I, *[_P] * 3, _I, _P, _I, _I),
    "deviation": (_P, _I, _I, _P, _I),
    "lexicase": (_P, _I, _I, _P, _I, _I, _P, _I),
}


def takes(graphs: Graphs, parameters: Tensor, slots: int = 0) -> bool:
    """Whether graphs, and parameters of such a type, are worked on by compiled operators.

    Args:
        graphs: P of them.
        parameters: theirs.
        slots: of what comes out, if it may be more than they have.
    """
    _, n, o = graphs.edges.shape
    whole = graphs.action, graphs.edges, graphs.start
    return (
        max(n, slots) <= MOST_NODES
        and o <= MOST_OUTCOMES
        and all(x.device.type == "cpu" and x.dtype == torch.long for x in whole)
        and _function("parameters_of", parameters.dtype) is not None
        and _function("bred", torch.float32) is not None
    )


def takes_scores(scores: Tensor) -> bool:
    """Whether parents are chosen by compiled code from scores."""
    return scores.device.type == "cpu" and _function("lexicase", scores.dtype) is not None


def restructured(graphs: Graphs, choices: Choices, actions: ActionSet, capacity: int) -> Graphs:
    """See `cgtorch.evolution.structure.restructured`; the capacity is that of the graphs."""
    graphs, out = _contiguous(graphs), _room(len(graphs), capacity, graphs.edges.shape[2])
    _call(
        "mutated", torch.float32,
        _pointers(graphs), _pointers(out), _shape(graphs), choices.strategy, choices.key,
        choices.width, actions.has_edge, len(actions), len(graphs),
    )  # fmt: skip
    return out


def most_nodes(graphs: Graphs, rows: Tensor) -> int:
    """Nodes of the largest of the graphs `rows` (n,)."""
    most = torch.empty((), dtype=torch.long)
    _call("most_nodes", torch.float32, graphs.action, graphs.capacity, rows, len(rows), most)
    return int(most)


def swapped(graphs: Graphs, pairs: Pairs) -> Graphs:
    """See `cgtorch.evolution.crossover.swapped`."""
    return _bred(graphs, pairs.parents[:0], pairs, 0, graphs.capacity, None, 0)


def bred(
    graphs: Graphs, elite: Tensor, pairs: Pairs, choices: Choices, actions: ActionSet
) -> Graphs:
    """See `cgtorch.evolution.offspring.bred`."""
    mutation = choices.key, choices.width, actions.has_edge, len(actions)
    return _bred(graphs, elite, pairs, *mutation)


def _bred(
    graphs: Graphs,
    elite: Tensor,
    pairs: Pairs,
    key: int,
    slots: int,
    has_edge: Tensor | None,
    actions: int,
) -> Graphs:
    graphs = _contiguous(replace(graphs, parameters=graphs.action[..., None]))
    out = _room(len(elite) + len(pairs.parents), slots, graphs.edges.shape[2])
    _call(
        "bred", torch.float32,
        _pointers(graphs, marks=False), elite, len(elite), pairs.parents, _pointers(out),
        _shape(graphs), pairs.strategy, pairs.key, pairs.width, key, slots, has_edge, actions,
        len(pairs),
    )  # fmt: skip
    return out


def mark_new_(graphs: Graphs, actions: int) -> list[int]:
    """See `cgtorch.evolution.parameters.mark_new_`."""
    first, where = torch.empty(actions + 1, dtype=torch.long), torch.empty_like(graphs.action)
    marks = graphs.parameters
    _call("mark_new", torch.float32, graphs.action, marks, marks.numel(), actions, first, where)
    return first.tolist()


def parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    rate: Tensor,
    sigma: Tensor,
    key: int,
) -> Tensor:
    """See `cgtorch.evolution.parameters.parameters`."""
    p, n = graphs.action.shape
    out = old.new_empty(p, n, old.shape[2])
    _call(
        "parameters_of", old.dtype,
        rate, sigma, key, quantiles(), graphs.action, actions.num_parameters, len(actions), n,
        graphs.parameters, old, fresh, old.shape[2], out, p,
    )  # fmt: skip
    return out


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


def _function(name: str, dtype: torch.dtype) -> Any:
    return native.function(name, dtype, *_TYPES[name])


def _call(name: str, dtype: torch.dtype, *arguments: Any) -> None:
    """Call with tensors, whose values are read in order, in place of pointers.

    Where one more argument is expected, it is how many threads may work.
    """
    kept = [a.contiguous() if isinstance(a, Tensor) else a for a in arguments]
    plain = [a.data_ptr() if isinstance(a, Tensor) else a for a in kept]
    more = len(_TYPES[name]) - len(plain)
    if _function(name, dtype)(*plain, *[native.threads()] * more):
        raise MemoryError(f"no memory to run {name}")


def _contiguous(graphs: Graphs) -> Graphs:
    return Graphs(*(x.contiguous() for x in vars(graphs).values()))


def _room(count: int, nodes: int, outcomes: int) -> Graphs:
    """Room for so many marked graphs."""
    sizes = (count, nodes), (count, nodes, outcomes), (count, nodes, 1), (count,)
    return Graphs(*(torch.empty(size, dtype=torch.long) for size in sizes))


def _pointers(graphs: Graphs, marks: bool = True) -> Any:
    pointers = _Pointers(*(x.data_ptr() for x in vars(graphs).values()))
    if not marks:
        pointers.marks = None
    return byref(pointers)


def _shape(graphs: Graphs) -> Tensor:
    """N and O."""
    return torch.tensor(graphs.edges.shape[1:])
