"""Specialists become as small as they can be without getting worse."""

import torch
from support import model, random_graphs
from torch import Tensor

from cgtorch.evolution import Population, evaluator, initial_strategy
from cgtorch.graphs import valid
from cgtorch.improvement.specialists import READABLE, _without_each, shrunk
from cgtorch.simulation import Rollouts
from cgtorch.tabletop.actions import paper_actions

ACTIONS = paper_actions()


def large(seed: int) -> Population:
    """A random graph of more nodes than one can read."""
    graphs = random_graphs(seed, 60, ACTIONS, capacity=24, nodes=(20, 24))
    rows = (graphs.num_nodes > READABLE + 2).nonzero()[:1, 0]
    return Population(graphs[rows], initial_strategy(1))


def test_what_is_large_becomes_smaller_and_does_as_well() -> None:
    environment, keep = model(3, 6), torch.zeros(6, dtype=torch.bool)
    sizes = []
    for seed in range(6):
        before = large(seed)
        after = shrunk(before, ACTIONS, environment, 20, 1e-3)
        old, new = (evaluator(ACTIONS, environment, keep)(p.graphs) for p in (before, after))
        sizes.append(int(after.graphs.num_nodes))
        assert valid(after.graphs, ACTIONS).all()
        assert (new.succeeded | ~old.succeeded).all()
        assert float(new.fitness) >= float(old.fitness) - 1e-3
        assert torch.equal(after.strategy, before.strategy)
    assert min(sizes) <= READABLE  # most of what a random graph has is never visited
    assert sum(size <= READABLE for size in sizes) >= 3


def test_what_is_large_becomes_smaller_by_the_fitness_that_counts() -> None:
    def length(runs: Rollouts, probability: Tensor) -> Tensor:
        return runs.transitions.to(probability)

    environment, keep = model(3, 6), torch.zeros(6, dtype=torch.bool)
    for seed in range(4):
        before = large(seed)
        after = shrunk(before, ACTIONS, environment, 7, 1e-3, length)
        of_both = evaluator(ACTIONS, environment, keep, 7, fitness=length)
        old, new = of_both(before.graphs), of_both(after.graphs)
        assert float(new.fitness) >= float(old.fitness) - 1e-3
        assert (new.succeeded | ~old.succeeded).all()


def test_what_solves_nothing_becomes_smaller_by_its_fitness_too() -> None:
    def place(runs: Rollouts, probability: Tensor) -> Tensor:
        return 2 + runs.percept[..., 0].to(probability)

    environment, keep = model(3, 6), torch.zeros(6, dtype=torch.bool)
    of_both = evaluator(ACTIONS, environment, keep, 7, fitness=place)
    for seed in range(4):
        before = large(seed)
        after = shrunk(before, ACTIONS, environment, 7, 1e-3, place)
        old, new = of_both(before.graphs), of_both(after.graphs)
        assert not old.succeeded.all()
        assert float(new.fitness) >= float(old.fitness) - 1e-3


def test_what_is_readable_stays() -> None:
    graphs = random_graphs(0, 1, ACTIONS, nodes=(3, READABLE))
    before = Population(graphs, initial_strategy(1))
    assert shrunk(before, ACTIONS, model(0, 2), 20, 1e-3) is before


def test_every_node_goes_once_for_every_other() -> None:
    graphs = large(1).graphs
    n = int(graphs.num_nodes)
    smaller = _without_each(graphs)
    assert len(smaller) == n * (n - 1)
    assert valid(smaller, ACTIONS).all()
    assert (smaller.num_nodes < n).all()
    assert not smaller.parameters[~smaller.used].any()
    was = graphs.used[0]
    missing = (was & ~smaller.used).sum(0)[was]
    assert (missing >= n - 1).all()
