"""A training in physics that is stopped and gone on with ends with the same bits.

What physics has answered is remembered while a program runs only. So each time a run is opened,
all that it still needs is simulated again, by other models of the robot.
"""

import shutil
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load
from support import create_run
from trained import SMALL, Trained

pytest.importorskip("mujoco")

from cgtorch.improvement.events import Event, GenerationDone, WorldTested
from cgtorch.runs.stored_run import read_run
from cgtorch.svm.storage import notes_of
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training import train as training
from cgtorch.training.context import Training

STAGE = "S0"


def gone_on(folder: Path, stop_at: int | None = None) -> list[Event]:
    """Go on with a run, and stop it at an event; all events until then."""
    events: list[Event] = []

    def watch(event: Event) -> None:
        events.append(event)
        if len(events) - 1 == stop_at:
            raise KeyboardInterrupt

    run = read_run(folder)
    with suppress(KeyboardInterrupt):
        training.train(Training(run, watch, lambda message: nullcontext(), "cpu", 0.0), STAGE)
    return events


def files(folder: Path) -> dict[str, Any]:
    """What a run ends with, but for times: notes and bytes of all tensors, skills and scenarios."""
    found: dict[str, Any] = {}
    for path in folder.rglob("*.safetensors"):
        data = path.read_bytes()
        tensors = {name: x.numpy().tobytes() for name, x in load(data).items()}
        found[str(path.relative_to(folder))] = notes_of(data), tensors
    for path in (*folder.rglob("skill.json"), *folder.rglob("scenarios.json")):
        found[str(path.relative_to(folder))] = path.read_bytes()
    return found


@pytest.mark.hostile
def test_the_same_bits(trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Data and models are those of a kinematic run, as collecting them takes a minute."""
    monkeypatch.setattr(training, "FRESH", 2)
    monkeypatch.setattr(training, "OVERALL", 2)
    begun = create_run(tmp_path / "begun", SMALL, TabletopSettings(world="mujoco")).folder
    shutil.copytree(trained.folder / "start", begun / "start")
    alone = tmp_path / "alone"
    shutil.copytree(begun, alone)
    events = gone_on(alone)
    wanted = files(alone)
    assert {f"{STAGE}/skill.json", f"{STAGE}/data.safetensors"} <= {*wanted}
    kinds = [type(event) for event in events]
    for place in (kinds.index(GenerationDone), kinds.index(WorldTested)):
        run = tmp_path / f"stopped-{place}"
        shutil.copytree(begun, run)
        gone_on(run, stop_at=place)
        assert not (run / STAGE).exists()
        assert list((run / "journal").rglob("*.safetensors"))
        gone_on(run)
        assert files(run) == wanted
