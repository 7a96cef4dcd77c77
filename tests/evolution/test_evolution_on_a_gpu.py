"""Evolutions whose models say that they are on a GPU, with sub-skills and fitness of one's own."""

from itertools import islice

import pytest
import torch
from pretended_gpu import GPU, pretended_gpu
from random_models import models_as, random_models
from support import nested_actions, seeded
from torch import Tensor

from cgtorch.evolution import EvolutionSettings, chance_of_success, evolve
from cgtorch.evolution.fitness import Fitness
from cgtorch.graphs import ActionSet
from cgtorch.improvement.specialists import shrunk
from cgtorch.simulation import ModelEnvironment, Rollouts
from cgtorch.tabletop.actions import paper_actions


def hurried(runs: Rollouts, chance: Tensor) -> Tensor:
    return chance / (1 + runs.transitions / 100)


def evolved(
    environment: ModelEnvironment, actions: ActionSet, fitness: Fitness, keep: Tensor
) -> tuple[list[Tensor], list[float]]:
    """Champions, shrunk, and the best fitness of each of three generations."""
    settings = EvolutionSettings(population=60, fitness=fitness)
    found = evolve(environment, actions, settings, seeded(0), keep=keep)
    generations = list(islice(found, 3))
    last = generations[-1].champion
    small = shrunk(last, actions, environment, 20, fitness, keep.device)
    assert small.graphs.start.is_cpu  # evolution itself is on the CPU
    return [*vars(small.graphs).values()], [g.best for g in generations]


@pytest.mark.parametrize(("fitness", "kept"), [(chance_of_success, 0), (hurried, 0), (hurried, 1)])
@pytest.mark.parametrize("actions", [paper_actions(), nested_actions(2, paper_actions())])
def test_evolutions_are_the_same(actions: ActionSet, fitness: Fitness, kept: int) -> None:
    environment = models_as(random_models(3, 7), torch.float32)
    keep = torch.arange(7) < kept
    with pretended_gpu():
        elsewhere = models_as(environment, torch.float32, GPU)
        found, best = evolved(elsewhere, actions, fitness, keep.to(GPU))
    wanted, wanted_best = evolved(environment, actions, fitness, keep)
    assert best == pytest.approx(wanted_best, rel=1e-5)  # on the CPU Γ and C are compiled
    assert max(best) > 0 or kept
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))
