"""The common workload of lines about rollouts: real models and scenarios, seeded populations."""

from dataclasses import dataclass, replace
from functools import cache

import torch
from torch import Generator, Tensor

from cgtorch.domains.knowledge import Knowledge
from cgtorch.evolution import EvolutionSettings, Population, evolve
from cgtorch.evolution.operators import crossover, mutate
from cgtorch.evolution.population import random_population, slim
from cgtorch.graphs import ActionSet, widened
from cgtorch.improvement.trial import first_percepts
from cgtorch.simulation import ModelEnvironment
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.domain import LABELS, TRANSITIONS, Tabletop

SCENARIOS = 20
GENERATIONS = 10
"""The number of generations of an evolved population; most initial graphs do almost nothing."""
CAPACITY = EvolutionSettings().capacity
NODES = EvolutionSettings().initial_nodes
POPULATION = 1000


@dataclass(frozen=True)
class Workload:
    """Γ and C of the default size, as an environment of 20 placements around the table.

    Attributes:
        knowledge: Γ, C and the data that they are fitted on.
        environment: what populations are searched in, that is, with the swift Γ.
        footprint: (4,) of the base (m).
        actions: those of the paper, whose networks read percepts as they are.
    """

    knowledge: Knowledge
    environment: ModelEnvironment
    footprint: Tensor
    actions: ActionSet


@cache
def workload() -> Workload:
    """What the paper's method begins with: random data of the robot's world, and Γ and C."""
    generator, domain = _seeded(0), Tabletop()
    data = collect(Scenes(domain.world), TRANSITIONS, LABELS, generator)
    knowledge = domain.models(domain).fit(data, 0)
    return workload_of(knowledge, domain, SCENARIOS, generator)


@cache
def larger_workload() -> Workload:
    """The same models on five times as many placements, as W soon has more than twenty."""
    return workload_of(workload().knowledge, Tabletop(), 5 * SCENARIOS, _seeded(4))


def workload_of(
    knowledge: Knowledge, domain: Tabletop, count: int, generator: Generator
) -> Workload:
    """The models as an environment of so many random placements around the table."""
    world = domain.world(domain.draw("perimeter", count, generator))
    footprint = torch.tensor(domain.robot.description.footprint)
    environment = domain.models(domain).imagine(knowledge, first_percepts(world), 1, generator)
    return Workload(knowledge, environment, footprint, paper_actions())


def first_population(size: int, actions: ActionSet) -> Population:
    """Random graphs, as evolution begins with."""
    return slim(random_population(size, actions, CAPACITY, NODES, _seeded(1)))


@cache
def evolved_population() -> Population:
    """A thousand individuals after some generations on the workload."""
    work, settings = workload(), EvolutionSettings(population=POPULATION)
    for generation in evolve(work.environment, work.actions, settings, _seeded(2)):
        if generation.number == GENERATIONS:
            break
    return generation.population


def later_population(size: int) -> Population:
    """So many children of the evolved population: as much work each, however many there are."""
    generator, evolved = _seeded(3), evolved_population()
    parents = replace(evolved, graphs=widened(evolved.graphs, CAPACITY))  # room for new nodes
    pairs = torch.randint(len(parents), (2, (size + 1) // 2), generator=generator)
    children = crossover(parents[pairs[0]], parents[pairs[1]], generator)
    return slim(mutate(children, workload().actions, generator)[:size])


def populations() -> dict[str, Population]:
    """The two populations of a thousand that rollouts are measured on, by label."""
    return {
        "first population": first_population(POPULATION, workload().actions),
        f"after {GENERATIONS} generations": evolved_population(),
    }


def _seeded(seed: int) -> Generator:
    return torch.Generator().manual_seed(seed)
