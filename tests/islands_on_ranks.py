"""Evolutions of one to four islands, alone or as one of several ranks, broken off where asked.

For each count of islands: what was told, and what it came to or what was kept of it.
"""

import hashlib
import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import torch
from support import model, search, seeded, stochastic_actions

from cgtorch.evolution import EvolutionSettings
from cgtorch.ground import distributed as ranks
from cgtorch.improvement.events import Event, GenerationDone
from cgtorch.improvement.setup import Budget
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.runs.journal import FileJournal
from cgtorch.svm.storage import notes_of

COUNTS = range(1, 5)
BUDGET = Budget(generations=9, patience=99)


def evolved(folder: Path, islands: int, stop: int) -> list[Any]:
    """Nine generations of 13 individuals an island, or those up to `stop`."""
    sizes = {"capacity": 10, "initial_nodes": (2, 8), "islands": islands, "migration": 2}
    settings = EvolutionSettings(13, **sizes)  # type: ignore[arg-type]
    generator, told = seeded(3), list[Any]()

    def watch(event: Event) -> None:
        if isinstance(event, GenerationDone):
            found = event.generation
            told.append([found.number, found.best, found.transitions, found.succeeded.tolist()])
            assert len(found.islands) == len(ranks.held(islands))
            if found.number == stop:
                raise KeyboardInterrupt

    with suppress(KeyboardInterrupt), FileJournal(folder, seconds=0) as journal:
        setup = search(stochastic_actions(), settings, BUDGET, journal)
        stage = replace(setup, name="S0", generator=generator, watch=watch)
        best = evolve_candidate(stage, "x", model(0, 7))
        champion, solved = best.champion, best.solved
        after = torch.rand(3, generator=generator)  # what follows an evolution draws from it, too
        found = [*vars(champion.graphs).values(), champion.strategy, solved, after]
        return [told, hashlib.sha256(b"".join(t.numpy().tobytes() for t in found)).hexdigest()]
    parts = sorted(folder.glob("*.*.safetensors"))
    return [told, [[p.name, notes_of(p.read_bytes())["sha256"]] for p in parts]]


def everything(folder: Path, stop: int) -> list[list[Any]]:
    """For each count of islands."""
    return [evolved(folder / str(islands), islands, stop) for islands in COUNTS]


def as_rank(folder: Path, stop: int) -> None:
    """The same with other ranks, of which the first prints it as JSON."""
    with ranks.together():
        result = everything(folder, stop)
        if ranks.first():
            click.echo(json.dumps(result))
