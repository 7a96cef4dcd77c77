"""One small run, really trained from the robot's files to a skill for two edges of the table.

It takes half a minute, so all tests of a process share it, and none may write into its folder.
"""

import shutil
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from cgtorch.experiments.run import create_run
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.train import train
from cgtorch.improvement.events import Event

SMALL = RunSettings(
    seed=2,
    population=60,
    generations=15,
    attempts=3,
    practice=4,
    transitions=200,
    labels=240,
)
STAGE = "S1"


@dataclass(frozen=True)
class Trained:
    """A run's folder, what was told while it was made, and the results of its stages."""

    folder: Path
    events: tuple[Event, ...]
    results: list[dict[str, Any]]


@cache
def trained_run(base: Path) -> Trained:
    """The run, in a folder within `base`."""
    events: list[Event] = []
    run = create_run(base / "trained", SMALL)
    results = train(run, STAGE, events.append, lambda message: nullcontext())
    return Trained(run.folder, tuple(events), results)


def copied(trained: Trained, target: Path, stages: tuple[str, ...] = ("S0", "S1")) -> Path:
    """A copy of the run with some of its stages only."""
    without = {"S0", "S1"} - set(stages)
    if not stages:
        without.add("ledger")
    skipped = shutil.ignore_patterns("summary.json", "events*", *without)
    shutil.copytree(trained.folder, target, ignore=skipped)
    return target
