"""Mutation of graphs, parameters and strategy (section IV-B and eq. 2)."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.parameters import changed, marked
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.evolution.sampling import words, words_for
from cgtorch.evolution.structure import columns, restructured
from cgtorch.graphs import Graphs

TAU = 0.05  # variance of the drift in eq. 2
STRATEGY_MIN, PROBABILITY_MAX, SIGMA_MAX = 1e-3, 1.0, 10.0


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """Every mutation in turn, each with its individual's own rate, then eq. 2 on the rates.

    Add a node, delete a node, replace nodes, change an edge of nodes, choose a new start; nodes
    that the start does not lead to are pruned; last, perturb parameters. The graphs stay valid.

    All choices follow from numbers that are drawn first, of which there are as many whatever way
    the operators run: compiled for the CPU, or in torch, with the same children to the last bit.
    """
    graphs = marked(population.graphs)
    return remade(graphs, population.graphs.parameters, population.strategy, actions, generator, tau)


def remade(
    graphs: Graphs,
    old: Tensor,
    strategy: Tensor,
    actions: ActionSet,
    generator: Generator,
    tau: float,
) -> Population:
    """`mutate` for marked graphs, whose parameters lie in `old` (P', N, K)."""
    rates = strategy.float()
    rate = dict(zip(STRATEGY, rates.unbind(1), strict=True))
    width = min(int(graphs.num_nodes.max()) + 1, graphs.capacity) if len(graphs) else 0
    count = words_for(columns(width, actions.outcome_capacity))
    draws = words((len(graphs), count), generator)
    way = compiled.restructured if compiled.takes(graphs, old) else restructured
    graphs = way(graphs, rates, draws, width, actions)
    graphs = changed(graphs, old, actions, rate["mutate_parameter"], rate["sigma"], generator)
    return Population(graphs, drift(strategy, tau, generator))


def drift(strategy: Tensor, tau: float, generator: Generator) -> Tensor:
    """Eq. 2, s ← s exp(N(0, τ)) with variance τ, within bounds that keep every rate alive."""
    noise = torch.randn(strategy.shape, generator=generator) * tau**0.5
    drifted = strategy * noise.exp_()
    upper = torch.full((strategy.shape[1],), PROBABILITY_MAX)
    upper[STRATEGY.index("sigma")] = SIGMA_MAX
    return drifted.clamp_(min=STRATEGY_MIN).minimum(upper)
