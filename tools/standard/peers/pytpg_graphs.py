"""Tangled program graphs of pytpg.

As in its example examples/evolve_cartpole.py: 4 registers, tournaments of 3, one elite, 2 mutations
of each child, and 3 episodes, whose starts are the same for all and do not change; but a population
of 32 with 4 learners in a team, the library's own defaults, where this small example has 12 and 3.
Its actions are discrete, so where controls are continuous they are -1, 0 and 1. Where memory is
needed programs also read the last three percepts before, as in examples/stateful_delayed_signal.py.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from pytpg.config import TPGConfig
from pytpg.evolution import (
    EvaluatedIndividual,
    EvaluatedPopulation,
    GenomeConfig,
    InitializationConfig,
    PopulationInitializer,
    ReproductionConfig,
    create_rng,
)
from pytpg.memory import NullMemory, ObservationHistoryMemory, StatefulGraphRuntime
from pytpg.runtime import GraphRuntime, RuntimeConfig
from torch import Tensor

from standard.measure import Trial, player
from standard.peers import NEEDS_MEMORY
from standard.task import Task

EPISODES, REGISTERS, DEPTH = 3, 4, 3


class Graphs:
    """P graphs as a policy of lanes, equally many of each, which follow each other."""

    def __init__(self, graphs: Sequence[Any], task: Task) -> None:
        """The graphs, of which actions are those of `controls_of`."""
        self.graphs, self.task, self.controls = graphs, task, controls_of(task)
        self.config = RuntimeConfig(task.inputs + memory_of(task).size, REGISTERS)

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """See `Policy`; what is remembered are what acts in the lanes, and graphs."""
        if memory is None:
            each = len(percept) // len(self.graphs)
            memory = [self._acting(graph) for graph in self.graphs for _ in range(each)]
        rows, seen = live.nonzero()[:, 0].tolist(), percept.tolist()
        action = torch.zeros(len(percept), dtype=torch.long)
        action[live] = torch.tensor([memory[row](seen[row]) for row in rows])
        return self.controls[action], memory

    def _acting(self, graph: Any) -> Callable[[list[float]], int]:
        """What gives an action for each percept of one lane."""
        runtime = GraphRuntime(self.config, validate_before_execution=False)
        acting = StatefulGraphRuntime(runtime, memory_of(self.task), self.task.inputs)
        acting.reset_episode()
        return lambda seen: int(acting.act(graph, seen))


def memory_of(task: Task) -> Any:
    """What a lane remembers."""
    if task.name in NEEDS_MEMORY:
        return ObservationHistoryMemory(task.inputs, DEPTH)
    return NullMemory()


def controls_of(task: Task) -> Tensor:
    """(A, U) the controls of A actions."""
    return torch.eye(task.outputs) if task.discrete else torch.tensor([[-1.0], [0.0], [1.0]])


def config_of(task: Task) -> Any:
    """The example's configuration for a task."""
    inputs, actions = task.inputs + memory_of(task).size, len(controls_of(task))
    genome = GenomeConfig(inputs, register_count=REGISTERS, n_actions=actions)
    return TPGConfig(
        InitializationConfig(genome),
        tournament_size=3,
        reproduction=ReproductionConfig(elite_count=1, mutation_steps=2),
    )


def search(trial: Trial) -> None:
    """Go on until the best of a generation is good on fresh starts, too."""
    rng, config = create_rng(trial.seed), config_of(trial.task)
    initializer = config.create_initializer()
    population = PopulationInitializer(initializer).initialize(rng)
    reproducer = config.create_reproducer(initializer.factory)
    world = trial.world(trial.starts(EPISODES))
    while trial.open:
        graphs = population.individuals
        policy = Graphs(graphs, trial.task)
        fitness = trial.returns_in(world, policy, len(graphs)).mean(1).tolist()
        individuals = map(EvaluatedIndividual, range(len(graphs)), graphs, fitness)
        evaluated = EvaluatedPopulation(population.generation, tuple(individuals))
        best = evaluated.best
        trial.offer(player(Graphs([best.graph], trial.task)), best.fitness, best.graph)
        population = reproducer.reproduce(evaluated, rng).population
