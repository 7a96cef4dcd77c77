"""Operators in C (`cgtorch/native`), one individual after the other; in torch they are the same.

Where there is no compiler, or graphs are not of a size or type that the sources take, the batched
ones in torch run (`cgtorch.evolution.structure`, `parameters`, `crossover`, `lexicase`). Both give
the same children to the last bit.
"""

import ctypes
from ctypes import POINTER, byref, c_int64, c_void_p
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch import native
from cgtorch.actions import ActionSet
from cgtorch.graphs import Graphs

MOST_NODES, MOST_OUTCOMES = 64, 16  # as in native/graph.h


class _Pointers(ctypes.Structure):
    """`Graphs` in native/graph.h."""

    _fields_ = tuple((name, c_void_p) for name in ("action", "edges", "parameters", "start"))


_G = POINTER(_Pointers)
_TYPES: dict[tuple[str, str], tuple[Any, ...]] = {
    ("mutation", "mutated"): (
        *(_G, _G, c_void_p, c_void_p, c_void_p, c_int64, c_void_p, c_int64),
        *(c_void_p, c_int64, c_int64),
    ),
    ("crossover", "crossed"): (
        *(_G, _G, _G, c_void_p, c_void_p, c_void_p, c_void_p, c_int64, c_int64, c_int64),
    ),
    ("parameters", "parameter_counts"): (
        *(c_void_p, c_void_p, c_int64, c_int64, c_void_p, c_int64),
    ),
    ("parameters", "parameter_hits"): (*[c_void_p] * 4, c_int64, c_int64),
    ("parameters", "parameter_steps"): (
        *(c_void_p, c_void_p, c_void_p, c_void_p, c_void_p, c_void_p, c_int64, c_int64, c_int64),
        *(c_void_p, c_void_p, c_void_p, c_int64, c_int64),
    ),
    ("lexicase", "lexicase"): (
        *(c_void_p, c_int64, c_int64, c_void_p, c_void_p, c_void_p, c_int64, c_void_p, c_int64),
    ),
}


def takes(graphs: Graphs) -> bool:
    """Whether graphs are worked on by compiled operators."""
    _, n, o = graphs.edges.shape
    return (
        n <= MOST_NODES
        and o <= MOST_OUTCOMES
        and graphs.action.device.type == "cpu"
        and graphs.action.dtype == graphs.edges.dtype == graphs.start.dtype == torch.long
        and all(
            _function(source, name, graphs.parameters.dtype) is not None
            for source, name in _TYPES
            if source != "lexicase"
        )
    )


def takes_scores(scores: Tensor) -> bool:
    """Whether parents are chosen by compiled code from scores."""
    return scores.device.type == "cpu" and _function("lexicase", "lexicase", scores.dtype) is not None


def restructured(
    graphs: Graphs, strategy: Tensor, draws: Tensor, width: int, actions: ActionSet
) -> tuple[Graphs, Tensor]:
    """See `cgtorch.evolution.structure.restructured`."""
    graphs, out = _contiguous(graphs), _like(graphs, len(graphs))
    fresh = torch.empty_like(graphs.action, dtype=torch.bool)
    _call(
        "mutation", "mutated", graphs.parameters.dtype,
        _pointers(graphs), _pointers(out), _shape(graphs), strategy, draws, width,
        actions.has_edge, len(actions), fresh, len(graphs),
    )  # fmt: skip
    return out, fresh


def swapped(
    first: Graphs, second: Graphs, chosen: Tensor, size: Tensor, draws: Tensor, width: int
) -> Graphs:
    """See `cgtorch.evolution.crossover.swapped`."""
    first, second, out = _contiguous(first), _contiguous(second), _like(first, 2 * len(first))
    _call(
        "crossover", "crossed", first.parameters.dtype,
        _pointers(first), _pointers(second), _pointers(out), _shape(first),
        chosen, size, draws, width, len(first),
    )  # fmt: skip
    return out


def perturb_(
    graphs: Graphs, actions: ActionSet, rate: Tensor, sigma: Tensor, generator: Generator
) -> None:
    """See `cgtorch.evolution.parameters.perturb_`."""
    p, n = graphs.action.shape
    dtype = graphs.parameters.dtype
    first, hits = torch.zeros(p + 1, dtype=torch.long), torch.empty(p, dtype=torch.long)
    kinds = actions.num_parameters, len(actions), n
    _call("parameters", "parameter_counts", dtype, graphs.action, *kinds, first[1:], p)
    first = first.cumsum(0)
    draws = torch.rand(int(first[-1]), generator=generator)
    about = first, draws, rate
    _call("parameters", "parameter_hits", dtype, *about, hits, p)
    last = hits.cumsum(0)
    normal = torch.randn(int(last[-1]) if p else 0, generator=generator)
    _call(
        "parameters", "parameter_steps", dtype, *about, graphs.action, graphs.parameters,
        *kinds, graphs.parameters.shape[2], sigma, normal, last - hits, p,
    )  # fmt: skip


def lexicase(scores: Tensor, epsilon: Tensor, turns: Tensor, last: Tensor) -> Tensor:
    """See `cgtorch.evolution.lexicase.parents`."""
    chosen = torch.empty(len(turns), dtype=torch.long)
    _call(
        "lexicase", "lexicase", scores.dtype, scores, *scores.shape, epsilon, turns, last,
        len(turns), chosen,
    )  # fmt: skip
    return chosen


def _function(source: str, name: str, dtype: torch.dtype) -> Any:
    return native.function(source, name, dtype, *_TYPES[source, name])


def _call(source: str, name: str, dtype: torch.dtype, *arguments: Any) -> None:
    """Call with tensors, which may have any strides, in place of pointers; threads come last."""
    kept = [a.contiguous() if isinstance(a, Tensor) else a for a in arguments]
    plain = [a.data_ptr() if isinstance(a, Tensor) else a for a in kept]
    function: Any = _function(source, name, dtype)
    types = function.argtypes
    if function(*plain, *[native.threads()] * (len(types) - len(plain))):
        raise MemoryError(f"no memory to run {name}")


def _contiguous(graphs: Graphs) -> Graphs:
    return Graphs(*(x.contiguous() for x in vars(graphs).values()))


def _like(graphs: Graphs, count: int) -> Graphs:
    """Room for so many graphs of the same size."""
    return Graphs(*(x.new_empty(count, *x.shape[1:]) for x in vars(graphs).values()))


def _pointers(graphs: Graphs) -> Any:
    return byref(_Pointers(*(x.data_ptr() for x in vars(graphs).values())))


def _shape(graphs: Graphs) -> Tensor:
    """N, O and K."""
    return torch.tensor([*graphs.edges.shape[1:], graphs.parameters.shape[2]])
