from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import custom_actions, judged_by, model, nested_actions, same_nodes, seeded
from torch import Tensor

from cgtorch.evolution import (
    EvolutionSettings,
    EvolutionState,
    Generation,
    Population,
    ask,
    evaluator,
    evolve,
    initial_state,
    lexicase,
    tell,
)
from cgtorch.evolution.population import INITIAL_STRATEGY, random_population, seeded_population
from cgtorch.graphs import compacted
from cgtorch.ground.counter_rng import BITS, nth_true, pick
from cgtorch.ground.errors import DataError, GraphError, SettingsError
from cgtorch.simulation import rollout

ACTIONS = custom_actions()


def same_population(first: Population, second: Population) -> bool:
    return same_nodes(first.graphs, second.graphs) and torch.equal(first.strategy, second.strategy)


def test_choices_are_uniform_and_only_where_allowed() -> None:
    mask = torch.tensor([[False, True, True, False, True], [False] * 5]).repeat(3000, 1)
    draws = torch.rand(6000, 3, generator=seeded(0))
    for column in range(3):
        picked = nth_true(mask, draws[:, column])
        counts = torch.bincount(picked[::2], minlength=5)
        assert counts[0] == counts[3] == 0
        assert ((counts[[1, 2, 4]] - 1000).abs() < 5 * 1000**0.5).all()
        assert (picked[1::2] == 0).all()
    assert torch.equal(nth_true(mask, draws)[:, 1], nth_true(mask, draws[:, 1]))


def test_a_pick_is_never_out_of_range() -> None:
    ends = torch.tensor([0.0, 1 - 2.0**-BITS, 1 - 2.0**-24, 1.0])
    for count in (1, 3, 24, 1000, 2**25):
        picked = pick(ends, count)
        assert picked[0] == 0
        assert (picked < count).all()
        assert picked[-1] == count - 1
    assert (pick(ends, 0) == 0).all()


def test_a_random_population_is_as_random_as_it_says() -> None:
    population = random_population(3000, ACTIONS, 20, (4, 12), seeded(0))
    graphs = population.graphs
    assert torch.equal(population.strategy, torch.tensor(INITIAL_STRATEGY).repeat(3000, 1))
    counts = torch.bincount(graphs.action[graphs.used])
    assert (counts > 0).all()
    assert len(counts) == len(ACTIONS)
    of_network = graphs.parameters[graphs.action == ACTIONS.index("ContinuousNN")]
    assert of_network.mean().item() == pytest.approx(0, abs=0.01)
    assert of_network.std().item() == pytest.approx(1, abs=0.01)


def test_half_of_a_seeded_population_copies_the_seeds_in_turn() -> None:
    old = random_population(3, ACTIONS, 12, (4, 12), seeded(0))
    wider = nested_actions()
    population = seeded_population(9, old, wider, 16, (4, 12), seeded(1))
    assert len(population) == 9
    for i in range(4):
        copy, seed = population[i : i + 1].graphs, compacted(old.graphs[i % 3 : i % 3 + 1])
        assert torch.equal(copy.action[:, :12], seed.action)
        assert torch.equal(copy.edges[:, :12], seed.edges)
        assert torch.equal(copy.parameters[:, :12, : seed.parameters.shape[2]], seed.parameters)
        assert int(copy.num_nodes[0]) == int(seed.num_nodes[0])
        assert torch.equal(population.strategy[i], old.strategy[i % 3])


def test_seeds_that_do_not_fit_are_refused() -> None:
    old = random_population(50, ACTIONS, 20, (20, 20), seeded(0))
    big = old[(old.graphs.num_nodes > 6).nonzero()[:, 0]]
    with pytest.raises(GraphError, match="do not fit into 6 nodes"):
        seeded_population(10, big, ACTIONS, 6, (2, 6), seeded(0))


SETTINGS = EvolutionSettings(population=30, capacity=12, initial_nodes=(2, 10), elite=2)


def told(fitness: Tensor) -> tuple[EvolutionState, EvolutionState]:
    state = initial_state(SETTINGS, ACTIONS, seeded(0))
    return state, tell(state, fitness, SETTINGS, ACTIONS, seeded(1))


def test_the_elite_goes_on_unchanged() -> None:
    fitness = torch.rand(30, generator=seeded(2))
    before, after = told(fitness)
    order = fitness.argsort(descending=True)
    assert same_population(after.population[:2], before.population[order[:2]])
    assert same_population(after.best, before.population[order[:1]])
    assert after.best_fitness == fitness.max()
    assert len(after.population) == 30


