"""Children of a generation: crossover, mutation, and both at once with the elite (section IV-B).

Compiled operators and those in torch give the same children, bit for bit. Every random number is a
function of a key and of the child's index.
"""

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from cgtorch.evolution import compiled, gpu
from cgtorch.evolution.crossover import swapped
from cgtorch.evolution.parameters import copied, perturb_parameters, with_new_origins, with_origins
from cgtorch.evolution.population import STRATEGY, TAU, Population
from cgtorch.evolution.structure import restructured
from cgtorch.graphs import ActionSet, Graphs, compacted, concatenate, narrowed, widened
from cgtorch.ground.counter_rng import random_key
from cgtorch.native.gpu import launcher_of


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
    return Population(copied(children, graphs.parameters), parents.strategy)


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
    if p % 2:  # somebody who does not change makes up a pair with the last one
        graphs, rates = concatenate([graphs, graphs[:1]]), pad(rates, (0, 0, 0, 1))
    every, keys = torch.arange(len(graphs)), (0, random_key(generator))
    alone = Population(graphs, rates)
    made, _, first = breed(alone, every[:0], every, keys, actions, graphs.capacity)
    made = widened(made[:p], graphs.capacity)
    old = population.graphs.parameters
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
        capacity: The largest number of nodes of a child. Children have only as many slots as the
            largest child may need.
        tau: The variance of the drift in eq. 2.
        size: Number of individuals to return, E + 2 Q by default; it does not change them.

    Raises:
        IndexError: An index in `elite` or `parents` is not in the population.
    """
    keys, old = (random_key(generator), random_key(generator)), population.graphs.parameters
    made, strategy, first = breed(population, elite, parents, keys, actions, capacity)
    return perturb_parameters(
        made[:size], first, old, actions, strategy, len(elite), generator, tau
    )


def breed(
    population: Population,
    elite: Tensor,
    parents: Tensor,
    keys: tuple[int, int],
    actions: ActionSet | None,
    capacity: int,
) -> tuple[Graphs, Tensor, list[int]]:
    """The elite (E,) and children of parents (2 Q,), before parameters are copied.

    Without actions, children are not mutated. `keys` determine the random numbers of pairs and of
    children. Returned are graphs with origins in place of parameters
    (`cgtorch.evolution.parameters`), the strategies (E + 2 Q, S) of elite and parents, and the
    offsets of `with_new_origins`.
    """
    graphs, slots = population.graphs, min(population.graphs.capacity + 1, capacity)
    if launcher := launcher_of(graphs.start.device):
        made, strategy = gpu.breed(launcher, population, elite, parents, keys, actions, capacity)
        made, begins = with_new_origins(made, _standard(actions))
        return made, strategy, begins
    if compiled.takes(graphs, graphs.parameters, slots):
        return compiled.breed(population, elite, parents, keys, actions, capacity)
    rows = torch.cat([elite, parents])
    strategy = population.strategy.index_select(0, rows)
    width = int(graphs.num_nodes[rows].max()) if len(rows) else 0
    rates = strategy[len(elite) :].float()
    children = swapped(graphs, parents, rates, keys[0], width)
    if actions is None:
        slots = graphs.capacity
    else:
        slots = min(width + 1, capacity)
        children = restructured(children, rates, keys[1], actions, slots)
    first = compacted(with_origins(graphs)[elite])
    first = narrowed(widened(first, max(graphs.capacity, slots)), slots)
    made, begins = with_new_origins(concatenate([first, children]), _standard(actions))
    return made, strategy, begins


def _standard(actions: ActionSet | None) -> torch.Tensor:
    return torch.zeros(0, dtype=torch.long) if actions is None else actions.standard
