"""Removing nodes from a large graph to make it readable."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.evolution import Fitness, Population, chance_of_success, evaluator
from cgtorch.graphs import NO_NODE, ActionSet, Graphs, pruned
from cgtorch.ground.environment import Environment

READABLE = 10  # nodes that a picture shows at a glance
SLACK = 1e-3  # of the fitness that a smaller graph may cost


def shrunk(
    champion: Population,
    actions: ActionSet,
    environment: Environment,
    max_transitions: int,
    fitness: Fitness = chance_of_success,
    device: torch.device | str = "cpu",
) -> Population:
    """The individual with nodes removed until it is readable, as long as it does not get worse.

    For every pair of nodes, all edges into one are led to the other in the models, all pairs at
    once. Among those that still solve all scenarios, the one with the fewest nodes is taken, and so
    on. The champion is a population of one. The environment, on `device`, contains its scenarios.
    For the rest see `cgtorch.evolution.evaluator`.
    """
    nothing = torch.zeros(environment.num_scenarios, dtype=torch.bool, device=device)
    evaluation = evaluator(actions, environment, nothing, max_transitions, fitness=fitness)

    def tried(graphs: Graphs) -> tuple[Tensor, Tensor]:
        result = evaluation(graphs)
        return result.fitness, result.succeeded

    before, solved = tried(champion.graphs)
    while int(champion.graphs.num_nodes) > READABLE:
        smaller = _without_each(champion.graphs)
        fitnesses, succeeded = tried(smaller)
        well = (fitnesses >= before - SLACK) & (succeeded | ~solved).all(1)
        if not well.any():
            break
        nodes = smaller.num_nodes.masked_fill(~well, champion.graphs.capacity + 1)
        best = nodes == nodes.amin()
        index = int(fitnesses.masked_fill(~best, -torch.inf).argmax())
        champion = replace(champion, graphs=smaller[index : index + 1])
    return champion


def _without_each(graphs: Graphs) -> Graphs:
    """One graph with n nodes as n (n - 1) graphs: edges into node i lead to node j instead."""
    used = graphs.used[0].nonzero()[:, 0]
    gone, to = (x.flatten() for x in torch.meshgrid(used, used, indexing="ij"))
    gone, to = gone[gone != to], to[gone != to]
    many = graphs[torch.zeros_like(gone)]
    slot = torch.arange(graphs.capacity) == gone[:, None]
    edges = torch.where(many.edges == gone[:, None, None], to[:, None, None], many.edges)
    return pruned(
        Graphs(
            many.action.masked_fill(slot, NO_NODE),
            edges.masked_fill(slot[..., None], NO_NODE),
            many.parameters.masked_fill(slot[..., None], 0.0),
            torch.where(many.start == gone, to, many.start),
        )
    )
