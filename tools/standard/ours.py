"""This library on the standard tasks, with one set of actions and settings for all of them."""

import torch
from torch import Generator, Tensor

from cgtorch.actions import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    LinearNN,
    MoveBase,
    RecurrentNN,
)
from cgtorch.evolution import REWARDS, evolve
from cgtorch.graphs import Graphs
from cgtorch.simulation import rollout
from standard.measure import Player, Trial
from standard.task import Task

STARTS = 4
"""Episodes of an individual, where they do not all begin alike; each generation has other ones."""
MOST = 10**6
"""Transitions of a run at most: episodes end by themselves."""
HIDDEN = 8
BETTER = 1.2
"""Where all episodes begin alike, only what is better by so much than what was tried of the same
lineages is tried."""


def actions_of(task: Task) -> ActionSet:
    """What nodes can be: networks, doing what they say, and branches."""
    d, u = task.inputs, task.outputs
    networks = LinearNN(d, u), ContinuousNN(d, HIDDEN, u), RecurrentNN(d, outputs=u)
    names = "Linear", "Aim", "Recur", "Branch", "Step"
    return ActionSet(names, (*networks, BranchingNN(d), MoveBase(u)))


def search(trial: Trial) -> None:
    """Evolve graphs on random starts until one is good on fresh ones, too."""
    actions, generator = actions_of(trial.task), Generator().manual_seed(trial.seed)
    starts, tried, known = trial.starts(STARTS), -float("inf"), set[bytes]()
    for generation in evolve(
        lambda number: trial.world(starts), actions, REWARDS, generator, max_transitions=MOST
    ):
        trial.evaluated(len(generation.population))
        graphs = generation.champion.graphs
        identity = graphs.parameters.numpy().tobytes()
        if not generation.islands[0].state.lineages:  # others begin, with what they are worth
            tried = -float("inf")
        again = starts == 1 and (generation.best <= BETTER * tried or identity in known)
        if generation.best >= trial.task.solved and not again:
            tried = generation.best
            known.add(identity)
            trial.offer(player_of(graphs, actions), generation.best)
        if not trial.open:
            break


def player_of(graphs: Graphs, actions: ActionSet) -> Player:
    """What plays the episodes of a world once by a graph; one that does not end returns -inf."""

    def play(world: object) -> Tensor:
        found = rollout(graphs, actions, world, max_transitions=MOST)  # type: ignore[arg-type]
        return torch.full((1,), -torch.inf) if found.returns is None else found.returns[0]

    return play
