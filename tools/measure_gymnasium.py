"""Train skills for Gymnasium environments by one command each, and try them on fresh episodes.

    python tools/measure_gymnasium.py FOLDER [--only CartPole-v1] [--seeds 0:5] [--rounds 10]
    python tools/measure_gymnasium.py FOLDER --models learned --seeds 0:10

Each environment and seed is one `cgtorch-train --domain gymnasium:ENV_ID --seed N --rounds 10`, and
then `cgtorch-evaluate --count 100 --seed 1000` of its last skill. An environment is solved if the
mean return of these 100 fresh episodes is at least the target in `TASKS`, or Gymnasium's own
threshold. Episodes and world steps are counted where Gymnasium plays them, in the training with all
its tests, but not in the 100 episodes. With `--models learned`, the environments are those of
`LEARNED`, and the steps of interaction are those that search and models asked the world for, tests
not included. What FOLDER holds already is not measured again; with more
rounds, its runs that have not reached their goals are gone on with.
"""

import json
import multiprocessing
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

import click
from options.seeds import seeds_option

from cgtorch.commands.train import command as train
from cgtorch.domains.gymnasium_episodes import Episode
from cgtorch.domains.gymnasium_world import VectorSteps
from cgtorch.ground.asked import BudgetSpentError, Purse
from cgtorch.ground.files import read_json, write_json
from cgtorch.runs.log import read_log
from cgtorch.training import auto

TASKS: dict[str, list[str]] = {
    "CartPole-v1": [],
    "Acrobot-v1": [],
    "MountainCarContinuous-v0": [],
    "Pendulum-v1": ["--target", "-200", "--attempts", "1"],
    "LunarLander-v3": ["--attempts", "1"],
    "InvertedDoublePendulum-v5": ["--target", "9000"],
    "Swimmer-v5": ["--target", "300"],
    "Reacher-v5": ["--target", "-6"],
    "Hopper-v5": ["--target", "2800"],
    "HalfCheetah-v5": ["--target", "3300"],
}
LEARNED: dict[str, list[str]] = {
    "MountainCarContinuous-v0": [],
    "Pendulum-v1": ["--target", "-200"],
    "examples.swing_up:CartPoleSwingUp-v0": ["--reward", "examples.swing_up:gained"],
}
OPTIONS = {"none": TASKS, "learned": LEARNED}
EPISODES, FRESH_SEED = 100, 1000
COSTS = "interaction", "episodes", "steps", "cpu_seconds"
NAMES = "environment", "seed", "mean_return", "solved", "rounds", *COSTS, "seconds"


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--models", default="none", type=click.Choice([*OPTIONS]), help="Of cgtorch-train.")
@click.option("--only", multiple=True, type=click.Choice([*TASKS | LEARNED]), help="Of these only.")
@seeds_option("0:5")
@click.option("--rounds", default=10, show_default=True, help="The most rounds of a run.")
@click.option("--minutes", default=1000.0, show_default=True, help="The most minutes of a run.")
@click.option("--steps", type=int, help="The most world steps of a run, without its final test.")
@click.option("--jobs", default=1, show_default=True, help="Runs side by side.")
def command(
    folder: Path,
    models: str,
    only: tuple[str, ...],
    seeds: range,
    rounds: int,
    minutes: float,
    steps: int | None,
    jobs: int,
) -> None:
    """Train skills for Gymnasium environments and try them on fresh episodes."""
    if others := set(only) - set(OPTIONS[models]):
        raise click.UsageError(f"{', '.join(sorted(others))} is not among those of {models} models")
    work = [(environment, seed) for environment in only or OPTIONS[models] for seed in seeds]
    # One process for each run: the counters and the CPU seconds are its own.
    pool = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), max_tasks_per_child=1
    )
    with pool:
        results = list(
            pool.map(
                partial(measured, folder, models, rounds, minutes, steps), *zip(*work, strict=True)
            )
        )
    write_json(folder / "results.json", results)
    click.echo(table(results))
    click.echo(summary(results))


def measured(
    folder: Path,
    models: str,
    rounds: int,
    minutes: float,
    steps: int | None,
    environment: str,
    seed: int,
) -> dict[str, Any]:
    """One environment and seed; a run that has made fewer rounds before is gone on with."""
    run = folder / f"{environment.rpartition(':')[2]}-{seed}"
    kept = run / "measured.json"
    if not kept.is_file():  # what it has cost so far is not known
        shutil.rmtree(run, ignore_errors=True)
    before = read_json(kept) if kept.is_file() else {}
    left = None if steps is None else steps - before.get("steps", 0)
    if not _ended(run, rounds) and (left is None or left > 0):
        known = run.is_dir()
        limits = ["--rounds", str(rounds), "--minutes", str(minutes)]
        about = [*limits, "--processes", "1", "--quiet"]  # in which steps are counted
        new = ["--domain", f"gymnasium:{environment}", "--seed", str(seed), "--models", models]
        new += OPTIONS[models][environment]
        words = [*about, "--resume", str(run)] if known else [*new, *about, "--run-dir", str(run)]
        counts = counted(partial(train, words, standalone_mode=False), left)
        total = {name: before.get(name, 0) + value for name, value in counts.items()}
        write_json(kept, {**total, **_tried(run)})
    wanted = read_json(run / "gymnasium.json")["target_return"]
    found = read_json(kept)
    solved = found["mean_return"] is not None and found["mean_return"] >= wanted
    results = _ends(run, "result")
    asked = results[-1]["asked"].values() if results else []
    origin = {"environment": environment, "seed": seed, "wanted": wanted, "rounds": len(results)}
    origin["interaction"] = sum(each["motions"] for each in asked)
    return {**origin, "solved": solved, **found}


