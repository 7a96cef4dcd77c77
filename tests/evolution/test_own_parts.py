"""Fitness, selection, crossover and mutation of one's own, and how they are checked."""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import pytest
import torch
from support import custom_actions, model, same, seeded
from torch import Generator, Tensor

from cgtorch.evolution import (
    EvolutionSettings,
    Population,
    chance_of_success,
    evolve,
    initial_state,
    lexicase,
    mutate,
    search,
    tell,
)
from cgtorch.evolution.first_graphs import random_graphs
from cgtorch.evolution.operators import crossover
from cgtorch.evolution.population import random_population
from cgtorch.graphs import NO_NODE, ActionSet, Graphs, pruned, widened
from cgtorch.ground.errors import SettingsError
from cgtorch.simulation import Rollouts, rollout

ACTIONS = custom_actions()
SMALL = EvolutionSettings(population=30, capacity=12, initial_nodes=(2, 10), elite=2)


def hurry(runs: Rollouts, probability: Tensor) -> Tensor:
    """Who needs fewer actions is better."""
    return torch.where(runs.succeeded, 1 / runs.transitions, 0.0)


def test_evolution_follows_ones_own_fitness() -> None:
    """Where more actions are worth more, the best takes more of them than under eq. 3."""

    def leisure(runs: Rollouts, probability: Tensor) -> Tensor:
        return runs.transitions / 20

    def best(settings: EvolutionSettings) -> float:
        search = evolve(model(0, 4), ACTIONS, settings, seeded(0))
        for _ in range(6):
            champion = next(search).champion
        runs = rollout(champion.graphs, ACTIONS, model(0, 4))
        return float(runs.transitions.float().mean())

    larger = replace(SMALL, population=50)
    assert best(larger) < 18
    assert best(replace(larger, fitness=leisure)) == 20


def test_parts_that_only_pass_on_change_nothing() -> None:
    own = replace(
        SMALL,
        fitness=lambda runs, probability: chance_of_success(runs, probability),
        selection=lambda *given: lexicase(*given),
    )
    operators = replace(SMALL, crossover=lambda *given: crossover(*given))
    both = replace(operators, mutation=lambda *given: mutate(*given))
    # Crossover and mutation in one step draw other numbers than one after the other.
    for settings in ((SMALL, own), (operators, both)):
        one, two = (evolve(model(0, 3), ACTIONS, s, seeded(4)) for s in settings)
        for _ in range(5):
            first, second = next(one), next(two)
            assert same(first.population.graphs, second.population.graphs)
            assert torch.equal(first.fitness, second.fitness)


def nothing_crossed(first: Population, second: Population, generator: Generator) -> Population:
    strategy = torch.cat([first.strategy, second.strategy])
    pairs = zip(vars(first.graphs).values(), vars(second.graphs).values(), strict=True)
    return Population(type(first.graphs)(*map(torch.cat, pairs)), strategy)


def shifted(
    population: Population, actions: ActionSet, generator: Generator, tau: float
) -> Population:
    """All parameters a bit larger, and room for two more nodes."""
    graphs = population.graphs
    count = actions.num_parameters[graphs.action.clamp_min(0)] * graphs.used
    real = torch.arange(graphs.parameters.shape[2]) < count[..., None]
    graphs = replace(graphs, parameters=graphs.parameters + real)
    return replace(population, graphs=widened(graphs, graphs.capacity + 2))


def test_children_are_what_ones_own_operators_make() -> None:
    settings = replace(SMALL, elite=0, crossover=nothing_crossed, mutation=shifted, capacity=16)
    state = initial_state(settings, ACTIONS, seeded(0))
    scores = torch.zeros(30, 1)
    scores[7] = 1
    after = tell(state, scores[:, 0], settings, ACTIONS, seeded(1), scores).population
    parent = state.population.graphs[torch.full((30,), 7)]
    slots = int(state.population.graphs.num_nodes.max()) + 1
    assert after.graphs.capacity == min(slots, 16) + 2
    assert torch.equal(after.graphs.num_nodes, parent.num_nodes)
    total = after.graphs.parameters.flatten(1).sum(1) - parent.parameters.flatten(1).sum(1)
    count = ACTIONS.num_parameters[parent.action.clamp_min(0)] * parent.used
    assert torch.allclose(total, count.sum(1).float(), atol=1e-4)


