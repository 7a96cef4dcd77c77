"""The genetic operators in C, on the CPU (`native/engine`) or on an NVIDIA GPU (`native/cuda`).

They give the same children and parents as `operators_in_torch` and `selection`, bit for bit. Those
in torch run without a compiler, and for sizes and types of graphs that C does not support. With a
`launcher`, by default that of the tensors' device, all tensors stay on its GPU.
"""

import ctypes
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import torch
from torch import Tensor

from cgtorch.evolution.population import STRATEGY, Population, bounds, spread
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground import counter_rng
from cgtorch.native import agree, constants, function, structure, threads
from cgtorch.native.gpu import Gpu, Module, launcher_of

BREEDING = partial(Module, "breeding", kernels=("elite", "pairs", "children"))
SELECTION = partial(Module, "selection", kernels=("order", "sort_groups", "parents"))
"""The kernels for one type of numbers."""

CPU = torch.device("cpu")
THREADS, WARP = 128, 32
PAIRS = 64  # threads per block of the crossover kernel, where each needs much memory
WARPS = 32  # warps per multiprocessor that select parents at once


def takes(graphs: Graphs, parameters: Tensor, slots: int = 0) -> bool:
    """Whether the compiled operators support these graphs, parameter types and numbers of slots."""
    if launcher_of(graphs.start.device):
        return True
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
    """Whether compiled code on the CPU can select parents by these scores."""
    return scores.is_cpu and function("lexicase", scores.dtype) is not None


def breed(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
    launcher: Gpu | None = None,
) -> tuple[Graphs, Tensor]:
    """See `cgtorch.evolution.operators.breed`; new nodes are not numbered yet."""
    graphs, rows = population.graphs, torch.cat([elite, parents])
    launcher, device = launcher or launcher_of(rows.device), rows.device
    count, (_, n, o), width = len(rows), graphs.edges.shape, _widest(graphs, rows)
    slots = capacity if actions is None else min(width + 1, capacity)
    shapes = (count, slots), (count, slots, o), (count, slots, 1), (count,)
    made = Graphs(*(torch.empty(shape, dtype=torch.long, device=device) for shape in shapes))
    strategy = population.strategy.float().index_select(0, rows)
    breeding = structure("Breeding", torch.float32)(
        given=_graphs(graphs, None, n), made=_graphs(made, made.parameters, slots), elite=elite,
        parents=parents, parent_strategy=strategy, has_edge=actions and actions.has_edge.to(device),
        elites=len(elite), pairs=len(parents) // 2, actions=len(actions) if actions else 0,
        pair_key=keys[0], key=keys[1], width=width,
    )  # fmt: skip
    if launcher is None:
        _call("breed", torch.float32, breeding, threads())
        return made, strategy
    module = BREEDING(torch.float32)
    _launch(launcher, module, "elite", len(elite), THREADS, breeding)
    _launch(launcher, module, "pairs", len(parents) // 2, PAIRS, breeding)
    return made, strategy


def _widest(graphs: Graphs, rows: Tensor) -> int:
    """The number of nodes of the largest of some graphs; IndexError if there is none of a row."""
    if rows.is_cpu:
        about = graphs.action.contiguous(), graphs.capacity, len(graphs), rows, len(rows)
        width = int(function("widest", torch.float32)(*about))
    else:
        sizes = graphs.num_nodes.index_select(0, rows.clamp(0, len(graphs) - 1))
        missing = ((rows < 0) | (rows >= len(graphs))).any()
        width = int(torch.where(missing, -1, sizes.max())) if len(rows) else 0
    if width < 0:
        raise IndexError("a parent is not in the population; choose indices from 0 to P - 1")
    return width


def perturb_parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    tau: float,
    same: int,
    key: int,
    launcher: Gpu | None = None,
) -> tuple[Tensor, Tensor]:
    """See `cgtorch.evolution.operators_in_torch.perturb_parameters`."""
    launcher, (p, n), k = launcher or launcher_of(old.device), graphs.action.shape, old.shape[2]
    made, drifted = old.new_empty(p, n, k), torch.empty(p, len(STRATEGY), device=old.device)
    num_parameters, standard, strategy_bounds, quantiles = _tables(actions, old.device)
    children = structure("Children", old.dtype)(
        action=graphs.action, num_parameters=num_parameters, origins=graphs.parameters, old=old,
        fresh=fresh, strategy=strategy.float(), standard=standard, bounds=strategy_bounds,
        quantiles=quantiles, parameters=made, drifted=drifted, rows=p, nodes=n, most=k,
        actions=len(actions), same=same, key=key, spread=spread(tau),
    )  # fmt: skip
    if launcher is None:
        _call("perturb_parameters", old.dtype, children, threads())
    else:
        _launch(launcher, BREEDING(old.dtype), "children", p * WARP, THREADS, children)
    return made, drifted


