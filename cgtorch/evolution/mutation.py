"""Mutation of graphs, parameters and strategy (section IV-B and eq. 2)."""

from dataclasses import replace

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.evolution.population import STRATEGY, Population
from cgtorch.evolution.sampling import bernoulli, choose, choose_many
from cgtorch.graphs import NO_NODE, Graphs, pruned

TAU = 0.05  # variance of the drift in eq. 2
STRATEGY_MIN, PROBABILITY_MAX, SIGMA_MAX = 1e-3, 1.0, 10.0


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """Every mutation in turn, each with its individual's own rate, then eq. 2 on the rates.

    Add a node, delete a node, replace nodes, change an edge of nodes, perturb parameters, choose
    a new start; last, nodes that the start does not lead to are pruned. The graphs stay valid.
    """
    rate = dict(zip(STRATEGY, population.strategy.unbind(1), strict=True))
    graphs = population.graphs
    graphs = add_node(graphs, actions, rate["add_node"], generator)
    graphs = delete_node(graphs, rate["delete_node"], generator)
    graphs = replace_nodes(graphs, actions, rate["replace_node"], generator)
    graphs = change_edges(graphs, rate["change_edge"], generator)
    graphs = perturb_parameters(graphs, actions, rate["mutate_parameter"], rate["sigma"], generator)
    graphs = new_start(graphs, rate["new_start"], generator)
    return Population(pruned(graphs), drift(population.strategy, tau, generator))


def drift(strategy: Tensor, tau: float, generator: Generator) -> Tensor:
    """Eq. 2, s ← s exp(N(0, τ)) with variance τ, within bounds that keep every rate alive."""
    noise = torch.randn(strategy.shape, generator=generator) * tau**0.5
    drifted = strategy * noise.exp()
    upper = torch.full((strategy.shape[1],), PROBABILITY_MAX)
    upper[STRATEGY.index("sigma")] = SIGMA_MAX
    return drifted.clamp(min=STRATEGY_MIN).minimum(upper)


def add_node(graphs: Graphs, actions: ActionSet, rate: Tensor, generator: Generator) -> Graphs:
    """A random node takes over one incoming edge of a node that has at least two.

    Its own edges go to random nodes. Graphs that are full, or without such an edge, stay.
    """
    p, n, o = graphs.edges.shape
    flat = graphs.edges.flatten(1)
    ones = (flat != NO_NODE).long()
    indegree = torch.zeros(p, n, dtype=torch.long).scatter_add_(1, flat.clamp_min(0), ones)
    spare = (flat != NO_NODE) & (indegree.gather(1, flat.clamp_min(0)) >= 2)
    edge = choose(spare, generator)
    slot = choose(~graphs.used, generator)
    action = torch.randint(len(actions), (p, 1), generator=generator)
    heads = choose_many(graphs.used, (o,), generator)
    heads = torch.where(actions.has_edge[action[:, 0]], heads, NO_NODE)
    parameters = actions.initial_parameters(action, generator)
    adds = bernoulli(rate, (), generator) & spare.any(1) & (~graphs.used).any(1)
    row, slot, edge = adds.nonzero()[:, 0], slot[adds], edge[adds]

    out = Graphs(*(x.clone() for x in vars(graphs).values()))
    out.action[row, slot] = action[adds, 0]
    out.edges[row, slot] = heads[adds]
    out.edges[row, edge // o, edge % o] = slot
    out.parameters[row, slot] = parameters[adds, 0]
    return out


def delete_node(graphs: Graphs, rate: Tensor, generator: Generator) -> Graphs:
    """A random node goes and edges into it turn to random others; two nodes always remain."""
    gone = choose(graphs.used, generator)
    deletes = bernoulli(rate, (), generator) & (graphs.num_nodes > 2)
    at = torch.zeros_like(graphs.used).scatter_(1, gone[:, None], deletes[:, None])
    rest = graphs.used & ~at
    heads = choose_many(rest, graphs.edges.shape[1:], generator)
    into = (graphs.edges == gone[:, None, None]) & deletes[:, None, None]
    edges = torch.where(into, heads, graphs.edges).masked_fill(at[..., None], NO_NODE)
    start = choose(rest, generator)
    return Graphs(
        graphs.action.masked_fill(at, NO_NODE),
        edges,
        graphs.parameters.masked_fill(at[..., None], 0.0),
        torch.where(deletes & (graphs.start == gone), start, graphs.start),
    )


def replace_nodes(graphs: Graphs, actions: ActionSet, rate: Tensor, generator: Generator) -> Graphs:
    """Each node may turn into a new one: action, parameters and edges."""
    at = bernoulli(rate, graphs.action.shape[1:], generator) & graphs.used
    row, slot = at.nonzero(as_tuple=True)
    action = torch.randint(len(actions), row.shape, generator=generator)
    heads = choose_many(graphs.used[row], graphs.edges.shape[2:], generator)
    out = Graphs(*(x.clone() for x in vars(graphs).values()))
    out.action[row, slot] = action
    out.edges[row, slot] = torch.where(actions.has_edge[action], heads, NO_NODE)
    out.parameters[row, slot] = actions.initial_parameters(action, generator)
    return out


def change_edges(graphs: Graphs, rate: Tensor, generator: Generator) -> Graphs:
    """Each node may get a random new head on one of its edges."""
    p, n, o = graphs.edges.shape
    at = bernoulli(rate, (n,), generator)
    which = choose((graphs.edges != NO_NODE).view(-1, o), generator).view(p, n, 1)
    heads = choose_many(graphs.used, (n, o), generator)
    here = at[..., None] & (torch.arange(o) == which) & (graphs.edges != NO_NODE)
    return replace(graphs, edges=torch.where(here, heads, graphs.edges))


def perturb_parameters(
    graphs: Graphs, actions: ActionSet, rate: Tensor, sigma: Tensor, generator: Generator
) -> Graphs:
    """Each parameter may change by a Gaussian of the individual's own standard deviation."""
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    row, slot = count.nonzero(as_tuple=True)
    before = graphs.parameters[row, slot]
    at = bernoulli(rate[row], before.shape[1:], generator)
    at &= torch.arange(before.shape[1]) < count[row, slot][:, None]
    step = torch.randn(before.shape, generator=generator) * sigma[row, None]
    parameters = graphs.parameters.clone()
    parameters[row, slot] = torch.where(at, before + step, before)
    return replace(graphs, parameters=parameters)


def new_start(graphs: Graphs, rate: Tensor, generator: Generator) -> Graphs:
    """The start moves to a random node that has an edge to another node."""
    slot = torch.arange(graphs.capacity)[:, None]
    leads = ((graphs.edges != NO_NODE) & (graphs.edges != slot)).any(2) & graphs.used
    moves = bernoulli(rate, (), generator) & leads.any(1)
    return replace(graphs, start=torch.where(moves, choose(leads, generator), graphs.start))
