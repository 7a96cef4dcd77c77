"""What a skill costs a robot: success over world actions, in a world that never repeats itself.

    python tools/measure_robot_time.py FOLDER [--seeds 0:10] [--stages] [--world mujoco] ...

For each seed a run is trained as by `cgtorch-train --stage auto --noise fresh` (or by its stages),
and every skill that acted in the world is tried on fresh placements, which costs it nothing.
FOLDER keeps a run and a JSON file per seed; what is there is not made again. The table is
FOLDER/table.md, and the curve FOLDER/robot-time.svg.
"""

import json
import shutil
import statistics
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click
import torch
from options.seeds import seeds_option

from cgtorch.domains.exploration import EXPLORATION
from cgtorch.ground.asked import Purse
from cgtorch.ground.files import read_json, write_json
from cgtorch.improvement.events import Event, Practised, WorldAsked
from cgtorch.runs.settings import Goal, RunSettings, defaults_of
from cgtorch.runs.stored_run import StoredRun, planned_run, write_run
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.evaluate import evaluate_skill
from cgtorch.training.start import spent_of
from cgtorch.training.train import train

FRESH_SEED = 9_000_001  # of the placements that skills are measured on
PAPER = 0.85
WORSE = 0.02  # share of placements by which a skill is called worse than the one before


@dataclass
class Course:
    """A watch that tries every skill that has acted, and notes what had been asked before."""

    run: StoredRun
    purse: Purse
    kind: str
    placements: int
    asked: int = 0
    measuring: float = 0.0
    points: list[tuple[int, float]] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        """Take note of an event."""
        if isinstance(event, WorldAsked) and event.phase == EXPLORATION:
            self.asked = self.purse.total.actions
        if not isinstance(event, Practised):
            return
        began = time.process_time()
        share = self.share_of(event.skill)
        if not self.points or self.points[-1][1] != share:
            self.points.append((self.asked, share))
        self.asked = self.purse.total.actions
        self.measuring += time.process_time() - began

    def share_of(self, skill: Any) -> float:
        """The share of fresh placements that a skill solves."""
        seed = FRESH_SEED + self.run.settings.seed
        score = evaluate_skill(skill, self.run.domain, self.kind, self.placements, seed)
        return score.successes / score.tried


def measured(folder: Path, settings: RunSettings, own: TabletopSettings, placements: int,
             stages: bool) -> dict[str, Any]:  # fmt: skip
    """Train one run, and what it cost."""
    run = planned_run(folder, settings, own)
    write_run(run)
    purse = Purse()
    course = Course(run, purse, run.kind, placements)
    training = Training(run, course, lambda message: nullcontext(), purse=purse)
    began = time.process_time()
    if stages:
        train(training, list(run.domain.stages)[-1])
    else:
        train_until(training, Goal(minutes=1e6, rounds=1))
    seconds = time.process_time() - began - course.measuring
    total = purse.total
    return {
        "seed": settings.seed,
        "success": course.points[-1][1],
        "motions": total.motions,
        "tests": total.tests,
        "looks": total.looks,
        "episodes": total.episodes,
        "phases": spent_of(purse),
        "seconds": round(seconds, 1),
        "course": course.points,
    }


def passed(row: dict[str, Any], share: float) -> float:
    """The number of world actions after which a run's skill first had this share."""
    return next((asked for asked, found in row["course"] if found >= share), float("inf"))


def worse(rows: Sequence[dict[str, Any]]) -> tuple[int, int]:
    """The number of skills that were replaced by a worse one, and of all that were replaced."""
    pairs = [
        (one[1], two[1])
        for row in rows
        for one, two in zip(row["course"], row["course"][1:], strict=False)
    ]
    return sum(two < one - WORSE for one, two in pairs), len(pairs)


def table_of(rows: Sequence[dict[str, Any]]) -> str:
    """The figures of all seeds, as Markdown."""
    actions = [row["motions"] + row["tests"] for row in rows]
    success = [row["success"] for row in rows]
    count, of = worse(rows)
    first = [passed(row, PAPER) for row in rows]
    lines = [
        ("success, median (least)", f"{100 * statistics.median(success):.1f} % "
         f"({100 * min(success):.1f})"),
        ("world actions, median (most)", f"{statistics.median(actions):.0f} ({max(actions)})"),
        ("of these motions and tests", f"{statistics.median(r['motions'] for r in rows):.0f} and "
         f"{statistics.median(r['tests'] for r in rows):.0f}"),
        ("scenes looked at", f"{statistics.median(r['looks'] for r in rows):.0f}"),
        ("world actions until 85 % (most)", f"{statistics.median(first):.0f} ({max(first):.0f})"),
        ("skills replaced by a worse one", f"{count} of {of}"),
        ("CPU seconds, median", f"{statistics.median(r['seconds'] for r in rows):.1f}"),
    ]  # fmt: skip
    return "\n".join(["| | |", "| --- | --- |", *(f"| {a} | {b} |" for a, b in lines)]) + "\n"


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """The course of all seeds: success over world actions."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot()
    end = max(row["motions"] + row["tests"] for row in rows)
    for row in rows:
        x, y = zip(*row["course"], (end, row["course"][-1][1]), strict=True)
        axes.step(x, [100 * share for share in y], where="post", color="tab:blue", alpha=0.35)
    grid = sorted({asked for row in rows for asked, _ in row["course"]} | {end})
    middle = [
        100 * statistics.median(
            max([0.0, *[s for a, s in row["course"] if a <= asked][-1:]]) for row in rows
        )
        for asked in grid
    ]  # fmt: skip
    axes.step(grid, middle, where="post", color="tab:blue", linewidth=2, label="median of seeds")
    axes.axhline(100 * PAPER, color="tab:gray", linestyle="--", label="the paper, 34 of 40")
    axes.set(xlabel="motions and grasps asked of the robot", ylabel="fresh placements reached, %")
    axes.set_xlim(0, end)
    axes.set_ylim(0, 101)
    axes.legend(loc="lower right")
    figure.savefig(path)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@seeds_option("0:10")
@click.option("--stages", is_flag=True, help="S0 to S3 in place of the perimeter at once.")
@click.option("--world", default="kinematic", show_default=True)
@click.option("--robot", default="pr2", show_default=True)
@click.option("--scenarios", default="perimeter", show_default=True)
@click.option("--position-noise", default=0.005, show_default=True, help="m")
@click.option("--noise", default="fresh", show_default=True)
@click.option("--placements", default=1000, show_default=True)
def main(folder: Path, seeds: Sequence[int], stages: bool, world: str, robot: str, scenarios: str,
         position_noise: float, noise: str, placements: int) -> None:  # fmt: skip
    """Train on all seeds, and write the table and the curve."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    own = replace(
        TabletopSettings(), world=world, robot=robot, position_noise=position_noise, noise=noise
    )
    values = defaults_of(TabletopSettings) | {"scenarios": scenarios}
    rows = []
    for seed in seeds:
        path = folder / f"seed-{seed}.json"
        if not path.is_file():
            settings = RunSettings(**{**values, "seed": seed})
            shutil.rmtree(folder / f"seed-{seed}", ignore_errors=True)  # which was interrupted
            row = measured(folder / f"seed-{seed}", settings, own, placements, stages)
            write_json(path, row)
        rows.append(read_json(path))
        click.echo(json.dumps({k: v for k, v in rows[-1].items() if k != "phases"}))
    (folder / "table.md").write_text(table_of(rows))
    draw(rows, folder / "robot-time.svg")
    click.echo(table_of(rows))


if __name__ == "__main__":
    main()
