"""Operators and selection on a GPU, from C sources (`native/cuda/breeding.cu`, `selection.cu`).

They give the same bits as `cgtorch.evolution.compiled`. All tensors stay on the GPU.
"""

import ctypes
from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import torch
from torch import Tensor

from cgtorch.evolution.compiled import graphs_structure
from cgtorch.evolution.population import STRATEGY, Population, bounds, spread
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.counter_rng import quantiles
from cgtorch.native import constants, structure
from cgtorch.native.gpu import Launcher, Module

BREEDING = partial(Module, "breeding", kernels=("elite", "pairs", "children"))
SELECTION = partial(Module, "selection", kernels=("order", "sort_groups", "parents"))
"""The kernels for one type of numbers."""

THREADS, WARP = 128, 32
PAIRS = 64
"""Threads per block of the crossover kernel, where each thread needs much memory."""
WARPS = 32
"""Warps per multiprocessor that select parents at once."""


def breed(
    gpu: Launcher,
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor]:
    """See `cgtorch.evolution.offspring.breed`; new nodes are not numbered yet."""
    graphs, rows = population.graphs, torch.cat([elite, parents])
    count, (_, n, o) = len(rows), graphs.edges.shape
    sizes = graphs.num_nodes.index_select(0, rows.clamp(0, len(graphs) - 1))
    low, high, width = torch.stack([rows.min(), rows.max(), sizes.max()]).tolist()
    if low < 0 or high >= len(graphs):
        raise IndexError("a parent is not in the population; choose indices from 0 to P - 1")
    slots = capacity if actions is None else min(width + 1, capacity)
    like = graphs.action
    made = Graphs(
        like.new_empty(count, slots), like.new_empty(count, slots, o),
        like.new_empty(count, slots, 1), like.new_empty(count),
    )  # fmt: skip
    strategy = population.strategy.float().index_select(0, rows)
    given = graphs_structure(graphs, None, n)
    breeding = structure("Breeding", torch.float32)(
        given=given, made=graphs_structure(made, made.parameters, slots), elite=elite,
        parents=parents, strategy=None, parent_strategy=strategy,
        has_edge=actions and actions.has_edge.to(gpu.device), standard=None, first=None,
        individuals=len(graphs), elites=len(elite), pairs=len(parents) // 2,
        actions=0 if actions is None else len(actions), pair_key=keys[0], key=keys[1], width=width,
    )  # fmt: skip
    module = BREEDING(torch.float32)
    _launch(gpu, module, "elite", len(elite), THREADS, breeding)
    _launch(gpu, module, "pairs", len(parents) // 2, PAIRS, breeding)
    return made, strategy


def perturb_parameters(
    gpu: Launcher,
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
    made, drifted = old.new_empty(p, n, k), strategy.new_empty(p, len(STRATEGY))
    tables = _tables(actions, gpu.device)
    children = structure("Children", old.dtype)(
        action=graphs.action, num_parameters=tables[0], standard=tables[1],
        origins=graphs.parameters, old=old, fresh=fresh, strategy=strategy.float(),
        bounds=tables[2], quantiles=tables[3], parameters=made, drifted=drifted, rows=p, nodes=n,
        most=k, actions=len(actions), same=same, key=key, spread=spread(tau),
    )  # fmt: skip
    _launch(gpu, BREEDING(old.dtype), "children", p * WARP, THREADS, children)
    return made, drifted


def shuffled(gpu: Launcher, count: int, key: int) -> Tensor:
    """See `cgtorch.ground.counter_rng.shuffled`."""
    out = torch.empty(count, dtype=torch.long, device=gpu.device)
    about = ctypes.c_void_p(out.data_ptr()), ctypes.c_int64(count), ctypes.c_int64(key)
    _launch(gpu, SELECTION(torch.float32), "order", count, THREADS, *about)
    return out


def lexicase(
    gpu: Launcher, scores: Tensor, members: Tensor, keys: Sequence[int], count: int
) -> Tensor:
    """Parents (count,) by lexicase selection within groups of individuals, one group per key.

    `members` (P,) lists the individuals, group after group; they have scores (P, B).
    """
    dtype, (p, b), groups = scores.dtype, scores.shape, len(keys)
    most = constants("selection_limits", dtype)["CANDIDATES"]
    smaller, larger = divmod(p, groups)
    inside = scores.index_select(0, members)
    epsilon = _deviations(inside, groups)
    places = torch.empty(2, groups, most, dtype=torch.int32, device=gpu.device)
    warps = min(count, gpu.multiprocessors * WARPS)
    chosen = torch.empty(count, dtype=torch.long, device=gpu.device)
    about = structure("Groups", dtype)(
        scores=inside, epsilon=epsilon, members=members,
        keys=torch.tensor(list(keys)).to(gpu.device), cases=scores.new_empty(groups, b, most),
        ordered=places[0], leader=places[1],
        case_order=torch.empty(warps, b, dtype=torch.int32, device=gpu.device), chosen=chosen,
        scenarios=b, groups=groups, smaller=smaller, larger=larger, count=count, warps=warps,
    )  # fmt: skip
    module = SELECTION(dtype)
    _launch(gpu, module, "sort_groups", groups * THREADS, THREADS, about)
    _launch(gpu, module, "parents", warps * WARP, THREADS, about)
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
def _tables(actions: ActionSet, device: torch.device) -> tuple[Tensor, ...]:
    """Lookup tables of the kernels: actions, bounds of strategies, and normal quantiles."""
    tables = actions.num_parameters, actions.standard, bounds(), quantiles()
    return tuple(table.to(device) for table in tables)


def _launch(
    gpu: Launcher, module: Module, kernel: str, threads: int, block: int, *arguments: Any
) -> None:
    if threads:
        gpu.launch(module, kernel, -(-threads // block), block, 0, *arguments)
