"""Algorithm 2 as a stream of generations."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch.actions import ActionSet
from cgtorch.environment import Environment
from cgtorch.evolution.evolution import EvolutionSettings, EvolutionState, initial_state, tell
from cgtorch.evolution.fitness import evaluate
from cgtorch.evolution.population import Population
from cgtorch.evolution.selection import ranking
from cgtorch.simulation import MAX_TRANSITIONS


@dataclass(frozen=True)
class Generation:
    """One evaluated generation.

    Attributes:
        number: counted from 0.
        population: the individuals that were evaluated.
        fitness: (P,).
        best: index of the best, of equal ones the smallest.
        succeeded: (B,) bool, what the best solves in the models.
        transitions: actions executed by all.
        not_finite: individuals that count for nothing, as something about them was not finite.
    """

    number: int
    population: Population
    fitness: Tensor
    best: int
    succeeded: Tensor
    transitions: int
    not_finite: int = 0

    @property
    def state(self) -> EvolutionState:
        """From where `evolve` evaluates this generation again."""
        return EvolutionState(self.population, self.number, self.champion, float("-inf"))

    @property
    def champion(self) -> Population:
        """The best individual, as a population of one."""
        return self.population[self.best : self.best + 1]


def evolve(
    environment: Environment,
    actions: ActionSet,
    settings: EvolutionSettings,
    generator: Generator,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
    state: EvolutionState | None = None,
    max_transitions: int = MAX_TRANSITIONS,
) -> Iterator[Generation]:
    """Evolve without end; whoever iterates decides when it is enough.

    Args:
        environment: the models, on B scenarios.
        actions: what nodes can do.
        settings: of the evolution.
        generator: of all random choices.
        keep: (B,) bool, the scenarios of W (eq. 1a), on the environment's device; none if not
            given, which is on the CPU.
        seeds: earlier individuals, which make up half of the first population.
        state: where to begin, in place of a first population.
        max_transitions: see `cgtorch.simulation.rollout`.
    """
    if keep is None:
        keep = torch.zeros(environment.num_scenarios, dtype=torch.bool)
    if state is None:
        state = initial_state(settings, actions, generator, seeds)
    while True:
        population = state.population
        result = evaluate(population.graphs, actions, environment, keep, max_transitions)
        best = int(ranking(result.fitness, population.graphs.num_nodes)[0])
        yield Generation(
            number=state.generation,
            population=population,
            fitness=result.fitness,
            best=best,
            succeeded=result.succeeded[best],
            transitions=result.transitions,
            not_finite=result.not_finite,
        )
        state = tell(state, result.fitness, settings, actions, generator, result.scores)
