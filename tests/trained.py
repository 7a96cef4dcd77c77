"""One small run, really trained from the robot's files to a skill for two edges of the table.

It takes seconds, so all tests share it, and none may write into its folder.
"""

import pickle
import shutil
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from made_once import made_once, shared_folder
from safetensors.torch import load
from support import create_run
from torch import Tensor

from cgtorch.ground.environment import Lanes
from cgtorch.improvement.events import Event, WorldTested
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.svm.storage import notes_of
from cgtorch.tabletop.world import TabletopWorld
from cgtorch.training.context import Training
from cgtorch.training.train import train

SMALL = RunSettings(
    seed=6,
    population=60,
    generations=15,
    attempts=5,
    practice=4,
    transitions=200,
)
STAGE = "S1"


@dataclass(frozen=True)
class Trained:
    """A run's folder, what was told while it was made, and the results of its stages."""

    folder: Path
    events: tuple[Event, ...]
    results: list[dict[str, Any]]


def trained_run(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """The run, in the folder that all processes share."""
    return _trained(made_once(shared_folder(tmp_path_factory) / "trained", make_run))


@cache
def _trained(folder: Path) -> Trained:
    told = (folder / "told").read_bytes()
    events, results = pickle.loads(told)  # noqa: S301  another process of these tests wrote it
    return Trained(folder / "run", events, results)


def make_run(folder: Path) -> None:
    """Train the run, and keep what was told; `tools/mutate.py` does so before it changes lines."""
    folder.mkdir()
    events: list[Event] = []
    run = create_run(folder / "run", SMALL)
    results = train(Training(run, events.append, lambda message: nullcontext()), STAGE)
    (folder / "told").write_bytes(pickle.dumps((tuple(events), results)))


def copied(trained: Trained, target: Path, stages: tuple[str, ...] = ("S0", "S1")) -> Path:
    """A copy of the run with some of its stages only."""
    skipped = shutil.ignore_patterns("events*", *({"S0", "S1"} - set(stages)))
    shutil.copytree(trained.folder, target, ignore=skipped)
    return target


def interrupted(trained: Trained, target: Path) -> StoredRun:
    """A copy of the run that is in the middle of S1."""
    run = read_run(copied(trained, target, ("S0",)))
    begin_last(run)
    return run


def begin_last(run: StoredRun) -> dict[str, Tensor]:
    """Make S1 up to the end of its first evolution, and return what that came to, but for times."""

    def stop(event: Event) -> None:
        if isinstance(event, WorldTested):
            raise KeyboardInterrupt

    with suppress(KeyboardInterrupt):
        train(Training(run, stop, lambda message: nullcontext()), STAGE)
    return first_evolution(run.folder / "journal")


def without_success(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no grasp on the tabletop succeed any more, whatever is attempted."""
    success = TabletopWorld.success

    def fails(self: TabletopWorld, lanes: Lanes) -> tuple[Lanes, Tensor]:
        lanes, found = success(self, lanes)
        return lanes, torch.zeros_like(found)

    monkeypatch.setattr(TabletopWorld, "success", fails)


def first_evolution(journal: Path) -> dict[str, Tensor]:
    """What the first evolution of S1 came to, but for times."""
    for path in sorted((journal / STAGE).glob("*.safetensors")):
        data = path.read_bytes()
        if notes_of(data)["step"].startswith("evolution"):
            return {name: value for name, value in load(data).items() if name != "numbers"}
    raise AssertionError(f"no evolution in {journal}")