def unpruned(
    population: Population, actions: ActionSet, generator: Generator, tau: float
) -> Population:
    """A node that nothing leads to in every graph, once in a while."""
    graphs = population.graphs
    if len(population) < 3:  # not while it is tried
        return population
    action = graphs.action.clone()
    free = (action == NO_NODE).long().argmax(1)
    action[torch.arange(len(action)), free] = actions.index("Detect")
    return replace(population, graphs=replace(graphs, action=action))


def test_invalid_children_are_refused_in_any_generation() -> None:
    search = evolve(model(0, 3), ACTIONS, replace(SMALL, mutation=unpruned), seeded(0))
    next(search)
    with pytest.raises(SettingsError, match=r"made graph 0 invalid: node .* has no edge for"):
        next(search)


def same_mutation(
    population: Population, actions: ActionSet, generator: Generator, tau: float
) -> Population:
    return population


def in_place(
    population: Population, actions: ActionSet, generator: Generator, tau: float
) -> Population:
    population.strategy.mul_(2)
    return population


def with_strategy(of: Callable[[Tensor], Tensor]) -> Callable[..., Population]:
    return lambda population, *_: replace(population, strategy=of(population.strategy))


def with_graphs(**of: Callable[[Tensor], Tensor]) -> Callable[..., Population]:
    def mutation(population: Population, *_: Any) -> Population:
        graphs = population.graphs
        changed = {name: f(getattr(graphs, name)) for name, f in of.items()}
        return replace(population, graphs=replace(graphs, **changed))

    return mutation


def bare(population: Population, *_: Any) -> Any:
    return population.graphs


@pytest.mark.parametrize(
    ("part", "own", "message"),
    [
        ("fitness", lambda runs, chance: chance[0], r"fitness .* returned a tensor \(2,\) of"),
        ("fitness", lambda runs, chance: runs.succeeded, r"\(2, 2\) of bool; return .* float32"),
        ("fitness", lambda runs: runs, r"fitness .* raised TypeError.*tried with two rows"),
        ("fitness", lambda runs, chance: None, r"returned a NoneType; return a tensor \(2, 2\)"),
        ("selection", lambda *given: given[0][:1], r"selection .* returned a tensor \(1,\)"),
        ("selection", lambda *given: given[0] + 1, r"chose \[1, 2\] of 2; choose 0 to 1"),
        ("selection", lambda *given: given[1], r"selection .* of float32; return .* int64"),
        ("crossover", lambda a, b, generator: a, r"crossover .* action as a tensor \(1, .*\(2, "),
        ("crossover", lambda a, b: a, "crossover .* raised TypeError"),
        ("mutation", bare, "mutation 'bare' returned a Graphs; return a Population"),
        ("mutation", in_place, "mutation 'in_place' changed its parents in place"),
        ("mutation", with_strategy(lambda s: s[:, :7]), r"strategy as a tensor \(2, 7\)"),
        ("mutation", with_strategy(lambda s: s.double()), r"strategy as .* of float64; return"),
        ("mutation", with_graphs(start=lambda s: s + 99), "made graph 0 invalid: start node"),
        ("mutation", with_graphs(action=lambda a: a[0]), r"action as a tensor \(12,\) of int64"),
        ("mutation", with_graphs(edges=lambda e: e * 0 - 1), "invalid: node .* has no edge for"),
        (
            "mutation",
            lambda p, *_: replace(p, graphs=widened(p.graphs, 14)),
            "graphs of 14 slots; return 12 at most",
        ),
    ],
)
def test_parts_are_tried_at_the_door(part: str, own: Any, message: str) -> None:
    evaluated = model(0, 3)
    with pytest.raises(SettingsError, match=message) as caught:
        next(evolve(evaluated, ACTIONS, replace(SMALL, **{part: own}), seeded(0)))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(part)


def test_good_parts_pass_and_trying_them_draws_nothing() -> None:
    settings = replace(SMALL, mutation=same_mutation, fitness=hurry)
    generator = seeded(3)
    generation = next(evolve(model(0, 1), ACTIONS, settings, generator))
    expected = initial_state(settings, ACTIONS, seeded(3)).population
    assert same(generation.population.graphs, pruned(expected.graphs))


def test_actions_are_tried_once_in_environments_of_a_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    actions, tried = custom_actions(), list[str]()
    monkeypatch.setattr(search, "check_action", lambda name, *_: tried.append(name))
    for _ in range(2):
        next(evolve(model(0, 4), actions, SMALL, seeded(0)))
    assert sorted(tried) == sorted(actions.names)
    other = model(0, 4)
    other.__class__ = type("Other", (type(other),), {})
    next(evolve(other, actions, SMALL, seeded(0)))
    assert sorted(tried) == sorted(2 * actions.names)


