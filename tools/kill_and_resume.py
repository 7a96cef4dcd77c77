"""Kill a training at random moments, go on with it each time, and compare with one left alone.

    python tools/kill_and_resume.py FOLDER [--kills 50] [--stage S3] [--seed 0]

A small run is made once without a disturbance, then again and again under `kill -9`, until as many
kills as asked for have been survived. A run counts as the same if all its skills, W, M, ledgers and
results but for times, and the whole history of fitness in TensorBoard, are.
"""

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cgtorch.ground.files import read_json

SMALL = [
    *("--population", "60", "--generations", "30", "--attempts", "6", "--practice", "10"),
    *("--transitions", "300", "--labels", "600", "--checkpoint-seconds", "0.5", "--quiet"),
]
TIMES = ("seconds", "search_seconds")
FITNESS = ("fitness/best", "fitness/mean", "solved/W", "solved/M")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--kills", default=50, show_default=True, help="Kills to survive at least.")
@click.option("--stage", default="S3", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the runs and of the moments.")
def command(folder: Path, kills: int, stage: str, seed: int) -> None:
    """Kill a training at random moments and compare it with one left alone."""
    draw = random.Random(seed)  # noqa: S311  of moments, not of secrets
    shutil.rmtree(folder / "alone", ignore_errors=True)
    began = time.monotonic()
    train(folder / "alone", stage, seed)
    usual = time.monotonic() - began
    wanted, survived, runs = results_of(folder / "alone"), 0, 0
    while survived < kills:
        run = folder / f"killed-{runs}"
        shutil.rmtree(run, ignore_errors=True)
        hits = 0
        # What comes before the first stage is not kept half-way, so patience grows.
        while not train(run, stage, seed, draw.uniform(0, usual * (0.5 + hits / 10))):
            hits += 1
        check_same(run, wanted)
        survived, runs = survived + hits, runs + 1
        click.echo(f"{run}: {hits} kills, the same; {survived} of {kills}")


def train(run: Path, stage: str, seed: int, seconds: float | None = None) -> bool:
    """Begin a run or go on with it, for so many seconds at most; whether it has ended."""
    program = [str(Path(sys.executable).with_name("cgtorch-train")), "--stage", stage]
    about = ["--seed", str(seed), "--run-dir", str(run)]
    process = subprocess.Popen(
        [*program, *about, *SMALL], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        code = process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return False
    if code:
        raise click.ClickException(f"training {run} ended with exit code {code}")
    return True


def results_of(run: Path) -> dict[str, Any]:
    """All that a run has come to but times: its files by name, and its history of fitness."""
    names = [p for p in sorted(run.rglob("*.json")) if p.name != "run.json"]
    found = {str(p.relative_to(run)): timeless(read_json(p)) for p in names}
    events = EventAccumulator(str(run), size_guidance={"scalars": 0})
    events.Reload()
    for tag in FITNESS:
        found[tag] = [(e.step, e.value) for e in events.Scalars(tag)]
    return found


def check_same(run: Path, wanted: dict[str, Any]) -> None:
    """ClickException unless a run has come to what is wanted, as `results_of` gives it."""
    if (found := results_of(run)) != wanted:
        odd = sorted(k for k in {*wanted, *found} if wanted.get(k) != found.get(k))
        raise click.ClickException(f"{run} differs in {', '.join(odd)}")


def timeless(data: Any) -> Any:
    """JSON values without times, at any depth."""
    if isinstance(data, dict):
        return {k: timeless(v) for k, v in data.items() if k not in TIMES}
    return [timeless(v) for v in data] if isinstance(data, list) else data


if __name__ == "__main__":
    command()
