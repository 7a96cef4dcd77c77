"""Train over many seeds and try the skills on fresh scenarios: the results that the docs quote.

    python tools/measure_skills.py FOLDER [--seeds 0:5] [--kinds ...] [--jobs 2] [--count 1000]

FOLDER keeps every run and, beside it, a JSON file with what its last skill did; what is there is
not made again. The table, FOLDER/table.md, is made from all files. With `--jobs 1` the seconds are
those of a command that has the machine to itself.
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from typing import Any

import click
import torch
from options.seeds import seeds_option

from cgtorch.graphs import Skill
from cgtorch.ground.files import read_json, write_bytes, write_json
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.log import read_log
from cgtorch.training.evaluate import evaluate_skill

KINDS: dict[str, tuple[list[str], list[str]]] = {
    "stages": (["--stage", "S3"], ["perimeter", "near", "left", "right", "far"]),
    "auto": (
        ["--stage", "auto", "--target", "0.995"],
        ["perimeter", "near", "left", "right", "far"],
    ),
    "general": (["--stage", "auto", "--scenarios", "general"], ["general"]),
    "clutter": (
        ["--stage", "auto", "--scenarios", "general-clutter"],
        ["general-clutter"],
    ),
}
"""Options of `cgtorch-train`, and what the skill is tried on."""

FRESH_SEED = 11_000_001
"""The seed of the fresh scenarios, far from the seeds of runs."""


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@seeds_option("0:5")
@click.option("--kinds", multiple=True, type=click.Choice(list(KINDS)), default=list(KINDS))
@click.option("--jobs", default=2, show_default=True, help="Runs side by side.")
@click.option("--count", default=1000, show_default=True, help="Fresh scenarios of each sort.")
@click.option("--options", default="", help="Further options of every run, in one string.")
def command(
    folder: Path, seeds: range, kinds: Sequence[str], jobs: int, count: int, options: str
) -> None:
    """Train over many seeds and try the skills on fresh scenarios."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(kind, seed) for kind in kinds for seed in seeds]
    with ThreadPoolExecutor(jobs) as pool:
        for kind, seed, result in pool.map(
            lambda job: (*job, measured(folder, *job, count, options.split())), todo
        ):
            rates = ", ".join(f"{name} {n}" for name, n in result["succeeded"].items())
            click.echo(f"{kind} {seed}: {rates} of {result['tried']}, {result['seconds']:.0f} s")
    text = table([read_json(path) for path in sorted(folder.glob("*.json"))])
    write_bytes(folder / "table.md", text.encode())
    click.echo(text)


def measured(
    folder: Path, kind: str, seed: int, count: int, options: Sequence[str]
) -> dict[str, Any]:
    """Train one seed, if that is still to be done, and try its last skill."""
    path, run_folder = folder / f"{kind}-{seed}.json", folder / f"{kind}-{seed}"
    if path.is_file():
        result: dict[str, Any] = read_json(path)
        return result
    arguments, placements = KINDS[kind]
    program = [str(Path(sys.executable).parent / "cgtorch-train"), *arguments, *options]
    began = time.perf_counter()
    subprocess.run([*program, "--seed", str(seed), "--run-dir", run_folder, "--quiet"], check=True)
    seconds = time.perf_counter() - began
    run, skill = last_skill(run_folder)
    scores = [
        evaluate_skill(skill, run.domain, name, count, FRESH_SEED + seed) for name in placements
    ]
    stages, log = run.results, read_log(run_folder)
    result = {
        "kind": kind,
        "seed": seed,
        "tried": count,
        "succeeded": {n: s.successes for n, s in zip(placements, scores, strict=True)},
        "seconds": round(seconds, 1),
        "improving": round(sum(stage["seconds"] for stage in stages), 1),
        "searching": round(sum(stage["search_seconds"] for stage in stages), 3),
        "rounds": len(stages),
        "generations": sum(stage["generations"] for stage in stages),
        "transitions": sum(stage["transitions"] for stage in stages),
        "w_lost": sum(row["w_lost"] for row in log if row["event"] == "accepted"),
        "nodes": skill.num_nodes,
        "largest": largest(skill),
    }
    write_json(path, result)
    return result


def largest(skill: Skill) -> int:
    """The most nodes of a sub-skill, at whatever level; 0 if there is none."""
    return max((max(s.num_nodes, largest(s)) for s in skill.sub_skills.values()), default=0)


def table(results: list[dict[str, Any]]) -> str:
    """Markdown: a line for each kind of run and of scenarios, over all seeds."""
    lines = [
        "| run | tried on | median | least | seeds | seconds, of search at most | W lost | "
        "nodes, of a sub-skill |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, (arguments, placements) in KINDS.items():
        mine = [r for r in results if r["kind"] == kind]
        for name in placements if mine else ():
            rates = [r["succeeded"][name] / r["tried"] for r in mine]
            cells = [
                f"`{' '.join(arguments)}`",
                name,
                f"{median(rates):.1%}",
                f"{min(rates):.1%}",
                str(len(mine)),
                f"{median(r['seconds'] for r in mine):.0f}, "
                f"{max(r['searching'] for r in mine):.0f}",
                str(sum(r["w_lost"] for r in mine)),
                f"{max(r['nodes'] for r in mine)}, {max(r['largest'] for r in mine)}",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    command()