def test_parents_are_chosen_by_their_scores() -> None:
    """With one scenario that only one individual solves, all children are its own."""
    settings = replace(SETTINGS, elite=0, selection=lexicase)
    state = initial_state(settings, ACTIONS, seeded(0))
    population = state.population
    still = replace(population, strategy=torch.zeros_like(population.strategy))
    scores = torch.zeros(30, 1)
    scores[7] = 1
    state = replace(state, population=still)
    after = tell(state, torch.zeros(30), settings, ACTIONS, seeded(1), scores).population
    assert same_nodes(after.graphs, population.graphs[torch.full((30,), 7)])


def test_fitness_that_is_not_a_number_is_the_worst() -> None:
    fitness = torch.full((30,), torch.nan)
    fitness[[7, 3]] = torch.tensor([-5.0, -6.0])
    before, after = told(fitness)
    assert same_population(after.population[:2], before.population[torch.tensor([7, 3])])
    assert after.best_fitness == -5
    told(torch.full((30,), torch.nan))


def test_evolution_depends_on_its_seed_alone() -> None:
    def run(seed: int) -> Population:
        generator = seeded(seed)
        state = initial_state(SETTINGS, ACTIONS, generator)
        for _ in range(5):
            fitness = state.population.graphs.num_nodes.float()
            state = tell(state, fitness, SETTINGS, ACTIONS, generator)
        return state.population

    one = run(3)
    torch.rand(100)  # the global generator must not matter
    assert same_population(one, run(3))
    assert not same_population(one, run(4))


def test_ask_and_tell_are_the_same_search_as_evolve() -> None:
    """Whoever evaluates by himself gets, generation by generation, what `evolve` gives."""
    environment, keep = model(0, 4), torch.tensor([True, False, False, False])
    searching = evolve(environment, ACTIONS, SETTINGS, seeded(5), keep=keep)
    mine, generator = list[Generation](), seeded(5)
    state = initial_state(SETTINGS, ACTIONS, generator)
    for _ in range(6):
        mine.append(next(searching))
        population = ask(state)
        assert same_population(population, mine[-1].population)
        assert same_population(ask(state), population)
        result = evaluator(ACTIONS, environment, keep)(population.graphs)
        assert torch.equal(result.fitness, mine[-1].fitness)
        state = tell(state, result.fitness, SETTINGS, ACTIONS, generator, result.scores)
        assert state.best_fitness == mine[-1].best
        assert same_population(state.best, mine[-1].champion)
    assert state.generation == 6


@pytest.mark.parametrize(
    ("fitness", "scores", "message"),
    [
        (torch.zeros(29), None, r"fitness is a tensor \(29,\) of float32; give a tensor \(30,\)"),
        (torch.zeros(30, 1), None, r"fitness is a tensor \(30, 1\)"),
        ([0.0] * 30, None, "fitness is a list"),
        (torch.zeros(30), torch.zeros(30), r"scores are a tensor \(30,\)"),
        (torch.zeros(30), torch.zeros(5, 30), r"scores are .*; give a tensor \(30, B\)"),
        (torch.zeros(30), torch.zeros(30, 0), r"scores are a tensor \(30, 0\)"),
    ],
)
def test_what_is_told_has_to_fit(fitness: Tensor, scores: Tensor | None, message: str) -> None:
    state = initial_state(SETTINGS, ACTIONS, seeded(0))
    with pytest.raises(DataError, match=message):
        tell(state, fitness, SETTINGS, ACTIONS, seeded(1), scores)


