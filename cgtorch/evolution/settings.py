"""Settings of an evolution, and a dry run of its parts before anything is evaluated."""

from dataclasses import dataclass

import torch
from torch import Generator

from cgtorch.evolution.first_graphs import random_graphs, varied_graphs
from cgtorch.evolution.fitness import (
    Fitness,
    chance_of_success,
    episode_return,
    evaluator,
    last_success,
)
from cgtorch.evolution.operators import crossover, mutate
from cgtorch.evolution.population import (
    INITIAL_STRATEGY,
    STRATEGY,
    TAU,
    Crossover,
    FirstGraphs,
    Mutation,
    Population,
    bounds,
    check_offspring,
    initial_strategy,
    random_population,
)
from cgtorch.evolution.racing import MakeEvaluator
from cgtorch.evolution.selection import Selection, lexicase, tournament
from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.dry_run import ROWS, expect, kind, returned, two_rows
from cgtorch.ground.environment import Environment
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.given import a_function, whole_number
from cgtorch.simulation import rollout

WHOLE = {
    "population": 2, "elite": 0, "newcomers": 0, "capacity": 1, "islands": 1, "migration": 1,
    "lineages": 0,
}  # fmt: skip
"""The settings that are whole numbers, with the least value of each."""
MOST = 2**31 - 1
FUNCTIONS = ("evaluate", "selection", "fitness", "crossover", "mutation", "first_graphs")


@dataclass(frozen=True)
class EvolutionSettings:
    """Settings of an evolution; SettingsError for a value that cannot work.

    You can pass your own functions for `selection`, `fitness`, `crossover`, `mutation` and
    `first_graphs`.

    Attributes:
        population: Number of individuals, of each island.
        evaluate: How individuals are evaluated: `evaluator` runs all on all scenarios, `race` fewer
            of them on more. With `race`, children differ in parameters rather than in structure as
            soon as the best individual solves a scenario.
        selection: How parents are selected, `lexicase` or `tournament(rounds)`.
        fitness: The value of a rollout.
        crossover: How two parents become two children.
        mutation: How children change.
        elite: Number of best individuals that are copied unchanged.
        newcomers: Number of individuals of each later population that are random graphs in place of
            children, so that the search leaves local optima (Grefenstette, "Genetic algorithms for
            changing environments", PPSN 1992).
        capacity: The largest number of nodes of a graph.
        initial_nodes: The fewest and most nodes of a first graph, before pruning.
        first_graphs: Draws random graphs, `random_graphs` or `varied_graphs`. With seeds, the
            random half of a first population is always drawn by `random_graphs`.
        strategy: The strategy parameters (`STRATEGY`) of random graphs.
        tau: The variance of the drift of strategy parameters (eq. 2).
        islands: Number of populations that evolve separately; see `cgtorch.evolution.search`.
        migration: Number of generations between two migrations.
        lineages: Number of structures whose parameters are tuned at once; see
            `cgtorch.evolution.lineages`. With 0, parameters change by mutation only, as in the
            paper.
    """

    population: int = 400
    evaluate: MakeEvaluator = evaluator
    selection: Selection = lexicase
    fitness: Fitness = chance_of_success
    crossover: Crossover = crossover
    mutation: Mutation = mutate
    elite: int = 1
    newcomers: int = 0
    capacity: int = 24
    initial_nodes: tuple[int, int] = (4, 12)
    first_graphs: FirstGraphs = random_graphs
    strategy: tuple[float, ...] = INITIAL_STRATEGY
    tau: float = TAU
    islands: int = 1
    migration: int = 5
    lineages: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        self._check_types()
        if not 0 <= self.elite < self.population:
            raise SettingsError(f"elite is {self.elite}; give 0 to {self.population - 1}")
        if not 0 <= self.newcomers < self.population - self.elite:
            most = self.population - self.elite - 1
            raise SettingsError(f"newcomers are {self.newcomers}; give 0 to {most}")
        low, high = self.initial_nodes
        if not 1 <= low <= high <= self.capacity:
            raise SettingsError(
                f"initial nodes are {low} to {high}; give a range within 1 to {self.capacity}"
            )
        least, most = bounds()
        numbers = isinstance(self.strategy, tuple) and all(
            isinstance(each, float | int) for each in self.strategy
        )
        given = torch.tensor(self.strategy if numbers else ())
        if given.shape != least.shape or not ((given >= least) & (given <= most)).all():
            limits = float(least[0]), float(most[0]), float(most[-1])
            raise SettingsError(
                f"strategy is {self.strategy}; give {len(STRATEGY)} numbers from {limits[0]:g} to "
                f"{limits[1]:g}, the last up to {limits[2]:g}"
            )
        if self.lineages and self.islands > 1:
            raise SettingsError(f"lineages is {self.lineages}; give 0 where there are islands")

    def _check_types(self) -> None:
        """SettingsError for a value of another type, or a number that no other setting allows."""
        for name, least in WHOLE.items():
            number = whole_number(getattr(self, name), name, least, MOST)
            object.__setattr__(self, name, number)
        for name in FUNCTIONS:
            a_function(getattr(self, name), name)
        if not isinstance(self.tau, float | int) or not 0 <= self.tau < float("inf"):
            raise SettingsError(f"tau is {self.tau!r:.40}; give a finite variance of at least 0")
        given = self.initial_nodes
        if not isinstance(given, tuple) or [type(each) for each in given] != [int, int]:
            raise SettingsError(f"initial nodes are {given!r:.40}; give two whole numbers (a, b)")


REWARDS = EvolutionSettings(
    population=48,
    selection=tournament(),
    fitness=episode_return,
    initial_nodes=(2, 2),
    first_graphs=varied_graphs,
    lineages=4,
)
"""Settings for worlds with rewards, where each rollout is an episode in the world itself."""


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