def ranking(fitness: Tensor, graphs: Graphs) -> Tensor:
    """See `cgtorch.evolution.selection.ranking`; on the CPU."""
    order, action = torch.empty(len(graphs), dtype=torch.long), graphs.action.contiguous()
    _call("ranking", fitness.dtype, fitness.contiguous(), action, *action.shape[::-1], order)
    return order


def shuffled(
    count: int, key: int, device: torch.device = CPU, launcher: Gpu | None = None
) -> Tensor:
    """See `cgtorch.ground.counter_rng.shuffled`; in torch if it has to be."""
    launcher, name = launcher or launcher_of(device), "shuffled_order"
    if launcher is None and function(name, torch.float32) is None:
        return counter_rng.shuffled(count, key)
    order = torch.empty(count, dtype=torch.long, device=device)
    if launcher is None:
        _call(name, torch.float32, count, key, order, threads())
    else:
        about = ctypes.c_void_p(order.data_ptr()), ctypes.c_int64(count), ctypes.c_int64(key)
        _launch(launcher, SELECTION(torch.float32), "order", count, THREADS, *about)
    return order


def deviation(scores: Tensor) -> Tensor:
    """See `cgtorch.evolution.selection.deviation`; on the CPU."""
    out = scores.new_empty(scores.shape[1])
    _call("deviation", scores.dtype, scores.contiguous(), *scores.shape, out, threads())
    return out


def lexicase(scores: Tensor, epsilon: Tensor, count: int, key: int) -> Tensor:
    """See `cgtorch.evolution.selection.parents`; on the CPU."""
    chosen, scores = torch.empty(count, dtype=torch.long), scores.contiguous()
    task = scores, *scores.shape, epsilon.contiguous(), key, count, chosen, threads()
    _call("lexicase", scores.dtype, *task)
    return chosen


def lexicase_on_gpu(
    launcher: Gpu, scores: Tensor, members: Tensor, keys: Sequence[int], count: int
) -> Tensor:
    """Parents (count,) by lexicase selection within groups of individuals, one group per key.

    `members` (P,) lists the individuals, group after group; they have scores (P, B).
    """
    dtype, (p, b), groups = scores.dtype, scores.shape, len(keys)
    most = constants("selection_limits", dtype)["CANDIDATES"]
    smaller, larger = divmod(p, groups)
    inside = scores.index_select(0, members)
    warps = min(count, launcher.multiprocessors * WARPS)
    room = partial(torch.empty, dtype=torch.int32, device=scores.device)
    chosen = torch.empty(count, dtype=torch.long, device=scores.device)
    about = structure("Groups", dtype)(
        scores=inside, epsilon=_deviations(inside, groups), members=members,
        keys=torch.tensor(list(keys)).to(scores.device), cases=scores.new_empty(groups, b, most),
        ordered=room(groups, most), leader=room(groups, most), case_order=room(warps, b),
        chosen=chosen, scenarios=b, groups=groups, smaller=smaller, larger=larger, count=count,
        warps=warps,
    )  # fmt: skip
    _launch(launcher, SELECTION(dtype), "sort_groups", groups * THREADS, THREADS, about)
    _launch(launcher, SELECTION(dtype), "parents", warps * WARP, THREADS, about)
    return chosen


def _deviations(scores: Tensor, groups: int) -> Tensor:
    """(G, B) `selection.deviation` of the scores (P, B) in each group."""
    smaller, larger = divmod(len(scores), groups)
    end, b = larger * (smaller + 1), scores.shape[1]
    parts = scores[:end].view(larger, smaller + 1, b), scores[end:].view(-1, smaller, b)
    found = [
        (part - part.median(1, keepdim=True).values).abs().median(1).values
        for part in parts
        if len(part)
    ]
    return torch.cat(found)


@cache
def _limits() -> Mapping[str, int]:
    agree(constants("strategy"), {name.upper(): i for i, name in enumerate(STRATEGY)})
    return constants("graph_limits")


@cache
def _tables(actions: ActionSet, device: torch.device) -> tuple[Tensor, ...]:
    """Lookup tables: of actions, bounds of strategies, and normal quantiles."""
    tables = actions.num_parameters, actions.standard, bounds(), counter_rng.quantiles()
    return tuple(table.to(device) for table in tables)


def _graphs(graphs: Graphs, origins: Tensor | None, nodes: int) -> Any:
    """The `Graphs` of graph.h, with `nodes` slots per graph and `origins` at the nodes if given."""
    action, edges, start = (x.contiguous() for x in (graphs.action, graphs.edges, graphs.start))
    kind, outcomes = structure("Graphs", torch.float32), edges.shape[2]
    return kind(
        action=action, edges=edges, origins=origins, start=start, nodes=nodes, outcomes=outcomes
    )


def _call(name: str, dtype: torch.dtype, *arguments: Any) -> None:
    if function(name, dtype)(*arguments):
        raise MemoryError(f"no memory to run {name}")


def _launch(
    gpu: Gpu, module: Module, kernel: str, threads: int, block: int, *arguments: Any
) -> None:
    if threads:
        gpu.launch(module, kernel, -(-threads // block), block, 0, *arguments)
