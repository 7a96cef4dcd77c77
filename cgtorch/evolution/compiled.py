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
from torch import Generator, Tensor

from cgtorch import native
from cgtorch.actions import ActionSet
from cgtorch.evolution.choices import Choices, Pairing, Pairs
from cgtorch.evolution.sampling import IN_A_WORD, words
from cgtorch.graphs import Graphs

MOST_NODES, MOST_OUTCOMES = 64, 16  # as in native/graph.h


class _Pointers(ctypes.Structure):
    """`Graphs` in native/graph.h."""

    _fields_ = tuple((name, c_void_p) for name in ("action", "edges", "marks", "start"))


_G, _P, _I = POINTER(_Pointers), c_void_p, c_int64
_TYPES: dict[str, tuple[Any, ...]] = {
    "mutated": (_G, _G, _P, _P, _P, _I, _P, _I, _I, _I),
    "bred": (_G, _P, _G, _P, _P, _P, _P, _I, _P, _P, _I, _P, _I, _I, _I),
    "paired": (_P, _I, _P, _I, _P, _I, _P, _P, _P, _P),
    "mark_new": (_P, _P, _I, _I, _P, _P),
    "parameter_counts": (_P, _P, _I, _I, _P, _P, _I),
    "parameter_hits": (_P, _P, _P, _P, _P, _P, _I, _I),
    "parameters_of": (*[_P] * 7, _I, _I, _P, _P, _P, _I, _P, _I, _I),
    "deviation": (_P, _I, _I, _P),
    "lexicase": (_P, _I, _I, _P, _P, _P, _I, _P, _I),
}
_SOURCE = {
    "mutated": "operators",
    "bred": "operators",
    "paired": "operators",
    "mark_new": "parameters",
    "parameter_counts": "parameters",
    "parameter_hits": "parameters",
    "parameters_of": "parameters",
    "deviation": "lexicase",
    "lexicase": "lexicase",
}
_GRAPHS = ("mutated", "bred", "parameters_of")


def takes(graphs: Graphs, parameters: Tensor) -> bool:
    """Whether graphs, and parameters of such a type, are worked on by compiled operators."""
    _, n, o = graphs.edges.shape
    whole = graphs.action, graphs.edges, graphs.start
    return (
        n <= MOST_NODES
        and o <= MOST_OUTCOMES
        and all(x.device.type == "cpu" and x.dtype == torch.long for x in whole)
        and all(_function(name, parameters.dtype) is not None for name in _GRAPHS)
    )


def takes_scores(scores: Tensor) -> bool:
    """Whether parents are chosen by compiled code from scores."""
    return scores.device.type == "cpu" and _function("lexicase", scores.dtype) is not None


def restructured(graphs: Graphs, choices: Choices, actions: ActionSet) -> Graphs:
    """See `cgtorch.evolution.structure.restructured`."""
    graphs, out = _contiguous(graphs), _like(graphs, len(graphs))
    _call(
        "mutated", torch.float32,
        _pointers(graphs), _pointers(out), _shape(graphs),
        choices.strategy, choices.draws, choices.width, actions.has_edge, len(actions), len(graphs),
    )  # fmt: skip
    return out


def paired(graphs: Graphs, parents: Tensor, strategy: Tensor, draws: Tensor) -> Pairing:
    """See `cgtorch.evolution.crossover.paired`."""
    chosen, size = torch.empty(2, len(draws), dtype=torch.long)
    totals = torch.empty(2, dtype=torch.long)
    _call(
        "paired", torch.float32,
        graphs.action, graphs.capacity, parents, len(draws), strategy, strategy.shape[1],
        draws, chosen, size, totals,
    )  # fmt: skip
    crossed, width = totals.tolist()
    return chosen, size, crossed, width


def swapped(graphs: Graphs, pairs: Pairs) -> Graphs:
    """See `cgtorch.evolution.crossover.swapped`."""
    return _bred(graphs, pairs, None, None, 0, None, 0)


def bred(graphs: Graphs, pairs: Pairs, choices: Choices, actions: ActionSet) -> Graphs:
    """Children of pairs, mutated; see both of the above."""
    mutation = choices.strategy, choices.draws, choices.width
    return _bred(graphs, pairs, *mutation, actions.has_edge, len(actions))


def _bred(graphs: Graphs, pairs: Pairs, *mutation: Any) -> Graphs:
    graphs = _contiguous(replace(graphs, parameters=graphs.action[..., None]))
    out = _like(graphs, len(pairs.parents))
    _call(
        "bred", torch.float32,
        _pointers(graphs, marks=False), pairs.parents, _pointers(out), _shape(graphs),
        pairs.chosen, pairs.size, pairs.draws, pairs.width, *mutation, len(pairs.chosen),
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
    generator: Generator,
) -> Tensor:
    """See `cgtorch.evolution.parameters.parameters`."""
    p, n = graphs.action.shape
    out = old.new_empty(p, *old.shape[1:])
    counts, first, hits = torch.empty(3, p + 1, dtype=torch.long)
    nodes = graphs.action, actions.num_parameters, len(actions), n
    _call("parameter_counts", old.dtype, *nodes, counts, first, p)
    draws = words((int(first[-1]),), generator)
    which = torch.empty(IN_A_WORD * len(draws), dtype=torch.int32)
    _call("parameter_hits", old.dtype, counts, first, draws, rate, hits, which, p)
    normal = torch.randn(int(hits[-1]), generator=generator)
    _call(
        "parameters_of", old.dtype,
        first, hits, which, sigma, normal, *nodes, graphs.parameters, old, fresh, old.shape[2],
        out, p,
    )  # fmt: skip
    return out


def deviation(scores: Tensor) -> Tensor:
    """See `cgtorch.evolution.lexicase.deviation`."""
    out = scores.new_empty(scores.shape[1])
    _call("deviation", scores.dtype, scores, *scores.shape, out)
    return out


def lexicase(scores: Tensor, epsilon: Tensor, turns: Tensor, last: Tensor) -> Tensor:
    """See `cgtorch.evolution.lexicase.parents`."""
    chosen = torch.empty(len(turns), dtype=torch.long)
    _call(
        "lexicase", scores.dtype, scores, *scores.shape, epsilon, turns, last,
        len(turns), chosen,
    )  # fmt: skip
    return chosen


def _function(name: str, dtype: torch.dtype) -> Any:
    return native.function(_SOURCE[name], name, dtype, *_TYPES[name])


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


def _like(graphs: Graphs, count: int) -> Graphs:
    """Room for so many graphs of the same size."""
    return Graphs(*(x.new_empty(count, *x.shape[1:]) for x in vars(graphs).values()))


def _pointers(graphs: Graphs, marks: bool = True) -> Any:
    pointers = _Pointers(*(x.data_ptr() for x in vars(graphs).values()))
    if not marks:
        pointers.marks = None
    return byref(pointers)


def _shape(graphs: Graphs) -> Tensor:
    """N and O."""
    return torch.tensor(graphs.edges.shape[1:])
