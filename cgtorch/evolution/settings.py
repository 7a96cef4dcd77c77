"""How a population evolves."""

from dataclasses import dataclass

from cgtorch.evolution.fitness import Fitness, chance_of_success, episode_return
from cgtorch.evolution.offspring import crossover, mutate
from cgtorch.evolution.population import TAU, Crossover, FirstGraphs, Mutation, random_graphs
from cgtorch.evolution.selection import Selection, lexicase, tournament
from cgtorch.evolution.varied_graphs import varied_graphs
from cgtorch.ground.errors import SettingsError


@dataclass(frozen=True)
class EvolutionSettings:
    """How a population evolves.

    One can give one's own functions for `selection`, `fitness`, `crossover`, `mutation` and
    `first_graphs`. A value that cannot work is a SettingsError.

    Attributes:
        population: number of individuals, of each island.
        selection: how parents are chosen, `lexicase` or `tournament(rounds)`.
        fitness: what a run is worth.
        crossover: how two parents become two children.
        mutation: how children change.
        elite: best individuals that go on unchanged.
        capacity: the most nodes a graph can have.
        initial_nodes: fewest and most nodes of a first graph, before pruning.
        first_graphs: draws populations of random graphs, `random_graphs` or `varied_graphs`. Beside
            seeds, the random half of a first population is always of `random_graphs`.
        tau: variance of the drift of strategy parameters (eq. 2).
        islands: populations that evolve apart; see `cgtorch.evolution.islands`.
        migration: generations between two migrations.
        lineages: structures whose parameters are tuned at once; see `cgtorch.evolution.lineages`.
            None are if it is 0, and parameters change by mutation alone, as in the paper.
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
"""Settings for worlds with rewards, where every episode is one of the world itself."""
