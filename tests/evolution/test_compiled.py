"""Compiled operators and those in torch are the same functions, to the last bit."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import as_double, custom_actions, nested_actions, same, seeded
from torch import Tensor

from cgtorch.evolution import EvolutionSettings, Population, compiled, initial_state, tell
from cgtorch.evolution.operators import crossover, mutate, offspring
from cgtorch.evolution.population import STRATEGY, random_population, slim
from cgtorch.evolution.selection import deviation, lexicase
from cgtorch.graphs import NO_NODE, ActionSet, trimmed, valid
from cgtorch.native import constants
from cgtorch.tabletop.actions import paper_actions

SETS = [paper_actions(), custom_actions(), nested_actions()]
seeds, action_sets = st.integers(0, 2**31), st.sampled_from(SETS)
capacities = st.sampled_from([1, 2, 5, 14, 64])
T = TypeVar("T")

pytestmark = pytest.mark.skipif(
    not compiled.takes_scores(torch.zeros(1, 1)), reason="nothing can be compiled here"
)


def in_torch(work: Callable[[], T]) -> T:
    """What `work` returns where nothing is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "takes", lambda *_: False)
        patch.setattr(compiled, "takes_scores", lambda *_: False)
        return work()


def equal(first: Population, second: Population) -> bool:
    return same(first.graphs, second.graphs) and torch.equal(first.strategy, second.strategy)


def population(seed: int, actions: ActionSet, capacity: int, size: int = 10) -> Population:
    """Individuals whose every rate is random, at times 0 or 1."""
    made = random_population(size, actions, capacity, (1, capacity), seeded(seed))
    strategy = (1.4 * torch.rand(made.strategy.shape, generator=seeded(seed)) - 0.2).clamp(0, 1)
    return Population(made.graphs, strategy)


def test_compiled_operators_run_here() -> None:
    graphs = population(0, SETS[0], 24).graphs
    assert compiled.takes(graphs, graphs.parameters)
    assert compiled.takes(graphs, graphs.parameters.double())
    assert not compiled.takes(graphs, graphs.parameters.half())
    large = random_population(2, SETS[0], 65, (1, 65), seeded(0)).graphs
    assert not compiled.takes(large, large.parameters)


@given(seeds, action_sets, capacities)
def test_crossover(seed: int, actions: ActionSet, capacity: int) -> None:
    first, second = (population(seed + i, actions, capacity) for i in range(2))
    children = crossover(first, second, seeded(seed))
    assert equal(children, in_torch(lambda: crossover(first, second, seeded(seed))))
    assert valid(children.graphs, actions).all()


@given(seeds, action_sets, capacities, st.booleans())
def test_mutation(seed: int, actions: ActionSet, capacity: int, double: bool) -> None:
    before = population(seed, actions, capacity)
    if double:
        before = replace(before, graphs=as_double(before.graphs))
    children = mutate(before, actions, seeded(seed))
    assert equal(children, in_torch(lambda: mutate(before, actions, seeded(seed))))
    assert valid(children.graphs, actions).all()
    assert children.graphs.parameters.dtype == before.graphs.parameters.dtype


@given(seeds, action_sets, capacities)
def test_offspring(seed: int, actions: ActionSet, capacity: int) -> None:
    whole = population(seed, actions, capacity)
    parents = torch.randint(len(whole), (14,), generator=seeded(seed))
    elite = torch.randperm(len(whole), generator=seeded(seed))[: seed % 3]

    def made(room: int = 0) -> Population:
        most = capacity + room
        return offspring(whole, elite, parents, actions, seeded(seed), most)

    children = made()
    assert equal(children, in_torch(made))
    assert len(children) == len(elite) + 14
    assert valid(children.graphs, actions).all()
    assert len(elite) == 0 or same(
        trimmed(children.graphs[: len(elite)]), trimmed(whole.graphs[elite])
    )
    assert torch.equal(children.strategy[: len(elite)], whole.strategy[elite])
    if int(whole.graphs.num_nodes.max()) < capacity < constants("graph_limits")["MOST_NODES"]:
        assert equal(children, made(room=64 - capacity))  # room that nobody needs changes nothing


