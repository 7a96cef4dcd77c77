from dataclasses import replace
from typing import Any

import pytest
import torch
from support import custom_actions, model, same_individuals, same_nodes, seeded
from torch import Generator, Tensor

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
from cgtorch.ground.errors import DataError, SettingsError, WorldError

ACTIONS = custom_actions()


SETTINGS = EvolutionSettings(population=30, capacity=12, initial_nodes=(2, 10), elite=2)


def told(fitness: Tensor) -> tuple[EvolutionState, EvolutionState]:
    state = initial_state(SETTINGS, ACTIONS, seeded(0))
    return state, tell(state, fitness, SETTINGS, ACTIONS, seeded(1))


def test_the_elite_goes_on_unchanged() -> None:
    fitness = torch.rand(30, generator=seeded(2))
    before, after = told(fitness)
    order = fitness.argsort(descending=True)
    assert same_individuals(after.population[:2], before.population[order[:2]])
    assert same_individuals(after.best, before.population[order[:1]])
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
    assert same_individuals(after.population[:2], before.population[torch.tensor([7, 3])])
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
    assert same_individuals(one, run(3))
    assert not same_individuals(one, run(4))


def test_ask_and_tell_are_the_same_search_as_evolve() -> None:
    """Whoever evaluates by himself gets, generation by generation, what `evolve` gives."""
    environment, keep = model(0, 4), torch.tensor([True, False, False, False])
    searching = evolve(environment, ACTIONS, SETTINGS, seeded(5), keep=keep)
    mine, generator = list[Generation](), seeded(5)
    state = initial_state(SETTINGS, ACTIONS, generator)
    for _ in range(6):
        mine.append(next(searching))
        population = ask(state)
        assert same_individuals(population, mine[-1].population)
        assert same_individuals(ask(state), population)
        result = evaluator(ACTIONS, environment, keep)(population.graphs)
        assert torch.equal(result.fitness, mine[-1].fitness)
        state = tell(state, result.fitness, SETTINGS, ACTIONS, generator, result.scores)
        assert state.best_fitness == mine[-1].best
        assert same_individuals(state.best, mine[-1].champion)
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
        ({"migration": 0}, "migration is 0; give a whole number from 1"),
    ],
)
def test_settings_that_cannot_work(values: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        EvolutionSettings(**values)  # type: ignore[arg-type]


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
        assert same_individuals(g.champion, g.population[first : first + 1])


@pytest.mark.parametrize(("elite", "parents"), [(0, 30), (2, 28), (3, 28)])
def test_there_are_as_many_parents_as_children_in_pairs(elite: int, parents: int) -> None:
    asked: list[int] = []

    def first(order: Tensor, scores: Tensor, count: int, generator: Generator) -> Tensor:
        asked.append(count)
        return order[:1].expand(count)

    settings = replace(SETTINGS, elite=elite, selection=first)
    state = initial_state(settings, ACTIONS, seeded(0))
    after = tell(state, torch.rand(30, generator=seeded(2)), settings, ACTIONS, seeded(1))
    assert asked == [parents]
    assert len(after.population) == 30
    assert after.distinct_parents == 1


def test_episodes_of_an_evolution_have_a_limit() -> None:
    for limit in (1, 3):
        search = evolve(model(0, 4), ACTIONS, SETTINGS, seeded(0), max_transitions=limit)
        transitions = [next(search).transitions for _ in range(2)]
        assert all(30 * 4 * (limit - 1) < each <= 30 * 4 * limit for each in transitions)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"environment": None}, "environment is None; give an Environment, such as"),
        ({"environment": lambda number: "x"}, "environment is 'x'; give an Environment, such as"),
        ({"actions": None}, "actions is None; give an ActionSet, such as domain.actions"),
        ({"settings": None}, "settings is None; give EvolutionSettings"),
        ({"generator": 3}, "generator is 3; give a torch.Generator"),
        ({"generator": None}, "generator is None; give a torch.Generator"),
        ({"max_transitions": "5"}, "max_transitions is '5'; give a whole number from 1 to"),
    ],
)
def test_what_cannot_evolve_is_said(given: dict[str, Any], message: str) -> None:
    about: dict[str, Any] = {"settings": SETTINGS, "actions": ACTIONS, "generator": seeded(0)}
    with pytest.raises((SettingsError, WorldError), match=message):
        next(evolve(**{"environment": None, **about, **given}))
