"""Parameters of nodes: those of new ones, and Gaussian steps of some of all."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.graphs import Graphs


def initialise_(
    graphs: Graphs, fresh: Tensor, actions: ActionSet, generator: Generator
) -> None:
    """Give new nodes (P, N) their parameters, in place."""
    row, slot = fresh.nonzero(as_tuple=True)
    new = actions.initial_parameters(graphs.action[row, slot], generator)
    graphs.parameters[row, slot] = new


def perturb_(
    graphs: Graphs, actions: ActionSet, rate: Tensor, sigma: Tensor, generator: Generator
) -> None:
    """Change each parameter with some probability by a Gaussian step, in place.

    Args:
        graphs: P of them.
        actions: what the nodes are.
        rate: (P,) probability that a parameter changes.
        sigma: (P,) standard deviations of the steps.
        generator: of the choices and of the steps; a step is drawn only where one is taken.
    """
    way = compiled.perturb_ if compiled.takes(graphs) else perturb_in_torch_
    way(graphs, actions, rate, sigma, generator)


def perturb_in_torch_(
    graphs: Graphs, actions: ActionSet, rate: Tensor, sigma: Tensor, generator: Generator
) -> None:
    """The same; `native/parameters.c` does it to one individual after the other."""
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    row, slot = count.nonzero(as_tuple=True)
    count = count[row, slot]
    owner = row.repeat_interleave(count)
    hit = torch.rand(len(owner), generator=generator) < rate[owner]
    step = torch.randn(int(hit.sum()), generator=generator) * sigma[owner[hit]]
    values = graphs.parameters[row, slot]
    real = torch.arange(values.shape[1]) < count[:, None]
    values[real.masked_scatter(real, hit)] += step
    graphs.parameters[row, slot] = values
