"""Parameters of children: copied from parents or new, and Gaussian steps of some of them.

Operators on structure move nodes about and never look at parameters. They are given graphs whose
nodes carry a mark in place of parameters, which says where these come from, so that parameters are
copied once, at the end, and only those of nodes that remain.
"""

from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.drift import drifted, factors
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.evolution.sampling import key, keys, normal, uniform, words
from cgtorch.graphs import Graphs

RATE, SIGMA = STRATEGY.index("mutate_parameter"), STRATEGY.index("sigma")


def marked(graphs: Graphs) -> Graphs:
    """The graphs with marks (P, N, 1) in place of parameters: 1 + the slot among all of them."""
    marks = torch.arange(1, graphs.action.numel() + 1).view_as(graphs.action) * graphs.used
    return replace(graphs, parameters=marks[..., None])


def copied(graphs: Graphs, old: Tensor) -> Graphs:
    """Marked graphs with the parameters that their marks point to in those of parents (P, N, K)."""
    none = old.new_zeros(0, old.shape[2])
    return replace(graphs, parameters=_at_marks(graphs.parameters, old, none))


def mark_new(graphs: Graphs, actions: int) -> tuple[Graphs, list[int]]:
    """The graphs with new nodes, which have no mark, marked with -1, -2, …: first all of action 0.

    Returns:
        The graphs, and after how many the new nodes of each action begin, and how many there are.
    """
    action, marks = graphs.action.flatten(), graphs.parameters.flatten()
    new = ((action >= 0) & (marks == 0)).nonzero()[:, 0]
    numbers = torch.bincount(action[new], minlength=actions)
    new = new[action[new].argsort(stable=True)]
    marks = marks.index_put((new,), torch.arange(-1, -len(new) - 1, -1))
    made = replace(graphs, parameters=marks.view_as(graphs.parameters))
    return made, [0, *numbers.cumsum(0).tolist()]


def changed(
    graphs: Graphs,
    first: list[int],
    old: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    same: int,
    generator: Generator,
    tau: float,
) -> Population:
    """Marked graphs with parameters, each of which may have changed by a Gaussian step, and eq. 2.

    Args:
        graphs: P of them.
        first: after how many the new nodes of each action begin, and how many there are; they get
            initial parameters.
        old: (P', N, K) parameters of parents, which marks point to.
        actions: what the nodes are.
        strategy: (P at least, S), with the probability that a parameter changes and the standard
            deviation of the steps. It drifts after that.
        same: individuals that come first and stay as they are.
        generator: of new parameters, of the choices, of the steps and of the drift.
        tau: variance of the drift.
    """
    fresh = old.new_zeros(first[-1], old.shape[2])
    for module, begin, end in zip(actions.actions, first, first[1:], strict=False):
        if (k := module.num_parameters) and begin < end:
            fresh[begin:end, :k] = module.initial_parameters(end - begin, generator)
    all_choices, by = key(generator), factors(len(strategy) - same, tau, generator)
    way = compiled.changed if compiled.takes(graphs, old) else _changed
    made, after = way(graphs, old, fresh, actions, strategy, by, same, all_choices)
    return Population(Graphs(graphs.action, graphs.edges, made, graphs.start), after)


def _changed(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    factors: Tensor,
    same: int,
    key: int,
) -> tuple[Tensor, Tensor]:
    """Parameters and strategies of P graphs, in torch; `native/parameters.c` changes both."""
    strategy, factors = strategy[: len(graphs)], factors[: len(graphs) - same]
    made = parameters(graphs, old, fresh, actions, strategy, same, key)
    return made, torch.cat([strategy[:same], drifted(strategy[same:], factors)])


def parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    strategy: Tensor,
    same: int,
    key: int,
) -> Tensor:
    """(P, N, K) in torch; `native/parameters.c` makes them for one individual after the other.

    Args:
        graphs: P of them; mark r > 0 is row r - 1 of `old`, r < 0 row -r - 1 of `fresh`.
        old: (P', N', K).
        fresh: (F, K).
        actions: see `changed`, as of all that follows.
        strategy: (P, S).
        same: individuals that stay.
        key: of all choices and steps. Each parameter has one word, which says both whether it
            changes and by how much.
    """
    out = _at_marks(graphs.parameters, old, fresh)
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    before = count.cumsum(1) - count
    row, slot = count.nonzero(as_tuple=True)
    column = torch.arange(out.shape[2])
    random = words(keys(key, len(graphs))[row, None], before[row, slot][:, None] + column)
    rate, sigma = strategy.float()[row][:, [RATE, SIGMA]].split(1, 1)
    changes = (uniform(random) < rate) & (row >= same)[:, None]
    changes &= column < count[row, slot][:, None]
    values = out[row, slot]
    out[row, slot] = torch.where(changes, values + normal(random) * sigma, values)
    return out


def _at_marks(marks: Tensor, old: Tensor, fresh: Tensor) -> Tensor:
    """(P, N, K) rows that marks (P, N, 1) point to, zero where there is none."""
    table = torch.cat([fresh.flip(0), old.new_zeros(1, old.shape[2]), old.flatten(0, 1)])
    return table[marks[..., 0] + len(fresh)]
