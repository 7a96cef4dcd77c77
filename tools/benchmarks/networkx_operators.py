"""Crossover and mutation of one pair of networkx graphs at a time: the same operators, written out.

A graph is what `cgtorch.graphs.to_networkx` gives: nodes with `action` and `parameters`, an edge
per outcome, the start as an attribute of the graph. Only children are copied; all else is in place.
"""

import math
from dataclasses import dataclass
from random import Random
from typing import Any, TypeAlias

import networkx as nx

from cgtorch.evolution import Population
from cgtorch.evolution.population import PROBABILITY_MAX, SIGMA_MAX, STRATEGY, STRATEGY_MIN, TAU
from cgtorch.graphs import ActionSet, to_networkx

Graph: TypeAlias = Any  # nx.MultiDiGraph
Strategy: TypeAlias = dict[str, float]


@dataclass(frozen=True)
class Individual:
    """A graph and the strategy parameters by name."""

    graph: Graph
    strategy: Strategy


@dataclass(frozen=True)
class Kinds:
    """What nodes can be: names, outcomes that lead on, and numbers of parameters."""

    names: tuple[str, ...]
    outcomes: dict[str, tuple[str, ...]]
    parameters: dict[str, int]


def kinds_of(actions: ActionSet) -> Kinds:
    """The actions as plain data."""
    pairs = list(zip(actions.names, actions.actions, strict=True))
    leads = {name: tuple(o for o in a.outcomes if o not in a.terminal) for name, a in pairs}
    return Kinds(actions.names, leads, {name: a.num_parameters for name, a in pairs})


def individuals(population: Population, actions: ActionSet) -> list[Individual]:
    """The population one by one."""
    return [
        Individual(
            to_networkx(population.graphs, actions, i), dict(zip(STRATEGY, row, strict=True))
        )
        for i, row in enumerate(population.strategy.tolist())
    ]


def offspring(
    first: Individual, second: Individual, kinds: Kinds, capacity: int, random: Random
) -> tuple[Individual, Individual]:
    """Two children of two parents: crossover, then every mutation."""
    children = crossover(first, second, random)
    for child in children:
        mutate(child, kinds, capacity, random)
    return children


def crossover(
    first: Individual, second: Individual, random: Random
) -> tuple[Individual, Individual]:
    """Swap what a breadth-first search finds around a random node of either parent."""
    one, two = first.graph.copy(), second.graph.copy()
    half = min(len(one), len(two)) // 2
    probability = (first.strategy["crossover"] + second.strategy["crossover"]) / 2
    if half and random.random() < probability:
        k = random.randint(1, half)
        here, there = group(first.graph, k, random), group(second.graph, k, random)
        graft(one, here, second.graph, there, random)
        graft(two, there, first.graph, here, random)
        prune(one)
        prune(two)
    return Individual(one, dict(first.strategy)), Individual(two, dict(second.strategy))


def group(graph: Graph, k: int, random: Random) -> list[Any]:
    """The k nodes that an undirected breadth-first search from a random node meets first."""
    successors, predecessors = graph._succ, graph._pred
    found = [random.choice(list(graph))]
    seen, wave = set(found), found
    while len(found) < k:
        near = {n for node in wave for step in (successors, predecessors) for n in step[node]}
        wave = list(near - seen)
        random.shuffle(wave)
        seen.update(wave)
        found = found + wave
    return found[:k]


def graft(host: Graph, here: list[Any], donor: Graph, there: list[Any], random: Random) -> None:
    """The host's group becomes the donor's, node by node; edges into it stay."""
    place, nodes = dict(zip(there, here, strict=True)), list(host)
    for old, new in place.items():
        rewire(
            host,
            new,
            donor.nodes[old]["action"],
            donor.nodes[old]["parameters"],
            {
                outcome: place[head] if head in place else random.choice(nodes)
                for _, head, outcome in donor.edges(old, keys=True)
            },
        )


def rewire(
    graph: Graph, node: Any, action: str, parameters: list[float], heads: dict[str, Any]
) -> None:
    """Give a node of the graph an action and edges, in place of those it has."""
    graph.remove_edges_from(list(graph.edges(node, keys=True)))
    graph.nodes[node].update(action=action, parameters=list(parameters))
    for outcome, head in heads.items():
        graph.add_edge(node, head, outcome, outcome=outcome)


def prune(graph: Graph) -> None:
    """Remove what the start does not lead to."""
    start = graph.graph["start"]
    graph.remove_nodes_from(set(graph) - nx.descendants(graph, start) - {start})


def mutate(individual: Individual, kinds: Kinds, capacity: int, random: Random) -> None:
    """Every mutation in turn, in place, then the drift of the strategy."""
    graph, rate = individual.graph, individual.strategy
    if random.random() < rate["add_node"]:
        add_node(graph, kinds, capacity, random)
    if random.random() < rate["delete_node"] and len(graph) > 2:
        delete_node(graph, random)
    nodes = list(graph)
    for node in nodes:
        if random.random() < rate["replace_node"]:
            renew(graph, node, nodes, kinds, random)
    for node in nodes:
        if random.random() < rate["change_edge"] and graph._succ[node]:
            _, head, outcome = random.choice(list(graph.edges(node, keys=True)))
            graph.remove_edge(node, head, outcome)
            graph.add_edge(node, random.choice(nodes), outcome, outcome=outcome)
    for node in nodes:
        graph.nodes[node]["parameters"] = [
            x + random.gauss(0, rate["sigma"]) if random.random() < rate["mutate_parameter"] else x
            for x in graph.nodes[node]["parameters"]
        ]
    if random.random() < rate["new_start"]:
        leading = [n for n in nodes if graph._succ[n].keys() - {n}]
        if leading:
            graph.graph["start"] = random.choice(leading)
    prune(graph)
    for name, value in rate.items():
        most = SIGMA_MAX if name == "sigma" else PROBABILITY_MAX
        rate[name] = min(max(value * math.exp(random.gauss(0, TAU**0.5)), STRATEGY_MIN), most)


def add_node(graph: Graph, kinds: Kinds, capacity: int, random: Random) -> None:
    """A new node takes over one edge of those into a node that has at least two."""
    spare = [edge for edge in graph.edges(keys=True) if graph.in_degree(edge[1]) >= 2]
    if not spare or len(graph) >= capacity:
        return
    nodes, new = list(graph), max(graph) + 1
    tail, head, outcome = random.choice(spare)
    graph.add_node(new)
    renew(graph, new, nodes, kinds, random)
    graph.remove_edge(tail, head, outcome)
    graph.add_edge(tail, new, outcome, outcome=outcome)


def delete_node(graph: Graph, random: Random) -> None:
    """A random node goes; edges into it turn to random others."""
    gone = random.choice(list(graph))
    into = [(tail, outcome) for tail, _, outcome in graph.in_edges(gone, keys=True) if tail != gone]
    graph.remove_node(gone)
    rest = list(graph)
    for tail, outcome in into:
        graph.add_edge(tail, random.choice(rest), outcome, outcome=outcome)
    if graph.graph["start"] == gone:
        graph.graph["start"] = random.choice(rest)


def renew(graph: Graph, node: Any, nodes: list[Any], kinds: Kinds, random: Random) -> None:
    """A random action with new parameters, and edges to random `nodes`."""
    action = random.choice(kinds.names)
    parameters = [random.gauss(0, 1) for _ in range(kinds.parameters[action])]
    heads = {outcome: random.choice(nodes) for outcome in kinds.outcomes[action]}
    rewire(graph, node, action, parameters, heads)
