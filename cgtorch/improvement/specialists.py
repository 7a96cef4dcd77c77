"""Specialists: small graphs evolved on a group of missed scenarios, without W as a constraint."""

import time
from math import inf
from typing import Any

import torch
from torch import Tensor

from cgtorch.evolution import Population, evolve
from cgtorch.evolution.island_tensors import restore
from cgtorch.ground import distributed as ranks
from cgtorch.ground.environment import Environment
from cgtorch.improvement.checkpoint import (
    checkpoint_of,
    found_from,
    found_tensors,
    islands_from,
)
from cgtorch.improvement.events import EvolutionRecalled, GenerationDone, solved_of
from cgtorch.improvement.setup import Stage
from cgtorch.improvement.stopping import Found


def evolve_candidate(
    stage: Stage[Any],
    name: str,
    environment: Environment,
    *,
    keep: Tensor | None = None,
    seeds: Population | None = None,
) -> Found:
    """Evolve until all scenarios are solved in the environment and the fitness has settled.

    The environment of B scenarios runs on the setup's device. For `keep` (B,) bool and `seeds` see
    `cgtorch.evolution.evolve`. Results in the journal are not computed again.
    """
    setup, generator, step = stage.setup, stage.generator, f"evolution {name}"
    settings, journal = setup.evolution, setup.journal
    keep = torch.zeros(environment.num_scenarios, dtype=torch.bool) if keep is None else keep
    found, islands = None, None
    if known := journal.recall(step):
        found = found_from(known, setup.actions, len(keep))
        stage.watch(EvolutionRecalled(stage.name, name, found))
        restore(generator, known)
        return found
    if checkpoint := journal.recall_checkpoint(step):
        found = found_from(checkpoint.about, setup.actions, len(keep))
        islands = islands_from(checkpoint, setup.actions, generator, settings.islands)
        stage.watch(EvolutionRecalled(stage.name, name, found))
    began = time.perf_counter()
    for generation in evolve(
        environment,
        setup.actions,
        settings,
        generator,
        keep=keep.to(setup.device),
        seeds=seeds,
        islands=islands,
        max_transitions=setup.max_transitions,
    ):
        found = found or Found(generation.champion, keep, -inf)
        checkpoint = checkpoint_of(found, generation.islands, settings.islands)
        journal.record_checkpoint(step, checkpoint)
        seconds, counts = time.perf_counter() - began, solved_of(generation.succeeded, keep)
        done = generation, setup.budget.generations, seconds
        stage.watch(GenerationDone(stage.name, name, *counts, *done))
        found, began = found.after(generation, seconds), began + seconds
        if found.ends(setup.budget):
            break
    assert found is not None  # noqa: S101  the loop body has run
    # Where the first island is not held, its random numbers have not been drawn.
    generator.set_state(ranks.broadcast(generator.get_state()))
    journal.record(step, {**found_tensors(found), "generator": generator.get_state()})
    return found
