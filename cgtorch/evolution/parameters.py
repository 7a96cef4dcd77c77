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
from cgtorch.evolution.sampling import IN_A_WORD, uniform, words
from cgtorch.graphs import Graphs


def marked(graphs: Graphs) -> Graphs:
    """The graphs with marks (P, N, 1) in place of parameters, slot by slot from 1 on, 0 if unused."""
    marks = torch.arange(1, graphs.action.numel() + 1).view_as(graphs.action) * graphs.used
    return replace(graphs, parameters=marks[..., None])


def copied(graphs: Graphs, old: Tensor) -> Graphs:
    """Marked graphs with the parameters that their marks point to in those of parents (P, N, K)."""
    none = old.new_zeros(0, old.shape[2])
    return replace(graphs, parameters=_at_marks(graphs.parameters, old, none))


def changed(
    graphs: Graphs,
    old: Tensor,
    actions: ActionSet,
    rate: Tensor,
    sigma: Tensor,
    generator: Generator,
) -> Graphs:
    """Marked graphs with parameters, each of which may have changed by a Gaussian step.

    Args:
        graphs: P of them; a node without a mark is new and gets initial parameters.
        old: (P', N, K) parameters of parents, which marks point to.
        actions: what the nodes are.
        rate: (P,) probability that a parameter changes.
        sigma: (P,) standard deviations of the steps.
        generator: of new parameters, of the choices and of the steps; a step is drawn only where
            one is taken.
    """
    graphs = replace(graphs, parameters=graphs.parameters.clone())
    native = compiled.takes(graphs, old)
    new = compiled.mark_new_(graphs) if native else mark_new_(graphs)
    fresh = old.new_zeros(len(new), old.shape[2])
    _initialise_(fresh, graphs.action.view(-1)[new], actions, generator)
    way = compiled.parameters if native else parameters
    made = way(graphs, old, fresh, actions, rate, sigma, generator)
    return replace(graphs, parameters=made)


def mark_new_(graphs: Graphs) -> Tensor:
    """(F,) which of all slots hold nodes without a mark; these get marks -1, -2, ..., in place."""
    marks = graphs.parameters.view(-1)
    new = (graphs.used.view(-1) & (marks == 0)).nonzero()[:, 0]
    marks[new] = torch.arange(-1, -len(new) - 1, -1)
    return new


def _initialise_(rows: Tensor, action: Tensor, actions: ActionSet, generator: Generator) -> None:
    """Fill rows (F, K) with parameters of new nodes of the given actions (F,), one after the other."""
    for i, module in enumerate(actions.actions):
        if k := module.num_parameters:
            nodes = (action == i).nonzero()[:, 0]
            if len(nodes):
                rows[nodes, :k] = module.initial_parameters(len(nodes), generator).to(rows.dtype)


def parameters(
    graphs: Graphs,
    old: Tensor,
    fresh: Tensor,
    actions: ActionSet,
    rate: Tensor,
    sigma: Tensor,
    generator: Generator,
) -> Tensor:
    """(P, N, K) in torch; `native/parameters.c` makes them for one individual after the other.

    Args:
        graphs: P of them; mark r > 0 is row r - 1 of `old`, r < 0 row -r - 1 of `fresh`.
        old: (P', N, K).
        fresh: (F, K).
        actions: see `changed`, as of all that follows.
        rate: (P,).
        sigma: (P,).
        generator: of choices and steps.
    """
    out = _at_marks(graphs.parameters, old, fresh)
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    row, slot = count.nonzero(as_tuple=True)
    count = count[row, slot]
    owner = row.repeat_interleave(count)
    # Each individual's numbers begin with a word of its own.
    each = torch.bincount(owner, minlength=len(graphs))
    whole = (each + IN_A_WORD - 1) // IN_A_WORD
    place = torch.arange(len(owner)) - (each.cumsum(0) - each)[owner]
    place += IN_A_WORD * (whole.cumsum(0) - whole)[owner]
    draws = words((int(whole.sum()), 1), generator)
    hit = uniform(draws, IN_A_WORD).flatten()[place] < rate[owner]
    step = torch.randn(int(hit.sum()), generator=generator) * sigma[owner[hit]]
    values = out[row, slot]
    real = torch.arange(values.shape[1]) < count[:, None]
    values[real.masked_scatter(real, hit)] += step
    out[row, slot] = values
    return out


def _at_marks(marks: Tensor, old: Tensor, fresh: Tensor) -> Tensor:
    """(P, N, K) rows that marks (P, N, 1) point to, zero where there is none."""
    table = torch.cat([fresh.flip(0), old.new_zeros(1, old.shape[2]), old.flatten(0, 1)])
    return table[marks[..., 0] + len(fresh)]
