"""Mutation of graphs, parameters and strategy (section IV-B and eq. 2)."""

import math
from functools import cache

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution import compiled
from cgtorch.evolution.choices import choices_for
from cgtorch.evolution.parameters import changed, marked
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.evolution.structure import restructured

TAU = 0.05  # variance of the drift in eq. 2
STRATEGY_MIN, PROBABILITY_MAX, SIGMA_MAX = 1e-3, 1.0, 10.0


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """Every mutation in turn, each with its individual's own rate, then eq. 2 on the rates.

    Add a node, delete a node, replace nodes, change an edge of nodes, choose a new start; nodes
    that the start does not lead to are pruned; last, perturb parameters. The graphs stay valid.

    The children are the same to the last bit whatever way the operators run, compiled for the CPU
    or in torch: all choices follow from numbers that are functions of the individual's place.
    """
    graphs, strategy = marked(population.graphs), population.strategy
    old, capacity = population.graphs.parameters, graphs.capacity
    nodes = int(graphs.num_nodes.max()) if len(graphs) else 0
    choices = choices_for(strategy, nodes, capacity, generator)
    way = compiled.restructured if compiled.takes(graphs, old) else restructured
    made = way(graphs, choices, actions, capacity)
    return Population(
        changed(made, old, actions, strategy, 0, generator), drift(strategy, tau, generator)
    )


def drift(strategy: Tensor, tau: float, generator: Generator) -> Tensor:
    """Eq. 2, s ← s exp(N(0, τ)) with variance τ, within bounds that keep every rate alive."""
    noise = torch.randn(strategy.shape, generator=generator).mul_(tau**0.5 / math.log(2))
    drifted = noise.exp2_().mul_(strategy)  # exp of so few numbers already goes to all threads
    return torch.minimum(drifted.clamp_(min=STRATEGY_MIN), _upper(), out=drifted)


@cache
def _upper() -> Tensor:
    """(S,) the most that each strategy parameter may be."""
    upper = torch.full((len(STRATEGY),), PROBABILITY_MAX)
    upper[STRATEGY.index("sigma")] = SIGMA_MAX
    return upper
