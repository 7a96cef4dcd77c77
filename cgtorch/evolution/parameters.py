"""Parameters of children: copied from parents or new, and Gaussian steps of some of them.

Operators on structure move nodes about and never look at parameters. They are given graphs whose
nodes carry the origin of their parameters in place of these, so that parameters are copied once, at
the end, and only those of nodes that remain. The origin is r + 1 for row r of the parameters of all
parents, -r - 1 for row r of those drawn for new nodes, and 0 for a new node without a number.
"""

from dataclasses import replace
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled, gpu
from cgtorch.evolution.population import STRATEGY, Population, drifted, factors
from cgtorch.graphs import Graphs
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
    """The graphs with origins (P, N, 1) in place of parameters: 1 + the slot among all of them."""
    origins = torch.arange(1, graphs.action.numel() + 1).view_as(graphs.action) * graphs.used
    return replace(graphs, parameters=origins[..., None])


def copied(graphs: Graphs, old: Tensor) -> Graphs:
    """Graphs with the parameters that their origins point to in those of parents (P, N, K)."""
    none = old.new_zeros(0, old.shape[2])
    return replace(graphs, parameters=_at_origins(graphs.parameters, old, none))


def with_new_origins(graphs: Graphs, standard: Tensor) -> tuple[Graphs, list[int]]:
    """The graphs with origins -1, -2, … of new nodes: first all of action 0, and so on.

    And the CSR offsets by action: where those of each action begin, and how many there are. Those
    of actions whose parameters are `standard` (A,) normal keep 0.
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
    """P graphs with parameters, each of which may have changed by a Gaussian step, and eq. 2.

    Graphs have origins: new nodes with a number, of which `first` tells (`with_new_origins`), get
    what their action wants, those without one standard normal parameters, and others those of
    parents (P', N, K). Strategies (P at least, S) drift after the steps, with variance `tau`. The
    `same` individuals that come first stay as they are.
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

    New nodes with a number have the parameters `fresh` (F, K). One word for each parameter says
    whether it changes and by how much.
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
    """Standard normal numbers for nodes without origin whose actions want them, in place."""
    new = graphs.used & (graphs.parameters[..., 0] == 0)
    new &= actions.standard[graphs.action.clamp_min(0)] != 0
    row, slot = new.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    drawn = normal_from(words(keys[row, None], FRESH + slot[:, None] * out.shape[2] + column))
    count = actions.num_parameters[graphs.action[row, slot]]
    out[row, slot] = torch.where(column < count[:, None], drawn, 0).to(out)


def _at_origins(origins: Tensor, old: Tensor, fresh: Tensor) -> Tensor:
    """(P, N, K) rows that origins (P, N, 1) point to, zero where there is none."""
    table = torch.cat([fresh.flip(0), old.new_zeros(1, old.shape[2]), old.flatten(0, 1)])
    return table[origins[..., 0] + len(fresh)]
