"""Islands: what passes between them, and that nothing else does."""

from dataclasses import replace
from itertools import islice

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import all_valid, custom_actions, model, seeded
from support import same_individuals as same
from torch import Generator, Tensor

from cgtorch.evolution import EvolutionSettings, Population, evolve, initial_state, tell
from cgtorch.evolution.fitness import evaluator
from cgtorch.evolution.population import join, random_population
from cgtorch.evolution.search import Generation, derived_generator, emigrants, migrated
from cgtorch.evolution.selection import Evaluated
from cgtorch.graphs import widened

ACTIONS = custom_actions()
SETTINGS = EvolutionSettings(population=20, capacity=10, initial_nodes=(2, 8))


def tried(seed: int, size: int, fitness: list[float]) -> Evaluated:
    generator = seeded(seed)
    population = random_population(size, ACTIONS, 10, (2, 8), generator)
    scores = torch.rand(size, 3, generator=generator)
    return Evaluated(population, torch.tensor(fitness), scores)


def rows(each: Evaluated) -> list[bytes]:
    """Each individual with all that it achieved, as bytes."""
    graphs = widened(each.population.graphs, 10)
    columns = *vars(graphs).values(), each.population.strategy, each.fitness, each.scores
    return [
        b"".join(values[i].contiguous().numpy().tobytes() for values in columns)
        for i in range(len(each.population))
    ]


def generations(settings: EvolutionSettings, seed: int, count: int) -> list[Generation]:
    return list(islice(evolve(model(0, 3), ACTIONS, settings, seeded(seed)), count))


@given(
    st.integers(0, 2**20),
    st.lists(st.integers(0, 5).map(float), min_size=2, max_size=45),
)
def test_the_best_tenth_leaves_and_the_worst_make_room(seed: int, fitness: list[float]) -> None:
    here = tried(seed, len(fitness), fitness)
    there = tried(seed + 1, len(fitness), [x + 1 for x in reversed(fitness)])
    leaving = emigrants(there)
    count = max(1, len(fitness) // 10)
    assert sorted(leaving.fitness.tolist()) == sorted(there.fitness.tolist())[-count:]
    assert set(rows(leaving)) <= set(rows(there))
    after = migrated(here, leaving)
    assert len(after.population) == len(fitness)
    assert rows(after)[-count:] == rows(leaving)
    stayed = after.fitness[:-count].tolist()
    assert sorted(stayed) == sorted(fitness)[count:]
    before = rows(here)
    places = [before.index(row) for row in rows(after)[:-count]]
    assert places == sorted(places)  # in their order, each once
    assert len(set(places)) == len(places) or len(set(before)) < len(before)
    assert all_valid(after.population.graphs, ACTIONS)


def test_each_island_has_random_numbers_of_its_own_and_the_first_those_given() -> None:
    generator = seeded(5)
    assert derived_generator(generator, 0) is generator
    draws = {
        n: torch.rand(4, generator=derived_generator(generator, n)).tolist() for n in (1, 2, 3)
    }
    assert len({tuple(x) for x in draws.values()}) == 3
    assert (
        torch.rand(4, generator=generator).tolist() == torch.rand(4, generator=seeded(5)).tolist()
    )  # nothing was drawn from it
    assert torch.rand(4, generator=derived_generator(seeded(5), 2)).tolist() == draws[2]
    later = seeded(5)
    torch.rand(1, generator=later)
    assert torch.rand(4, generator=derived_generator(later, 2)).tolist() != draws[2]


def plainly(count: int, migration: int, generations: int) -> list[list[Population]]:
    """Islands with every step written out, one after the other: a slow reference."""
    environment, keep, stage = model(0, 3), torch.zeros(3, dtype=torch.bool), seeded(7)
    generators: list[Generator] = [derived_generator(stage, i) for i in range(count)]
    states = [initial_state(SETTINGS, ACTIONS, g) for g in generators]
    history = []
    for number in range(generations):
        history.append([s.population for s in states])
        results = [evaluator(ACTIONS, environment, keep)(s.population.graphs) for s in states]
        best: list[list[int]] = []
        for s, r in zip(states, results, strict=True):
            nodes = s.population.graphs.num_nodes.tolist()
            best.append(sorted(range(20), key=lambda i: (-float(r.fitness[i]), nodes[i], i)))
        new = []
        for i, (s, r) in enumerate(zip(states, results, strict=True)):
            population, fitness, scores = s.population, r.fitness, r.scores
            if count > 1 and (number + 1) % migration == 0:
                stay, come = torch.tensor(sorted(best[i][:18])), torch.tensor(best[i - 1][:2])
                those, theirs = states[i - 1].population, results[i - 1]
                fitness = torch.cat([fitness[stay], theirs.fitness[come]])
                scores = torch.cat([scores[stay], theirs.scores[come]])
                population = join(population[stay], those[come])
            state = replace(s, population=population)
            new.append(tell(state, fitness, SETTINGS, ACTIONS, generators[i], scores))
        states = new
    return history


@pytest.mark.parametrize(("count", "migration"), [(1, 1), (2, 1), (4, 3)])
def test_islands_are_those_of_the_reference(count: int, migration: int) -> None:
    settings = replace(SETTINGS, islands=count, migration=migration)
    found = generations(settings, 7, 6)
    for one, wanted in zip(found, plainly(count, migration, 6), strict=True):
        assert len(one.islands) == count
        for island, population in zip(one.islands, wanted, strict=True):
            assert same(island.population, population)


def test_the_champion_is_the_best_of_all_islands() -> None:
    settings, keep = replace(SETTINGS, islands=4, migration=3), torch.zeros(3, dtype=torch.bool)
    winners, bests = set(), []
    for found in generations(settings, 4, 6):
        results = [
            evaluator(ACTIONS, model(0, 3), keep)(island.population.graphs)
            for island in found.islands
        ]
        fitness: Tensor = torch.stack([r.fitness for r in results])
        sizes = torch.stack([i.population.graphs.num_nodes for i in found.islands])
        assert found.best == float(fitness.max())
        equal = (fitness == fitness.max()) & (sizes == sizes[fitness == fitness.max()].min())
        island, row = equal.nonzero()[0].tolist()
        assert same(found.champion, found.islands[island].population[row : row + 1])
        assert torch.equal(found.succeeded, results[island].succeeded[row])
        assert found.transitions == sum(r.transitions for r in results)
        assert found.population is found.islands[0].population
        assert torch.equal(found.fitness, results[0].fitness)
        winners.add(island)
        bests.append(found.best)
    assert bests == sorted(bests)
    assert len(winners) > 1


def test_islands_that_are_given_go_on() -> None:
    settings = replace(SETTINGS, islands=3, migration=2)
    whole = generations(settings, 4, 6)
    own = [derived_generator(seeded(4), number) for number in range(3)]
    begun = [initial_state(settings, ACTIONS, each) for each in own]
    assert all(
        same(one.population, other.population)
        for one, other in zip(begun, whole[0].islands, strict=True)
    )
    search = evolve(model(0, 3), ACTIONS, settings, seeded(4))
    for _ in range(4):
        middle = next(search)
    copies = [replace(i, generator=i.generator.clone_state()) for i in middle.islands]
    rest = evolve(model(0, 3), ACTIONS, settings, seeded(99), islands=copies)
    for wanted in whole[3:]:
        found = next(rest)
        assert found.number == wanted.number
        assert same(found.champion, wanted.champion)
