"""The genetic operators (section IV-B): crossover, mutation, and both at once with the elite.

They run in C where it supports the graphs (`compiled`), else in torch (`operators_in_torch`), with
the same children, bit for bit. Every random number is a function of a key and of the child's index.
"""

from dataclasses import replace

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.evolution import compiled, operators_in_torch
from cgtorch.evolution.population import STRATEGY, TAU, Population
from cgtorch.graphs import ActionSet, Graphs, concatenate, widened
from cgtorch.ground.counter_rng import random_key


def crossover(first: Population, second: Population, generator: Generator) -> Population:
    """2 Q children of Q pairs of parents; the first Q keep the other nodes of the first parents.

    In each parent, an undirected breadth-first search from a random node collects the first k
    nodes, with k uniform in 1 … half the size of the smaller parent. These k nodes are swapped one
    by one. Edges within a group are kept; edges that leave it lead to random nodes of the new
    graph. A pair is crossed with the mean of the parents' crossover probabilities, and copied
    otherwise. The parameters of a node are never mixed.
    """
    graphs = concatenate([first.graphs, second.graphs])
    parents = Population(graphs, torch.cat([first.strategy, second.strategy]))
    every, keys = torch.arange(len(graphs)), (random_key(generator), 0)
    children = breed(parents, every[:0], every, keys, None, graphs.capacity)[0]
    old = graphs.parameters
    made = operators_in_torch.at_origins(children.parameters, old, old.new_zeros(0, old.shape[2]))
    return Population(replace(children, parameters=made), parents.strategy)


def mutate(
    population: Population, actions: ActionSet, generator: Generator, tau: float = TAU
) -> Population:
    """All mutations in turn, each with its individual's own rate, then eq. 2 on the rates.

    The mutations add a node, delete a node, replace nodes, change an edge of nodes, and choose a
    new start. Unreachable nodes are pruned. Last, parameters are perturbed. The graphs stay valid.
    """
    graphs, strategy, p = population.graphs, population.strategy, len(population)
    rates = strategy.clone()
    rates[:, STRATEGY.index("crossover")] = 0
    if p % 2:  # pad to whole pairs with an individual that does not change
        graphs, rates = concatenate([graphs, graphs[:1]]), pad(rates, (0, 0, 0, 1))
    every, keys = torch.arange(len(graphs)), (0, random_key(generator))
    made, _, first = breed(
        Population(graphs, rates), every[:0], every, keys, actions, graphs.capacity
    )
    made, old = widened(made[:p], graphs.capacity), population.graphs.parameters
    return perturb_parameters(made, first, old, actions, strategy, 0, generator, tau)


def offspring(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    actions: ActionSet,
    generator: Generator,
    capacity: int,
    tau: float = TAU,
    size: int | None = None,
) -> Population:
    """The elite (E,) unchanged, then children of parents (2 Q,) by `crossover` and `mutate`.

    Args:
        population: The evaluated individuals.
        elite: (E,) long, the individuals to copy.
        parents: (2 Q,) long, the first parents of all pairs, then the second ones.
        actions: What nodes can do.
        generator: The generator of all random choices.
        capacity: The largest number of nodes of a child.
        tau: The variance of the drift in eq. 2.
        size: Number of individuals to return, E + 2 Q by default; it does not change them.

    Raises:
        IndexError: An index in `elite` or `parents` is not in the population.
    """
    keys, old = (random_key(generator), random_key(generator)), population.graphs.parameters
    made, strategy, first = breed(population, elite, parents, keys, actions, capacity)
    same = len(elite)
    return perturb_parameters(made[:size], first, old, actions, strategy, same, generator, tau)


def breed(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """The elite (E,) and children of parents (2 Q,), with origins in place of parameters.

    Without actions, children are not mutated. `keys` determine the random numbers of pairs and of
    children. The strategies (E + 2 Q, S) of elite and parents, and the offsets of
    `with_new_origins`, are returned, too.
    """
    graphs, slots = population.graphs, min(population.graphs.capacity + 1, capacity)
    fast = compiled.takes(graphs, graphs.parameters, slots)
    how = compiled.breed if fast else operators_in_torch.breed
    made, strategy = how(population, elite, parents, keys, actions, capacity)
    if actions is None:
        return made, strategy, []
    made, first = with_new_origins(made, actions.standard)
    return made, strategy, first


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

    The graphs carry origins, of which those of new nodes begin at `first` (A + 1,) for each action
    (`with_new_origins`). `old` (P', N, K) are the parameters of the parents; actions draw those of
    new nodes. The first `same` individuals, with `strategy` (P or more, S), stay as they are.
    """
    fresh = old.new_zeros(first[-1], old.shape[2])
    for module, begin, end in zip(actions.actions, first, first[1:], strict=False):
        if (k := module.num_parameters) and begin < end:
            fresh[begin:end, :k] = module.initial_parameters(end - begin, generator)
    how = compiled if compiled.takes(graphs, old) else operators_in_torch
    about = graphs, old, fresh, actions, strategy, tau, same, random_key(generator)
    made, after = how.perturb_parameters(*about)
    return Population(replace(graphs, parameters=made), after)