@given(seeds, action_sets, capacities)
def test_offspring_of_graphs_without_a_slot_to_spare(
    seed: int, actions: ActionSet, capacity: int
) -> None:
    """Children may have one more, also where that is more than compiled operators take."""
    whole = slim(population(seed, actions, capacity))
    strategy = whole.strategy.clone()
    strategy[:, STRATEGY.index("add_node")] = 1
    whole = replace(whole, strategy=strategy)
    parents = torch.randint(len(whole), (14,), generator=seeded(seed))

    def made() -> Population:
        return offspring(whole, parents[:1], parents, actions, seeded(seed), capacity + 3)

    children = made()
    assert equal(children, in_torch(made))
    assert children.graphs.capacity == int(whole.graphs.num_nodes[parents].max()) + 1
    assert valid(children.graphs, actions).all()


def test_operators_that_outgrow_what_is_compiled_run_in_torch() -> None:
    actions = SETS[0]
    whole = population(1, actions, 64)
    chain = torch.arange(64) + 1  # each node leads to the next, the last to the first
    moves = torch.full_like(whole.graphs.action, actions.names.index("MoveBase"))
    edges = torch.where(actions.has_edge[moves], (chain % 64)[:, None], NO_NODE)
    graphs = replace(whole.graphs, action=moves, edges=edges)
    whole = Population(graphs, whole.strategy.clone().fill_(1))
    parents = torch.arange(10)
    children = offspring(whole, parents[:2], parents, actions, seeded(2), 100)
    assert children.graphs.capacity == 65
    assert valid(children.graphs, actions).all()


@pytest.mark.parametrize("wrong", [-1, 10, 2**40])
def test_a_parent_that_is_none_is_refused_by_both(wrong: int) -> None:
    whole = population(1, SETS[0], 14)
    good, bad = torch.arange(4), torch.tensor([0, 1, wrong, 2])
    for elite, parents in ((good, bad), (bad, good)):

        def made(elite: Tensor = elite, parents: Tensor = parents) -> Population:
            return offspring(whole, elite, parents, SETS[0], seeded(2), 14)

        for way in (made, lambda made=made: in_torch(made)):
            with pytest.raises(IndexError):
                way()


tables = st.tuples(st.integers(1, 40), st.integers(1, 9), st.integers(0, 4))


@given(seeds, tables, st.sampled_from([torch.float32, torch.float64]))
def test_lexicase(seed: int, table: tuple[int, int, int], dtype: torch.dtype) -> None:
    """With scores that are all different, or few different ones, some of them zeros with a sign."""
    individuals, scenarios, levels = table
    scores = torch.rand(individuals, scenarios, generator=seeded(seed), dtype=dtype) - 0.5
    if levels:
        scores = (scores * levels).round() / levels
    order = torch.arange(individuals)
    chosen = lexicase(order, scores, 31, seeded(seed))
    assert torch.equal(chosen, in_torch(lambda: lexicase(order, scores, 31, seeded(seed))))


@given(st.lists(st.floats(-(2.0**99), 2.0**99, width=32), min_size=1, max_size=40))
def test_deviation(values: list[float]) -> None:
    for dtype in (torch.float32, torch.float64):
        scores = torch.tensor([values, values[::-1], [0.0] * len(values)], dtype=dtype).T
        assert torch.equal(compiled.deviation(scores), deviation(scores))


@pytest.mark.parametrize("threads", [1, 3])
def test_generations_are_the_same_with_and_without_a_compiler(threads: int) -> None:
    actions, settings = custom_actions(), EvolutionSettings(population=150, elite=3)

    def evolved() -> tuple[Population, Tensor]:
        generator = seeded(0)
        state = initial_state(settings, actions, generator)
        for _ in range(8):
            scores = torch.rand(150, 4, generator=generator).round(decimals=1)
            state = tell(state, scores.mean(1), settings, actions, generator, scores)
        return state.population, torch.rand(1, generator=generator)

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        (found, then), (wanted, wanted_then) = evolved(), in_torch(evolved)
    finally:
        torch.set_num_threads(before)
    assert equal(found, wanted)
    assert torch.equal(then, wanted_then)  # as many numbers were drawn
