"""Kill a training that acts on the stand-in robot at random moments, and compare logs afterwards.

    python tools/kill_robot_run.py FOLDER [--kills 5] [--stage S2 --stage auto] [--seed N]

The robot is a process that is never killed. It counts the actions that it has carried out. At the
end, each of them is a line of the run's log, except at most one for each kill, and no episode was
asked twice.
"""

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import click

from cgtorch.ground.files import JsonLines
from cgtorch.runs.log import read_log

DRIVER = "cgtorch.tabletop.stand_in:StandIn"


def robot(folder: Path, world: str) -> tuple[subprocess.Popen[str], str]:
    """A stand-in robot that counts, and its address."""
    command = [sys.executable, "-m", "cgtorch.tabletop.stand_in", "--port", "0", "--world", world]
    process = subprocess.Popen(
        [*command, "--count", str(folder / "robot.jsonl")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None  # noqa: S101
    line = process.stdout.readline()
    found = re.search(r"at (\S+:\d+)", line)
    if found is None:
        raise click.ClickException(f"the robot said {line!r}")
    return process, found.group(1)


def training(folder: Path, stage: str, seed: int, address: str) -> subprocess.Popen[bytes]:
    """The training, from its beginning or from where it was killed."""
    run = folder / "run"
    new = ["--stage", stage, "--seed", str(seed), "--run-dir", str(run)]
    again = ["--resume", str(run), "--stage", stage]
    if stage == "auto":
        again += ["--rounds", "1"]
    begun = (run / "run.json").is_file()
    command = [str(Path(sys.executable).parent / "cgtorch-train"), "--quiet", "--driver", DRIVER]
    env = os.environ | {"CGTORCH_STAND_IN": address}
    return subprocess.Popen([*command, *(again if begun else new)], env=env)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--kills", default=5, show_default=True)
@click.option("--stage", "stages", multiple=True, default=["S2"], show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option("--world", default="mujoco", show_default=True)
@click.option("--longest", default=8.0, show_default=True, help="s between two kills")
def main(folder: Path, kills: int, stages: tuple[str, ...], seed: int, world: str,
         longest: float) -> None:  # fmt: skip
    """Train, kill, resume, and compare what the robot did with what the log says."""
    folder.mkdir(parents=True, exist_ok=True)
    chance, done = random.Random(seed), 0  # noqa: S311
    process, address = robot(folder, world)
    try:
        left = list(stages)
        while left:
            child = training(folder, left[0], seed, address)
            try:
                wait = None if done == kills else 3 + chance.uniform(0, longest)
                code = child.wait(wait)
                if code:
                    break
                left.pop(0)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGKILL)
                child.wait()
                done += 1
                time.sleep(0.5)
    finally:
        process.terminate()
    report(folder, done, code)


def report(folder: Path, kills: int, code: int) -> None:
    """Say what was compared; an error if an action was lost or repeated."""
    did = Counter(row["what"] for row in JsonLines(folder / "robot.jsonl").rows())
    rows = read_log(folder / "run")
    said = Counter(row["what"] for row in rows if row["event"] == "action")
    ends = Counter(row["episode"] for row in rows if row["event"] == "episode")
    lost = sum(did.values()) - sum(said.values())
    asked = [row["asked"] for row in rows if row["event"] == "result"][-1]
    counted = sum(phase["motions"] + phase["tests"] for phase in asked.values())
    click.echo(
        f"{kills} kills, exit code {code}; the robot did {dict(did)}, the log has {dict(said)}, "
        f"the run counted {counted}; {lost} actions were in progress when it was killed"
    )
    if code or not 0 <= lost <= kills or max(ends.values()) > 1:
        raise click.ClickException("an action was lost or repeated, or the run did not end well")


if __name__ == "__main__":
    main()