def _ended(run: Path, rounds: int) -> bool:
    """Whether a run has reached its goal, or has made so many rounds."""
    ended = _ends(run, "ended")
    return bool(ended) and (ended[-1]["reached"] or len(_ends(run, "result")) >= rounds)


def _ends(run: Path, event: str) -> list[dict[str, Any]]:
    """The rows of the run's log of one kind."""
    return [row for row in read_log(run) if row["event"] == event]


def counted(training: Callable[[], Any], most: int | None = None) -> dict[str, float]:
    """The cost of a training in this process: finished episodes, steps, and CPU seconds.

    With the last of its `most` steps the time of the training is over, and only its test is left.
    """
    counts = Counts(inf if most is None else most)
    plain_play, plain_step, plain_late = Episode.play, VectorSteps.step, Purse.late
    plain_act = auto.act

    def play(episode: Episode, *action: Any) -> Any:
        found = plain_play(episode, *action)
        counts.add(1, int(found[2]))
        return found

    def step(vector: VectorSteps, state: Any, *others: Any) -> Any:
        found = plain_step(vector, state, *others)
        counts.add(len(state), int(found[3].sum()))
        return found

    def late(purse: Purse, grace: float = 0.0) -> bool:
        limited = purse.until < inf  # as that of a training is
        return (limited and counts.over) or plain_late(purse, grace)

    def act(*about: Any) -> Any:
        counts.testing = True
        try:
            return plain_act(*about)
        finally:
            counts.testing = False

    Episode.play, VectorSteps.step = play, step  # type: ignore[method-assign]
    Purse.late = late  # type: ignore[method-assign]
    auto.act = act
    began = time.monotonic()
    try:
        training()
    finally:
        Episode.play, VectorSteps.step = plain_play, plain_step  # type: ignore[method-assign]
        Purse.late = plain_late  # type: ignore[method-assign]
        auto.act = plain_act
    used = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "episodes": counts.episodes,
        "steps": counts.steps,
        "cpu_seconds": round(used.ru_utime + used.ru_stime, 1),
        "seconds": round(time.monotonic() - began, 1),
    }


@dataclass
class Counts:
    """Steps, and episodes that ended with one of them, until there were as many as allowed."""

    most: float = inf
    steps: int = 0
    episodes: int = 0
    over: bool = False
    testing: bool = False

    def add(self, steps: int, episodes: int) -> None:
        """Count some more; nothing is counted after the last one, with which a search ends.

        BudgetSpentError with that one, unless a test is going on.
        """
        if self.over:
            return
        self.steps += steps
        self.episodes += episodes
        if self.steps >= self.most:
            self.over = True
            if self.testing:
                return
            raise BudgetSpentError(f"all {self.most} steps have been made")


def _tried(run: Path) -> dict[str, Any]:
    """The result of the last skill on fresh episodes."""
    program = str(Path(sys.executable).with_name("cgtorch-evaluate"))
    test = ["--count", str(EPISODES), "--seed", str(FRESH_SEED), "--json"]
    words = [program, str(run), *test]
    output = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    found = json.loads(output)
    return {name: found[name] for name in ("mean_return", "succeeded", "tried")}


def table(results: list[dict[str, Any]]) -> str:
    """A row for each run, as Markdown."""
    lines = ["| " + " | ".join(NAMES) + " |", "|" + "---|" * len(NAMES)]
    for found in results:
        values = [found[name] for name in NAMES]
        lines.append("| " + " | ".join(map(_plain, values)) + " |")
    return "\n".join(lines)


def summary(results: list[dict[str, Any]]) -> str:
    """A row for each environment: how many seeds have solved it, and medians."""
    lines = ["", "| environment | solved | mean return | " + " | ".join(COSTS) + " |"]
    lines.append("|" + "---|" * (3 + len(COSTS)))
    for name in dict.fromkeys(found["environment"] for found in results):
        rows = [found for found in results if found["environment"] == name]
        solved = f"{sum(found['solved'] for found in rows)} of {len(rows)}"
        keys = "mean_return", *COSTS
        middle = [_plain(_median([found[key] for found in rows])) for key in keys]
        lines.append("| " + " | ".join([name, solved, *middle]) + " |")
    return "\n".join(lines)


def _median(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if len(known) == len(values) else None


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.1f}" if abs(value) < 1000 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


if __name__ == "__main__":
    command()
