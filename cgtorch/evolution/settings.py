"""Settings of an evolution."""

from dataclasses import dataclass

from cgtorch.evolution.fitness import Fitness, chance_of_success, episode_return
from cgtorch.evolution.offspring import crossover, mutate
from cgtorch.evolution.population import TAU, Crossover, FirstGraphs, Mutation, random_graphs
from cgtorch.evolution.selection import Selection, lexicase, tournament
from cgtorch.evolution.varied_graphs import varied_graphs
from cgtorch.ground.errors import SettingsError


@dataclass(frozen=True)
class EvolutionSettings:
    """Settings of an evolution; SettingsError for a value that cannot work.

    You can pass your own functions for `selection`, `fitness`, `crossover`, `mutation` and
    `first_graphs`.

    Attributes:
        population: Number of individuals, of each island.
        selection: How parents are selected, `lexicase` or `tournament(rounds)`.
        fitness: The value of a rollout.
        crossover: How two parents become two children.
        mutation: How children change.
        elite: Number of best individuals that are copied unchanged.
        capacity: The largest number of nodes of a graph.
        initial_nodes: The fewest and most nodes of a first graph, before pruning.
        first_graphs: Draws random graphs, `random_graphs` or `varied_graphs`. With seeds, the
            random half of a first population is always drawn by `random_graphs`.
        tau: The variance of the drift of strategy parameters (eq. 2).
        islands: Number of populations that evolve separately; see `cgtorch.evolution.islands`.
        migration: Number of generations between two migrations.
        lineages: Number of structures whose parameters are tuned at once; see
            `cgtorch.evolution.lineages`. With 0, parameters change by mutation only, as in the
            paper.
    """

    population: int = 400
    selection: Selection = lexicase
    fitness: Fitness = chance_of_success
    crossover: Crossover = crossover
    mutation: Mutation = mutate
    elite: int = 1
    capacity: int = 24
    initial_nodes: tuple[int, int] = (4, 12)
    first_graphs: FirstGraphs = random_graphs
    tau: float = TAU
    islands: int = 1
    migration: int = 5
    lineages: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.population < 2:
            raise SettingsError(f"population is {self.population}; give at least 2")
        if not 0 <= self.elite < self.population:
            raise SettingsError(f"elite is {self.elite}; give 0 to {self.population - 1}")
        low, high = self.initial_nodes
        if not 1 <= low <= high <= self.capacity:
            raise SettingsError(
                f"initial nodes are {low} to {high}; give a range within 1 to {self.capacity}"
            )
        for name in ("islands", "migration"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} is {getattr(self, name)}; give at least 1")
        if self.lineages < 0 or (self.lineages and self.islands > 1):
            raise SettingsError(
                f"lineages is {self.lineages}; give 0 or more, and 0 where there are islands"
            )
        if not 0 <= self.tau < float("inf"):
            raise SettingsError(f"tau is {self.tau}; give a finite variance of at least 0")


REWARDS = EvolutionSettings(
    population=48,
    selection=tournament(),
    fitness=episode_return,
    initial_nodes=(2, 2),
    first_graphs=varied_graphs,
    lineages=4,
)
"""Settings for worlds with rewards, where each rollout is an episode in the world itself."""
