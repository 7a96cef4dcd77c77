"""Operators make valid graphs, compiled and in torch the same ones to the last bit."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import (
    all_valid,
    as_double,
    custom_actions,
    nested_actions,
    same,
    same_nodes,
    seeded,
    stochastic_actions,
)
from torch import Tensor

from cgtorch.evolution import (
    STRATEGY,
    EvolutionSettings,
    Population,
    Selection,
    compiled,
    initial_state,
    lexicase,
    tell,
    tournament,
)
from cgtorch.evolution import operators_in_torch as m
from cgtorch.evolution.operators import crossover, mutate, offspring, perturb_parameters
from cgtorch.evolution.population import TAU, random_population, seeded_population, slim
from cgtorch.evolution.selection import deviation
from cgtorch.graphs import NO_NODE, ActionSet, pruned, trimmed, valid
from cgtorch.native import constants
from cgtorch.tabletop.actions import paper_actions

SETS = [paper_actions(), custom_actions(), nested_actions(), stochastic_actions()]
SIZE = 8
T = TypeVar("T")
Sizes = tuple[int, tuple[int, int]]

seeds, action_sets = st.integers(0, 2**31), st.sampled_from(SETS)
rates = st.sampled_from([None, 0.0, 0.3, 1.0])
capacities = st.sampled_from([1, 2, 5, 14, 64])

needs_compiler = pytest.mark.skipif(
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


@st.composite
def sizes(draw: st.DrawFn) -> Sizes:
    """A capacity and the nodes of first graphs: from a single one to all that fit."""
    capacity = draw(st.integers(1, 14))
    low = draw(st.integers(1, capacity))
    return capacity, (low, draw(st.integers(low, capacity)))


def made(seed: int, actions: ActionSet, size: Sizes, rate: float | None = None) -> Population:
    """Individuals whose every rate is that one, or random, at times 0 or 1."""
    graphs = random_population(SIZE, actions, *size, seeded(seed)).graphs
    strategy = (1.4 * torch.rand(SIZE, len(STRATEGY), generator=seeded(seed)) - 0.2).clamp(0, 1)
    return Population(graphs, strategy if rate is None else torch.full_like(strategy, rate))


def check(population: Population, actions: ActionSet, capacity: int) -> None:
    graphs = population.graphs
    assert all_valid(graphs, actions)
    assert valid(graphs, actions).all()
    assert graphs.capacity <= capacity
    assert graphs.parameters.isfinite().all()


@given(seeds, action_sets, sizes(), sizes())
def test_first_populations(seed: int, actions: ActionSet, size: Sizes, earlier: Sizes) -> None:
    """Seeds may have more slots than there now are, if not more nodes."""
    population = random_population(SIZE, actions, *size, seeded(seed))
    check(population, actions, size[0])
    assert int(population.graphs.num_nodes.max()) <= size[1][1]
    old = random_population(3, actions, *earlier, seeded(seed))
    fits = old.graphs.num_nodes <= size[0]
    if fits.any():
        population = seeded_population(SIZE, old[fits], actions, *size, seeded(seed))
        assert len(population) == SIZE
        check(population, actions, size[0])


@given(seeds, action_sets, sizes(), rates)
def test_crossover(seed: int, actions: ActionSet, size: Sizes, rate: float | None) -> None:
    first, second = (made(seed + i, actions, size, rate) for i in range(2))
    children = crossover(first, second, seeded(seed))
    assert equal(children, in_torch(lambda: crossover(first, second, seeded(seed))))
    assert len(children) == 2 * SIZE
    check(children, actions, size[0])
    if rate == 0:
        assert same_nodes(children[:SIZE].graphs, first.graphs)
        assert same_nodes(children[SIZE:].graphs, second.graphs)


@given(seeds, action_sets, sizes(), rates, st.booleans())
def test_mutation(
    seed: int, actions: ActionSet, size: Sizes, rate: float | None, double: bool
) -> None:
    before = made(seed, actions, size, rate)[seed % 2 :]
    if double:
        before = replace(before, graphs=as_double(before.graphs))
    children = mutate(before, actions, seeded(seed))
    assert equal(children, in_torch(lambda: mutate(before, actions, seeded(seed))))
    check(children, actions, size[0])
    assert children.graphs.parameters.dtype == before.graphs.parameters.dtype
    assert children.strategy.shape == before.strategy.shape
    if rate == 0:
        assert same_nodes(children.graphs, before.graphs)


@given(seeds, action_sets, sizes(), rates.filter(lambda rate: rate is not None))
def test_each_mutation(seed: int, actions: ActionSet, size: Sizes, rate: float) -> None:
    graphs, generator = made(seed, actions, size, 0).graphs, seeded(seed)
    rate_of: Tensor = torch.full((SIZE,), rate)
    heads = torch.rand(graphs.edges.shape, generator=generator)

    def draws(columns: int) -> Tensor:
        return torch.rand(SIZE, columns, generator=generator)

    none, strategy = [0] * (len(actions) + 1), rate_of[:, None].repeat(1, len(STRATEGY))
    about = graphs.parameters, actions, strategy, 0, generator, TAU
    steps = perturb_parameters(m.with_origins(graphs), none, *about)
    for mutated in (
        m.add_node(graphs, actions, rate_of, draws(3 + graphs.edges.shape[2])),
        m.delete_node(graphs, rate_of, draws(3), heads),
        m.replace_nodes(graphs, actions, rate_of, draws(graphs.capacity), heads),
        m.change_edges(graphs, rate_of, draws(graphs.capacity), heads),
        steps.graphs,
        m.new_start(graphs, rate_of, draws(2)),
    ):
        # Pruning comes last, once for all mutations; all else must hold after each.
        assert all_valid(mutated, actions, connected=False)
        check(Population(pruned(mutated), rate_of), actions, size[0])
        if rate == 0:
            assert same(mutated, graphs)


@given(
    seeds,
    action_sets,
    sizes(),
    st.integers(0, 7),
    st.sampled_from([lexicase, tournament(1), tournament(5)]),
)
def test_generations(
    seed: int, actions: ActionSet, size: Sizes, elite: int, selection: Selection
) -> None:
    settings = EvolutionSettings(
        SIZE, selection, elite=elite, capacity=size[0], initial_nodes=size[1]
    )
    generator = seeded(seed)
    state = initial_state(settings, actions, generator)
    for generation in range(6):
        check(state.population, actions, size[0])
        assert state.generation == generation
        assert len(state.population) == SIZE
        scores = torch.rand(SIZE, 3, generator=generator)
        state = tell(state, scores.mean(1), settings, actions, generator, scores)


@needs_compiler
def test_compiled_operators_run_here() -> None:
    graphs = made(0, SETS[0], (24, (1, 24))).graphs
    assert compiled.takes(graphs, graphs.parameters)
    assert compiled.takes(graphs, graphs.parameters.double())
    assert not compiled.takes(graphs, graphs.parameters.half())
    large = random_population(2, SETS[0], 65, (1, 65), seeded(0)).graphs
    assert not compiled.takes(large, large.parameters)
    nodes, outcomes = (constants("graph_limits")[n] for n in ("MOST_NODES", "MOST_OUTCOMES"))
    assert compiled.within_limits(nodes, outcomes)
    assert not compiled.within_limits(nodes + 1, outcomes)
    assert not compiled.within_limits(nodes, outcomes + 1)


@needs_compiler
@given(seeds, action_sets, capacities)
def test_offspring(seed: int, actions: ActionSet, capacity: int) -> None:
    whole = made(seed, actions, (capacity, (1, capacity)))
    parents = torch.randint(len(whole), (14,), generator=seeded(seed))
    elite = torch.randperm(len(whole), generator=seeded(seed))[: seed % 3]

    def bred(room: int = 0) -> Population:
        most = capacity + room
        return offspring(whole, elite, parents, actions, seeded(seed), most)

    children = bred()
    assert equal(children, in_torch(bred))
    assert len(children) == len(elite) + 14
    assert valid(children.graphs, actions).all()
    assert len(elite) == 0 or same(
        trimmed(children.graphs[: len(elite)]), trimmed(whole.graphs[elite])
    )
    assert torch.equal(children.strategy[: len(elite)], whole.strategy[elite])
    if int(whole.graphs.num_nodes.max()) < capacity < constants("graph_limits")["MOST_NODES"]:
        assert equal(children, bred(room=64 - capacity))  # room that nobody needs changes nothing


@needs_compiler
@given(seeds, action_sets, capacities)
def test_offspring_of_graphs_without_a_slot_to_spare(
    seed: int, actions: ActionSet, capacity: int
) -> None:
    """Children may have one more, also where that is more than compiled operators take."""
    whole = slim(made(seed, actions, (capacity, (1, capacity))))
    strategy = whole.strategy.clone()
    strategy[:, STRATEGY.index("add_node")] = 1
    whole = replace(whole, strategy=strategy)
    parents = torch.randint(len(whole), (14,), generator=seeded(seed))

    def bred() -> Population:
        return offspring(whole, parents[:1], parents, actions, seeded(seed), capacity + 3)

    children = bred()
    assert equal(children, in_torch(bred))
    assert children.graphs.capacity == int(whole.graphs.num_nodes[parents].max()) + 1
    assert valid(children.graphs, actions).all()


@needs_compiler
def test_operators_that_outgrow_what_is_compiled_run_in_torch() -> None:
    actions = SETS[0]
    whole = made(1, actions, (64, (1, 64)))
    chain = torch.arange(64) + 1  # each node leads to the next, the last to the first
    moves = torch.full_like(whole.graphs.action, actions.names.index("MoveBase"))
    edges = torch.where(actions.has_edge[moves], (chain % 64)[:, None], NO_NODE)
    graphs = replace(whole.graphs, action=moves, edges=edges)
    whole = Population(graphs, whole.strategy.clone().fill_(1))
    parents = torch.arange(SIZE)
    children = offspring(whole, parents[:2], parents, actions, seeded(2), 100)
    assert children.graphs.capacity == 65
    assert valid(children.graphs, actions).all()


@needs_compiler
@pytest.mark.parametrize("wrong", [-1, SIZE, 2**40])
def test_a_parent_that_is_none_is_refused_by_both(wrong: int) -> None:
    whole = made(1, SETS[0], (14, (1, 14)))
    good, bad = torch.arange(4), torch.tensor([0, 1, wrong, 2])
    for elite, parents in ((good, bad), (bad, good)):

        def bred(elite: Tensor = elite, parents: Tensor = parents) -> Population:
            return offspring(whole, elite, parents, SETS[0], seeded(2), 14)

        for way in (bred, lambda bred=bred: in_torch(bred)):
            with pytest.raises(IndexError):
                way()


tables = st.tuples(st.integers(1, 40), st.integers(1, 9), st.integers(0, 4))


@needs_compiler
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


@needs_compiler
@given(st.lists(st.floats(-(2.0**99), 2.0**99, width=32), min_size=1, max_size=40))
def test_deviation(values: list[float]) -> None:
    for dtype in (torch.float32, torch.float64):
        scores = torch.tensor([values, values[::-1], [0.0] * len(values)], dtype=dtype).T
        assert torch.equal(compiled.deviation(scores), deviation(scores))


@needs_compiler
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
