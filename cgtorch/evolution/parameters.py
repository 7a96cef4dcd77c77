"""Parameters of children: copied from parents or new, then perturbed by Gaussian steps.

Operators on structure move nodes and ignore parameters. They work on graphs that carry, in place of
parameters, the origin of each node's parameters. So parameters are copied only once, at the end,
and only for the nodes that remain. An origin is

- r + 1 for row r of all parents' parameters,
- -r - 1 for row r of the parameters drawn for new nodes, and
- 0 for a new node without a row.
"""

from dataclasses import replace
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.evolution import compiled, gpu
from cgtorch.evolution.population import STRATEGY, Population, drifted, factors
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.counter_rng import (
    FRESH,
    keys,
    normal_from,
    random_key,
    uniform_from,
    words,
)
from cgtorch.native.gpu import launcher_of

RATE, SIGMA = STRATEGY.index("mutate_parameter"), STRATEGY.index("sigma")


def with_origins(graphs: Graphs) -> Graphs:
    """The graphs with origins (P, N, 1) in place of parameters: 1 + the index among all slots."""
    origins = torch.arange(1, graphs.action.numel() + 1).view_as(graphs.action) * graphs.used
    return replace(graphs, parameters=origins[..., None])


def copied(graphs: Graphs, old: Tensor) -> Graphs:
    """Graphs with the parameters that their origins name among those of the parents (P, N, K)."""
    none = old.new_zeros(0, old.shape[2])
    return replace(graphs, parameters=_at_origins(graphs.parameters, old, none))


def with_new_origins(graphs: Graphs, standard: Tensor) -> tuple[Graphs, list[int]]:
    """The graphs with origins -1, -2, … at new nodes, ordered by action, and CSR offsets (A + 1,).

    The offsets say where the new nodes of each action begin; the last one is their number. New
    nodes whose action has `standard` (A,) normal parameters keep origin 0.
    """
    if bool(standard.all()):
        return graphs, [0] * (len(standard) + 1)
    action, origins = graphs.action.flatten(), graphs.parameters.flatten()
    standard = standard.to(action.device)
    new = ((action >= 0) & (origins == 0)).nonzero()[:, 0]
    new = new[standard[action[new]] == 0]
    numbers = torch.bincount(action[new], minlength=len(standard))
    new = new[action[new].argsort(stable=True)]
    origins = origins.index_put((new,), torch.arange(-1, -len(new) - 1, -1, device=new.device))
    made = replace(graphs, parameters=origins.view_as(graphs.parameters))
    return made, [0, *numbers.cumsum(0).tolist()]


def perturb_parameters(
    graphs: Graphs,
    first: list[int],
    old: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    same: int,
    generator: Generator,
    tau: float,
) -> Population:
    """P graphs with their parameters, some perturbed by Gaussian steps, and strategies after eq. 2.

    Args:
        graphs: P graphs with origins in place of parameters.
        first: CSR offsets (A + 1,) of new nodes by action (`with_new_origins`).
        old: (P', N, K) parameters of the parents.
        actions: What nodes can do. They draw the parameters of new nodes; those with origin 0 get
            standard normal ones.
        strategy: (P or more, S).
        same: The number of individuals at the beginning that stay as they are.
        generator: The generator of all random choices.
        tau: The variance of the drift in eq. 2.
    """
    fresh = old.new_zeros(first[-1], old.shape[2])
    for module, begin, end in zip(actions.actions, first, first[1:], strict=False):
        if (k := module.num_parameters) and begin < end:
            fresh[begin:end, :k] = module.initial_parameters(end - begin, generator)
    key = random_key(generator)
    perturb = (
        compiled.perturb_parameters if compiled.takes(graphs, old) else perturb_parameters_in_torch
    )
    if launcher := launcher_of(old.device):
        perturb = partial(gpu.perturb_parameters, launcher)
    made, after = perturb(graphs, old, fresh, actions, strategy, tau, same, key)
    return Population(replace(graphs, parameters=made), after)


def perturb_parameters_in_torch(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    tau: float,
    same: int,
    key: int,
) -> tuple[Tensor, Tensor]:
    """Parameters (P, N, K) and strategies (P, S) of graphs; see `native/engine/parameters.c`.

    New nodes with a row get their parameters from `fresh` (F, K). One random word per parameter
    decides whether it changes, and by how much.
    """
    strategy, own = strategy[: len(graphs)], keys(key, len(graphs))
    out = _at_origins(graphs.parameters, old, fresh)
    _draw_standard(out, graphs, actions, own)
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    before = count.cumsum(1) - count
    row, slot = count.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    random = words(own[row, None], before[row, slot][:, None] + column)
    rate, sigma = strategy.float()[row][:, [RATE, SIGMA]].split(1, 1)
    changes = (uniform_from(random) < rate) & (row >= same)[:, None]
    changes &= column < count[row, slot][:, None]
    values = out[row, slot]
    out[row, slot] = torch.where(changes, values + normal_from(random) * sigma, values)
    return out, torch.cat([strategy[:same], drifted(strategy[same:], factors(own[same:], tau))])


def _draw_standard(out: Tensor, graphs: Graphs, actions: ActionSet, keys: Tensor) -> None:
    """Draw standard normal parameters for new nodes with origin 0, in place."""
    new = graphs.used & (graphs.parameters[..., 0] == 0)
    new &= actions.standard[graphs.action.clamp_min(0)] != 0
    row, slot = new.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    drawn = normal_from(words(keys[row, None], FRESH + slot[:, None] * out.shape[2] + column))
    count = actions.num_parameters[graphs.action[row, slot]]
    out[row, slot] = torch.where(column < count[:, None], drawn, 0).to(out)


def _at_origins(origins: Tensor, old: Tensor, fresh: Tensor) -> Tensor:
    """(P, N, K) the rows that origins (P, N, 1) name, zero for origin 0."""
    table = torch.cat([fresh.flip(0), old.new_zeros(1, old.shape[2]), old.flatten(0, 1)])
    return table[origins[..., 0] + len(fresh)]
