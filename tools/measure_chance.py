"""Train skills where returns are chance, beside rules that are hard to beat.

    python tools/measure_chance.py FOLDER [--only pig:Pig] [--seeds 0:5] [--minutes 3]

Each world and seed is one `cgtorch-train --domain chance.FILE:CLASS`, with `--models none` and a
limit of `--minutes`. Its last skill then plays `--count` fresh episodes, and so do all rules
of the domain; the best of these stands beside it. What is printed is compared with the mean that
the training itself has told. FOLDER keeps the runs; a run that it already holds is not made again.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import click
import torch
from chance.blackjack import Paid, Signed
from chance.game import GameDomain, Rule
from chance.inventory import Store
from chance.pig import Pig
from chance.queues import Servers
from options.seeds import seeds_option
from torch import Generator, Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.files import read_json, write_bytes, write_json
from cgtorch.runs.chosen import chosen_skill
from cgtorch.runs.log import read_log
from cgtorch.simulation import rollout

DOMAINS: dict[str, type[GameDomain]] = {
    "blackjack:Paid": Paid,
    "blackjack:Signed": Signed,
    "pig:Pig": Pig,
    "inventory:Store": Store,
    "queues:Servers": Servers,
}
TOOLS = str(Path(__file__).parent)
CHUNK, FRESH = 10_000, 77
STEPS = 2000
"""More steps than any episode has."""

Play = Callable[[Any], Tensor]
"""Maps a world of B episodes to their returns (B,)."""


@dataclass(frozen=True)
class Mean:
    """A mean return, and its standard error."""

    value: float
    error: float


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=click.Choice([*DOMAINS]), help="Of these only.")
@seeds_option("0:5")
@click.option("--minutes", default=3.0, show_default=True, help="The limit of a training.")
@click.option("--count", default=100_000, show_default=True, help="Fresh episodes of each.")
@click.option("--jobs", default=1, show_default=True, help="Runs side by side.")
def command(
    folder: Path, only: tuple[str, ...], seeds: range, minutes: float, count: int, jobs: int
) -> None:
    """Train skills where returns are chance, beside rules that are hard to beat."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    names = only or tuple(DOMAINS)
    work = [(name, seed) for name in names for seed in seeds]
    with ThreadPoolExecutor(jobs) as pool:
        found = list(pool.map(lambda job: measured(folder, *job, minutes, count), work))
    rules = {name: best_rule(DOMAINS[name](), count) for name in names}
    text = table(found, rules)
    write_bytes(folder / "table.md", text.encode())
    click.echo(text)


def measured(folder: Path, name: str, seed: int, minutes: float, count: int) -> dict[str, Any]:
    """One run, which is trained if it is not there, and the mean of its last skill."""
    file, _, kind = name.partition(":")
    run = folder / f"{file}-{kind}-{seed}"
    kept = run.with_suffix(".json")
    if kept.is_file():
        known: dict[str, Any] = read_json(kept)
        return known
    program = [str(Path(sys.executable).parent / "cgtorch-train"), "--models", "none", "--quiet"]
    where = ["--domain", f"chance.{name}", "--run-dir", run]
    how = ["--seed", str(seed), "--minutes", f"{minutes:g}"]
    path = {"PYTHONPATH": os.pathsep.join([TOOLS, os.environ.get("PYTHONPATH", "")])}
    subprocess.run([*program, *where, *how], check=False, env=os.environ | path)
    skill = chosen_skill(run, None, (), None, f"chance.{name}").skill
    mean = played(DOMAINS[name](), by_skill(skill), count)
    told = [row["mean_return"] for row in read_log(run) if row["event"] == "tested"]
    about = {"domain": name, "seed": seed, "mean": mean.value, "error": mean.error}
    result = {**about, "told": told[-1] if told else None}
    write_json(kept, result)
    click.echo(f"{name} seed {seed}: {mean.value:.4f} ± {mean.error:.4f}")
    return result


def played(domain: GameDomain, play: Play, count: int) -> Mean:
    """The mean return of `count` fresh episodes, which are the same for all that play."""
    generator = Generator().manual_seed(FRESH)
    with torch.no_grad():
        parts = [
            play(domain.world(domain.draw("any", min(CHUNK, count - begin), generator))).double()
            for begin in range(0, count, CHUNK)
        ]
    every = torch.cat(parts)
    return Mean(float(every.mean()), float(every.std() / count**0.5))


def by_skill(skill: Skill) -> Play:
    """What plays a skill; an episode that it leaves early has what was gained until then."""

    def play(world: Any) -> Tensor:
        found = rollout(skill.graph, skill.actions, world, max_transitions=skill.max_transitions)
        assert found.returns is not None  # noqa: S101  a game gives rewards
        return found.returns[0]

    return play


def by_rule(rule: Rule) -> Play:
    """What plays a rule."""

    def play(world: Any) -> Tensor:
        lanes = start_lanes(world, torch.arange(world.num_scenarios), 0, 0)
        for _ in range(STEPS):
            if bool(world.over(lanes).all()):
                break
            lanes, _ = world.step(lanes, rule(lanes.percept))
        returns: Tensor = world.returns(lanes)
        return returns

    return play


def best_rule(domain: GameDomain, count: int) -> tuple[str, Mean]:
    """The name and the mean of the best of the domain's rules, on the episodes of `played`."""
    means = {name: played(domain, by_rule(rule), count) for name, rule in domain.rules().items()}
    return max(means.items(), key=lambda each: each[1].value)


def table(found: list[dict[str, Any]], rules: dict[str, tuple[str, Mean]]) -> str:
    """Markdown: a line for each domain, with medians over seeds."""
    lines = [
        "| world | best rule | its mean | median of skills | at least as good | most told beyond |",
        "|---|---|---|---|---|---|",
    ]
    for name, (rule, mean) in rules.items():
        rows = [row for row in found if row["domain"] == name]
        good = sum(row["mean"] >= mean.value - 2 * mean.error for row in rows)
        beyond = [abs(row["told"] - row["mean"]) for row in rows if row["told"] is not None]
        cells = (
            f"{name} | {rule} | {mean.value:.4f} ± {mean.error:.4f} | "
            f"{median(row['mean'] for row in rows):.4f} | {good} of {len(rows)} | "
            f"{max(beyond, default=float('nan')):.4f}"
        )
        lines.append(f"| {cells} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    command()
