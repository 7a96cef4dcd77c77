"""After every operator every graph is valid: nothing else in the library checks again."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from support import all_valid, nested_actions, same, same_nodes, seeded, stochastic_actions
from torch import Tensor

from cgtorch.evolution import (
    STRATEGY,
    EvolutionSettings,
    Population,
    Selection,
    initial_state,
    lexicase,
    tell,
    tournament,
)
from cgtorch.evolution import operators_in_torch as m
from cgtorch.evolution.operators import crossover, mutate, perturb_parameters
from cgtorch.evolution.operators_in_torch import with_origins
from cgtorch.evolution.population import TAU, random_population, seeded_population
from cgtorch.graphs import ActionSet, pruned, valid
from cgtorch.tabletop.actions import paper_actions

SETS = [paper_actions(), stochastic_actions(), nested_actions()]
SIZE = 8

seeds = st.integers(0, 2**31)
action_sets = st.sampled_from(SETS)
rates = st.sampled_from([0.0, 0.3, 1.0])


@st.composite
def sizes(draw: st.DrawFn) -> tuple[int, tuple[int, int]]:
    """A capacity and the nodes of first graphs: from a single one to all that fit."""
    capacity = draw(st.integers(1, 14))
    low = draw(st.integers(1, capacity))
    return capacity, (low, draw(st.integers(low, capacity)))


def made(
    seed: int, actions: ActionSet, size: tuple[int, tuple[int, int]], rate: float
) -> Population:
    population = random_population(SIZE, actions, *size, seeded(seed))
    strategy = torch.full_like(population.strategy, rate)
    return Population(population.graphs, strategy)


def check(population: Population, actions: ActionSet, capacity: int) -> None:
    graphs = population.graphs
    assert all_valid(graphs, actions)
    assert valid(graphs, actions).all()
    assert graphs.capacity <= capacity
    assert graphs.parameters.isfinite().all()


@given(seeds, action_sets, sizes())
def test_random(seed: int, actions: ActionSet, size: tuple[int, tuple[int, int]]) -> None:
    population = random_population(SIZE, actions, *size, seeded(seed))
    check(population, actions, size[0])
    assert int(population.graphs.num_nodes.max()) <= size[1][1]


@given(seeds, action_sets, sizes(), sizes())
def test_seeded(
    seed: int,
    actions: ActionSet,
    size: tuple[int, tuple[int, int]],
    earlier: tuple[int, tuple[int, int]],
) -> None:
    """Earlier individuals may have more slots than there now are, if not more nodes."""
    old = random_population(3, actions, *earlier, seeded(seed))
    fits = old.graphs.num_nodes <= size[0]
    if fits.any():
        population = seeded_population(SIZE, old[fits], actions, *size, seeded(seed))
        assert len(population) == SIZE
        check(population, actions, size[0])


@given(seeds, action_sets, sizes(), rates)
def test_crossover(
    seed: int, actions: ActionSet, size: tuple[int, tuple[int, int]], rate: float
) -> None:
    first, second = made(seed, actions, size, rate), made(seed + 1, actions, size, rate)
    children = crossover(first, second, seeded(seed))
    assert len(children) == 2 * SIZE
    check(children, actions, size[0])
    if rate == 0:
        assert same_nodes(children[:SIZE].graphs, first.graphs)
        assert same_nodes(children[SIZE:].graphs, second.graphs)


@given(seeds, action_sets, sizes(), rates)
def test_each_mutation(
    seed: int, actions: ActionSet, size: tuple[int, tuple[int, int]], rate: float
) -> None:
    graphs, generator = made(seed, actions, size, 0).graphs, seeded(seed)
    rate_of: Tensor = torch.full((SIZE,), rate)
    heads = torch.rand(graphs.edges.shape, generator=generator)

    def draws(columns: int) -> Tensor:
        return torch.rand(SIZE, columns, generator=generator)

    none, strategy = [0] * (len(actions) + 1), rate_of[:, None].repeat(1, len(STRATEGY))
    old = graphs.parameters
    steps = perturb_parameters(
        with_origins(graphs), none, old, actions, strategy, 0, generator, TAU
    )
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


@given(seeds, action_sets, sizes(), rates)
def test_mutate(
    seed: int, actions: ActionSet, size: tuple[int, tuple[int, int]], rate: float
) -> None:
    population = made(seed, actions, size, rate)
    mutated = mutate(population, actions, seeded(seed))
    check(mutated, actions, size[0])
    assert mutated.strategy.shape == (SIZE, len(STRATEGY))
    if rate == 0:
        assert same_nodes(mutated.graphs, population.graphs)


@given(
    seeds,
    action_sets,
    sizes(),
    st.integers(0, 7),
    st.sampled_from([lexicase, tournament(1), tournament(5)]),
)
def test_generations(
    seed: int,
    actions: ActionSet,
    size: tuple[int, tuple[int, int]],
    elite: int,
    selection: Selection,
) -> None:
    settings = EvolutionSettings(
        population=SIZE,
        selection=selection,
        elite=elite,
        capacity=size[0],
        initial_nodes=size[1],
    )
    generator = seeded(seed)
    state = initial_state(settings, actions, generator)
    for generation in range(6):
        check(state.population, actions, size[0])
        assert state.generation == generation
        assert len(state.population) == SIZE
        scores = torch.rand(SIZE, 3, generator=generator)
        state = tell(state, scores.mean(1), settings, actions, generator, scores)
