"""A dry run of user-supplied parts of an evolution, before anything is evaluated."""

import torch
from torch import Generator

from cgtorch.evolution.fitness import last_success
from cgtorch.evolution.population import (
    Population,
    check_offspring,
    initial_strategy,
    random_population,
)
from cgtorch.evolution.settings import EvolutionSettings
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.dry_run import ROWS, expect, kind, returned, two_rows
from cgtorch.ground.environment import Environment
from cgtorch.ground.errors import SettingsError
from cgtorch.simulation import rollout


def check_parts(
    settings: EvolutionSettings,
    actions: ActionSet,
    environment: Environment,
    device: torch.device | str = "cpu",
) -> None:
    """Try first graphs, selection, fitness, crossover and mutation on two individuals.

    The dry run has its own random numbers. A SettingsError names the part and what is wrong.
    """
    generator, capacity = Generator().manual_seed(0), settings.capacity
    pair = random_population(ROWS, actions, capacity, settings.initial_nodes, generator)

    who = _named("first_graphs", settings.first_graphs)
    sizes = actions, capacity, settings.initial_nodes
    first = returned(SettingsError, who, settings.first_graphs, ROWS, *sizes, generator)
    if not isinstance(first, Graphs):
        raise SettingsError(f"{who} returned {kind(first)}; return Graphs")
    check_offspring(Population(first, initial_strategy(ROWS)), ROWS, capacity, actions, who)

    who = _named("fitness", settings.fitness)
    graphs, scenario = pair.graphs.to(device), two_rows(environment.num_scenarios, device)
    runs = rollout(graphs, actions, environment, scenarios=scenario)
    chance = last_success(runs, environment, scenario)[0]
    worth = returned(SettingsError, who, settings.fitness, runs, chance)
    expect(SettingsError, who, "", worth, chance.shape, chance.dtype)

    who = _named("selection", settings.selection)
    order, scores = torch.arange(ROWS), worth.cpu()
    parents = returned(SettingsError, who, settings.selection, order, scores, ROWS, generator)
    expect(SettingsError, who, "", parents, (ROWS,), torch.long)
    if not ((parents >= 0) & (parents < ROWS)).all():
        raise SettingsError(f"{who} chose {parents.tolist()} of {ROWS}; choose 0 to {ROWS - 1}")

    for name, part, given in (
        ("crossover", settings.crossover, (pair[:1], pair[1:], generator)),
        ("mutation", settings.mutation, (pair, actions, generator, settings.tau)),
    ):
        who = _named(name, part)
        kept = [x.clone() for x in (*vars(pair.graphs).values(), pair.strategy)]
        offspring = returned(SettingsError, who, part, *given)
        check_offspring(offspring, ROWS, capacity, actions, who)
        now = (*vars(pair.graphs).values(), pair.strategy)
        if not all(torch.equal(a, b) for a, b in zip(kept, now, strict=True)):
            raise SettingsError(f"{who} changed its parents in place; return new tensors")


def _named(what: str, part: object) -> str:
    return f"{what} {getattr(part, '__name__', kind(part))!r}"
