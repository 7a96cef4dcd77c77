"""Train skills for Gymnasium environments by one command each, and try them on fresh episodes.

    python tools/measure_gymnasium.py FOLDER [--only CartPole-v1] [--seeds 0:5] [--json FILE]

Each environment and seed is one `cgtorch-train --domain gymnasium:ENV_ID --seed N`, and then
`cgtorch-evaluate --count 100 --seed 1000` of its last skill. An environment is solved if the mean
return of these 100 fresh episodes is at least Gymnasium's own threshold (Pendulum has none: -200).
Episodes and world steps are those that the search has executed, tests of its skills not among them.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click

from cgtorch.ground.files import read_json, write_json

TASKS: dict[str, list[str]] = {
    "CartPole-v1": [],
    "Acrobot-v1": [],
    "MountainCarContinuous-v0": [],
    "Pendulum-v1": ["--target", "-200"],
    "LunarLander-v3": [],
}
EPISODES, FRESH_SEED = 100, 1000
HEADER = ("environment", "seed", "mean return", "solved from", "solved", "rounds", "CPU s")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=click.Choice([*TASKS]), help="Of these only.")
@click.option("--seeds", default="0:5", show_default=True, help="First, and one past the last.")
@click.option("--minutes", default=10.0, show_default=True, help="Begin no round after so many.")
@click.option("--json", "output", type=click.Path(path_type=Path), help="Write results here, too.")
def command(
    folder: Path, only: tuple[str, ...], seeds: str, minutes: float, output: Path | None
) -> None:
    """Train skills for Gymnasium environments and try them on fresh episodes."""
    first, last = map(int, seeds.split(":"))
    click.echo("  ".join(HEADER))
    results = []
    for environment in only or TASKS:
        for seed in range(first, last):
            found = measured(folder / f"{environment}-{seed}", environment, seed, minutes)
            results.append(found)
            click.echo("  ".join(str(found[name]) for name in HEADER))
            if output is not None:
                write_json(output, results)


def measured(run: Path, environment: str, seed: int, minutes: float) -> dict[str, Any]:
    """One environment and seed; a run that is there already is tried only."""
    domain = ["--domain", f"gymnasium:{environment}"]
    began = time.monotonic()
    spent = 0.0
    if not (run / "measured.json").is_file():
        about = ["--seed", str(seed), "--minutes", str(minutes), "--run-dir", str(run), "--quiet"]
        spent = _cpu_seconds(["cgtorch-train", *domain, *about, *TASKS[environment]])
        write_json(run / "measured.json", {"cpu": spent, "seconds": time.monotonic() - began})
    kept = read_json(run / "measured.json")
    about = read_json(run / "gymnasium.json")
    summary, mean = {"stages": []}, None
    if (run / "summary.json").is_file():  # else no skill has solved any episode
        summary = read_json(run / "summary.json")
        mean = json.loads(_output(["cgtorch-evaluate", str(run), *_test()]))["mean_return"]
    return {
        "environment": environment,
        "seed": seed,
        "mean return": None if mean is None else round(mean, 1),
        "solved from": about["target_return"],
        "solved": mean is not None and mean >= about["target_return"],
        "rounds": len(summary["stages"]),
        "generations": sum(stage["generations"] for stage in summary["stages"]),
        "CPU s": round(kept["cpu"], 1),
        "seconds": round(kept["seconds"], 1),
    }


def _test() -> list[str]:
    return ["--count", str(EPISODES), "--seed", str(FRESH_SEED), "--json"]


def _program(words: list[str]) -> list[str]:
    return [str(Path(sys.executable).with_name(words[0])), *words[1:]]


def _output(words: list[str]) -> str:
    return subprocess.run(_program(words), check=True, capture_output=True, text=True).stdout


def _cpu_seconds(words: list[str]) -> float:
    """CPU seconds of a command that ends well, or only fails to reach its goal."""
    import resource

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(_program(words), check=False, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode and "found no skill" not in done.stderr:
        raise click.ClickException(done.stderr)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == "__main__":
    command()