def test_first_graphs_of_ones_own() -> None:
    def one_node_each(
        size: int, actions: ActionSet, capacity: int, nodes: tuple[int, int], generator: Generator
    ) -> Graphs:
        return random_graphs(size, actions, capacity, (1, 1), generator)

    settings = replace(SMALL, first_graphs=one_node_each)
    first = initial_state(settings, ACTIONS, seeded(0)).population
    assert first.graphs.num_nodes.tolist() == [1] * settings.population
    next(evolve(model(0, 5), ACTIONS, settings, seeded(0)))


@pytest.mark.parametrize("wrong", [lambda *_: None, lambda size, *rest: random_graphs(1, *rest)])
def test_first_graphs_that_cannot_be_used(wrong: Callable[..., Any]) -> None:
    with pytest.raises(SettingsError, match="first_graphs"):
        next(evolve(model(0, 5), ACTIONS, replace(SMALL, first_graphs=wrong), seeded(0)))


@pytest.mark.parametrize("newcomers", [0, 7, 27])
def test_newcomers_are_random_graphs_in_place_of_children(newcomers: int) -> None:
    """Where crossover and mutation change nothing, all others are copies of parents."""

    def unchanged(one: Population, other: Population, generator: Generator) -> Population:
        return Population(
            Graphs(*(torch.cat(pair) for pair in zip(vars(one.graphs).values(),
                                                     vars(other.graphs).values(), strict=True))),
            torch.cat([one.strategy, other.strategy]),
        )  # fmt: skip

    settings = replace(
        SMALL, newcomers=newcomers, crossover=unchanged, strategy=(0.4,) * 8,
        mutation=lambda population, *_: population,
    )  # fmt: skip
    state = initial_state(settings, ACTIONS, seeded(0))
    old = {tuple(row.tolist()) for row in state.population.graphs.parameters.flatten(1)}
    after = tell(state, torch.arange(30.0), settings, ACTIONS, seeded(1)).population
    assert len(after) == 30
    width = state.population.graphs.parameters.shape[1]
    rows = widened(after.graphs, max(width, after.graphs.capacity)).parameters[:, :width]
    known = [tuple(row.tolist()) in old for row in rows.flatten(1)]
    assert all(known[: 30 - newcomers])
    assert sum(known[30 - newcomers :]) <= newcomers // 3
    assert torch.allclose(after.strategy[30 - newcomers :], torch.tensor(0.4))
    seeds = replace(state.population[:3], strategy=torch.full((3, 8), 0.3))
    seeded_ones = initial_state(settings, ACTIONS, seeded(0), seeds).population.strategy
    assert torch.equal(seeded_ones[:15], torch.full((15, 8), 0.3))
    assert torch.allclose(seeded_ones[15:], torch.tensor(0.4))


def test_guests_take_the_places_of_the_last_individuals() -> None:
    guest = random_population(2, ACTIONS, 6, (1, 2), seeded(5))
    asked = list[int]()

    def guests() -> Population | None:
        asked.append(1)
        return guest if len(asked) == 2 else None

    generations = evolve(model(0, 5), ACTIONS, SMALL, seeded(0), guests=guests)
    usual = evolve(model(0, 5), ACTIONS, SMALL, seeded(0))
    for number, (one, other) in enumerate(islice(zip(generations, usual, strict=True), 3)):
        graphs, size = one.population.graphs, len(other.population)
        assert len(graphs) == size
        assert len(asked) == number
        if number < 2:
            assert same(one.population.graphs, other.population.graphs)
        else:
            wide = widened(guest.graphs, graphs.capacity)
            assert torch.equal(graphs.action[-2:], wide.action)
            rest = widened(other.population.graphs, graphs.capacity)
            assert torch.equal(graphs.action[:-2], rest.action[:-2])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"newcomers": -1}, "newcomers is -1; give a whole number from 0"),
        ({"newcomers": 28}, "newcomers are 28; give 0 to 27"),
        ({"strategy": (0.5,) * 7}, "give 8 numbers from 0.001 to 1"),
        ({"strategy": (1.5,) + (0.5,) * 7}, "the last up to 10"),
        ({"strategy": (0.5,) * 7 + (10.5,)}, "the last up to 10"),
        ({"strategy": ("a",) * 8}, "give 8 numbers from 0.001"),
        ({"strategy": (0.0,) + (0.5,) * 7}, "from 0.001"),
    ],
)
def test_impossible_newcomers_and_strategies_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        replace(SMALL, **wrong)
    replace(SMALL, newcomers=27, strategy=(1.0,) * 7 + (10.0,))