def test_selection_makes_what_is_rewarded_common() -> None:
    settings = EvolutionSettings(population=100, capacity=12, initial_nodes=(2, 10))
    generator, grasp = seeded(0), ACTIONS.index("Grasp")
    state = initial_state(settings, ACTIONS, generator)
    means, bests = [], []
    for _ in range(25):
        graphs = state.population.graphs
        fitness = ((graphs.action == grasp).sum(1) / graphs.num_nodes).float()
        state = tell(state, fitness, settings, ACTIONS, generator)
        means.append(float(fitness.mean()))
        bests.append(state.best_fitness)
    assert bests == sorted(bests)  # elitism
    assert means[-1] > means[0] + 0.2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"population": 1}, "population is 1"),
        ({"population": 4, "elite": 4}, "elite is 4; give 0 to 3"),
        ({"elite": -1}, "elite is -1"),
        ({"initial_nodes": (0, 3)}, "initial nodes are 0 to 3"),
        ({"initial_nodes": (5, 3)}, "initial nodes are 5 to 3"),
        ({"capacity": 4, "initial_nodes": (2, 5)}, "within 1 to 4"),
        ({"tau": float("nan")}, "tau is nan"),
        ({"tau": -1.0}, "tau is -1.0"),
    ],
)
def test_settings_that_cannot_work(values: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        EvolutionSettings(**values)  # type: ignore[arg-type]


@given(st.integers(0, 2**31), st.lists(st.booleans(), min_size=4, max_size=4))
def test_fitness_is_that_of_equation_3(seed: int, kept: list[bool]) -> None:
    graphs = random_population(12, ACTIONS, 12, (2, 10), seeded(seed)).graphs
    environment, keep = model(seed, 4), torch.tensor(kept)
    found = evaluator(ACTIONS, environment, keep)(graphs)
    runs = rollout(graphs, ACTIONS, environment)
    for i in range(12):
        lost = any(k and not s for k, s in zip(kept, runs.succeeded[i].tolist(), strict=True))
        score = [
            float(environment.classifier(runs.percept[i, j : j + 1])[0])
            * (1 if runs.succeeded[i, j] else 0.5)
            for j in range(4)
        ]
        assert float(found.fitness[i]) == pytest.approx(0 if lost else sum(score) / 4, abs=1e-6)
        if not lost:
            assert torch.equal(found.succeeded[i], runs.succeeded[i])


@pytest.mark.parametrize("most", [1, 4, 10, 39])
def test_how_many_run_at_once_changes_nothing(most: int) -> None:
    graphs = random_population(13, ACTIONS, 12, (2, 10), seeded(0)).graphs
    environment, keep = model(0, 4), torch.tensor([True, False, False, False])
    whole, parts = (
        evaluator(ACTIONS, environment, keep, **limit)(graphs)
        for limit in ({}, {"most_lanes": most})
    )
    assert 0 < whole.succeeded.sum() < whole.succeeded.numel()
    for name, value in vars(whole).items():
        assert torch.equal(torch.as_tensor(getattr(parts, name)), torch.as_tensor(value)), name


def test_evolve_yields_generations_that_improve() -> None:
    settings = EvolutionSettings(population=100, capacity=12)
    search = evolve(model(0, 3), ACTIONS, settings, seeded(0))
    generations = [next(search) for _ in range(20)]
    assert [g.number for g in generations] == list(range(20))
    best = [g.best for g in generations]
    assert best == sorted(best)
    assert best[-1] > best[0]
    for g in generations:
        assert g.best == float(g.fitness.max())
        assert g.transitions > 0
        equal = g.fitness == g.best
        sizes = g.population.graphs.num_nodes
        first = int((equal & (sizes == sizes[equal].min())).nonzero()[0])
        assert same_population(g.champion, g.population[first : first + 1])


def test_what_is_not_finite_costs_its_individual_and_no_other() -> None:
    graphs = random_population(40, ACTIONS, 12, (2, 10), seeded(1)).graphs
    environment, keep = model(0, 4), torch.zeros(4, dtype=torch.bool)
    clean = evaluator(ACTIONS, environment, keep)(graphs)
    ends = rollout(graphs, ACTIONS, environment).percept
    limit = float(ends[..., 4].flatten().quantile(0.75))
    whole = environment.classifier

    def broken(percept: torch.Tensor) -> torch.Tensor:
        return torch.where(percept[:, 4] > limit, float("nan"), whole(percept))

    environment = judged_by(environment, broken)
    graphs.parameters[7, int(graphs.start[7]), 0] = float("inf")
    found = evaluator(ACTIONS, environment, keep)(graphs)
    again = rollout(graphs, ACTIONS, environment).percept
    bad = ((again[..., 4] > limit) | ~again.isfinite().all(-1)).any(1)
    bad[7] = True
    assert 2 < bad.sum() < 38
    assert found.not_finite == int(bad.sum())
    assert clean.not_finite == 0
    assert (found.fitness[bad] == 0).all()
    assert not found.succeeded[bad].any()
    untouched = ~bad & (again == ends).flatten(1).all(1)
    assert untouched.sum() > 3
    assert torch.equal(found.fitness[untouched], clean.fitness[untouched])
