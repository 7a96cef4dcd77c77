"""Compare this library with random search and PGPE in locomotion, with equal steps for all.

    python tools/compare_locomotion.py FOLDER [--only Hopper-v5] [--method ours] [--seeds 0:5]

Ours is one `cgtorch-train --domain gymnasium:ENV_ID --target RETURN --seed N`, which ends with its
steps or with the target. The peers (`tools/locomotion/`) get the published settings of a linear
policy, and all steps. Each result is tried on 100 fresh episodes of the same environment, which do
not count. Install EvoTorch by `pip install -r tools/standard/peers.txt`. What FOLDER holds already
is not measured again.
"""

import importlib
import time
from dataclasses import dataclass
from math import inf
from pathlib import Path
from statistics import fmean, median
from typing import Any

import click
from locomotion.episodes import Trial
from measure_gymnasium import EPISODES, measured
from options.seeds import seeds_option

from cgtorch.ground.files import read_json, write_json

STEPS = {
    "InvertedDoublePendulum-v5": 150_000,
    "Reacher-v5": 1_000_000,
    "Swimmer-v5": 2_000_000,
    "Hopper-v5": 2_000_000,
    "HalfCheetah-v5": 2_000_000,
}
"""What a search may cost, without tests."""
OURS, PEERS = "ours", ("ars", "pgpe")


@dataclass(frozen=True)
class Row:
    """What one search has come to; the mean return is -inf if it has no result."""

    environment: str
    method: str
    seed: int
    mean_return: float
    steps: int
    seconds: float


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=click.Choice([*STEPS]), help="Of these only.")
@click.option("--method", multiple=True, type=click.Choice([OURS, *PEERS]), help="Of these only.")
@click.option("--steps", type=int, help="In place of what searches may cost.")
@seeds_option("0:5")
def command(
    folder: Path, only: tuple[str, ...], method: tuple[str, ...], steps: int | None, seeds: range
) -> None:
    """Measure what FOLDER does not hold, and print a table of all."""
    rows = []
    for name in only or STEPS:
        for seed in seeds:
            for how in method or (OURS, *PEERS):
                rows.append(row(folder, name, how, seed, steps or STEPS[name]))
                click.echo(rows[-1], err=True)
    click.echo(table(rows))


def row(folder: Path, environment: str, method: str, seed: int, steps: int) -> Row:
    """One search, or what the folder holds of it."""
    if method == OURS:
        found = measured(folder, "none", 10, 1000.0, steps, environment, seed)
        mean = -inf if found["mean_return"] is None else found["mean_return"]
        return Row(environment, OURS, seed, mean, found["steps"], found["seconds"])
    path = folder / f"{environment}-{seed}-{method}.json"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(path, searched(environment, method, seed, steps))
    kept = read_json(path)
    return Row(environment, method, seed, kept["mean_return"], kept["steps"], kept["seconds"])


def searched(environment: str, method: str, seed: int, steps: int) -> dict[str, Any]:
    """The result of a peer, and means of fresh episodes on its way."""
    began, trial = time.monotonic(), Trial(environment, seed, steps)
    policy = importlib.import_module(f"locomotion.{method}").search(trial)
    seconds = round(time.monotonic() - began, 1)
    return {
        "mean_return": fmean(trial.tested(policy, EPISODES)),
        "steps": trial.steps,
        "episodes": trial.episodes,
        "seconds": seconds,
        "curve": trial.curve,
    }


def table(rows: list[Row]) -> str:
    """The median, and all mean returns in the order of seeds, for each environment and method."""
    lines = ["| environment | method | median | seeds | steps |", "|" + "---|" * 5]
    for name, method in dict.fromkeys((each.environment, each.method) for each in rows):
        some = [each for each in rows if (each.environment, each.method) == (name, method)]
        means = [each.mean_return for each in some]
        spent = int(median(each.steps for each in some))
        seeds = ", ".join(f"{mean:,.1f}" for mean in means)
        lines.append(f"| {name} | {method} | {median(means):,.1f} | {seeds} | {spent:,} |")
    return "\n".join(lines)


if __name__ == "__main__":
    command()
