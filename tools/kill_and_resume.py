"""Kill a training at random moments, resume it each time, and compare it with an undisturbed one.

    python tools/kill_and_resume.py FOLDER [--kills 50] [--stage S3] [--seed 0] [--world mujoco]

A small run is made once without a disturbance, then again and again under `kill -9`, until it has
survived the given number of kills. Runs are equal if all skills, W, M, data and models are equal,
and the whole log except times and interruptions.
"""

import random
import shutil
import signal
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

import click
from safetensors.torch import load

from cgtorch.ground.files import read_json
from cgtorch.runs.log import read_log
from cgtorch.svm.storage import notes_of

SMALL = [
    *("--population", "60", "--generations", "30", "--attempts", "6"),
    *("--checkpoint-seconds", "0.5", "--quiet"),
]
SIZES = {
    "kinematic": ["--practice", "10", "--transitions", "300"],
    "mujoco": ["--practice", "4", "--transitions", "100"],
}
"""Of the runs, by the world that they are made in."""
TIMES = ("time", "seconds", "search_seconds")
OF_INTERRUPTIONS = ("recalled", "damaged", "changed", "ended")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--kills", default=50, show_default=True, help="Kills to survive at least.")
@click.option("--stage", default="S3", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the runs and of the moments.")
@click.option("--world", default="kinematic", show_default=True, type=click.Choice([*SIZES]))
def command(folder: Path, kills: int, stage: str, seed: int, world: str) -> None:
    """Kill a training at random moments and compare it with one left alone."""
    draw = random.Random(seed)  # noqa: S311  of moments, not of secrets
    shutil.rmtree(folder / "alone", ignore_errors=True)
    began = time.monotonic()
    words = ["--stage", stage, "--seed", str(seed), "--world", world, *SIZES[world]]
    train(folder / "alone", words)
    usual = time.monotonic() - began
    wanted, survived, runs = results_of(folder / "alone"), 0, 0
    while survived < kills:
        run = folder / f"killed-{runs}"
        shutil.rmtree(run, ignore_errors=True)
        hits = 0
        # What comes before the first stage is not kept half-way, so patience grows.
        while not train(run, words, draw.uniform(0, usual * (0.5 + hits / 4))):
            hits += 1
        check_same(run, wanted)
        survived, runs = survived + hits, runs + 1
        click.echo(f"{run}: {hits} kills, the same; {survived} of {kills}")


def train(run: Path, words: list[str], seconds: float | None = None) -> bool:
    """Begin or resume a run, for at most `seconds`; returns whether it has ended."""
    program = [str(Path(sys.executable).with_name("cgtorch-train")), "--run-dir", str(run)]
    process = subprocess.Popen(
        [*program, *words, *SMALL], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
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
    """All results of a run except times: its files by name, and its log."""
    names = [p for p in sorted(run.rglob("*.json")) if p.name != "run.json"]
    found = {str(p.relative_to(run)): timeless(read_json(p)) for p in names}
    for path in sorted(run.rglob("*.safetensors")):
        data = path.read_bytes()  # whose notes are in any order
        tensors = {n: sha256(x.numpy().tobytes()).hexdigest() for n, x in load(data).items()}
        found[str(path.relative_to(run))] = notes_of(data), tensors
    rows = (row for row in read_log(run) if row["event"] not in OF_INTERRUPTIONS)
    return {**found, "log.jsonl": [timeless(row) for row in rows]}


def check_same(run: Path, wanted: dict[str, Any]) -> None:
    """ClickException unless a run has the wanted results (`results_of`)."""
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
