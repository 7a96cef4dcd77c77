"""This library on the standard tasks, with one set of actions and settings for all of them."""

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from cgtorch.evolution import REWARDS, EvolutionSettings, evolve
from cgtorch.graphs import ActionSet, Graphs, reward_actions
from cgtorch.simulation import rollout
from standard.measure import Player, Trial

STARTS = 4
"""Episodes per individual, where initial states differ; each generation has new ones."""
MOST = 10**6
"""The maximum number of transitions of a run; episodes end by themselves."""


ACTIONS: Callable[[int, int], ActionSet] = reward_actions
"""The actions of graphs, for percepts and controls of these lengths."""


def search(trial: Trial) -> None:
    """Evolve graphs on random starts until one is good on fresh ones, too."""
    searched(trial, REWARDS, ACTIONS)


def searched(
    trial: Trial, settings: EvolutionSettings, actions_for: Callable[[int, int], ActionSet]
) -> None:
    """`search` with these settings, and actions for percepts and controls of the task's lengths."""
    actions = actions_for(trial.task.inputs, trial.task.outputs)
    generator, starts = Generator().manual_seed(trial.seed), trial.starts(STARTS)
    for generation in evolve(
        lambda number: trial.world(starts), actions, settings, generator, max_transitions=MOST
    ):
        trial.evaluated(len(generation.population))
        graphs = generation.champion.graphs
        identity = graphs.parameters.numpy().tobytes()
        trial.offer(player_of(graphs, actions), generation.best, identity)
        if not trial.open:
            break


def player_of(graphs: Graphs, actions: ActionSet) -> Player:
    """A function that plays the episodes of a world by a graph; unfinished ones return -inf."""

    def play(world: object) -> Tensor:
        found = rollout(graphs, actions, world, max_transitions=MOST)  # type: ignore[arg-type]
        return torch.full((1,), -torch.inf) if found.returns is None else found.returns[0]

    return play
