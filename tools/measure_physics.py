"""Every figure of docs/physics.md: grasps and skills, carried out in physics.

    python tools/measure_physics.py FOLDER [--only poses] [--seeds 0:3] [--count 1000] [--json]
                                    [--figure docs/figures/physics.json]

Poses are drawn as the labels of C are, until as many as asked for have a way of the arm; the robot
is told where the object is. Skills are those of trainings of S3 by one command each, tried on fresh
placements with the default noise. Other objects, the Fetch's poses and each edge of the table have
three tenths as many. FOLDER keeps runs and results; what is there is not made again. A core takes
about half an hour, and `physics`, whose skills are trained in physics, another half for each seed.
"""

import json
import subprocess
from collections.abc import Callable, Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import torch
from in_physics import poses, skills
from in_physics.tried import Rows, Sizes, Tried
from make_figures import code_hash, markdown
from options.seeds import seeds_option
from standard_tasks import machine

from cgtorch import native
from cgtorch.ground.distributed import cores
from cgtorch.ground.files import read_json, write_bytes, write_json

PARTS: dict[str, Callable[[Path, Sizes], Rows]] = {
    "poses": poses.accepted,
    "refused": poses.refused,
    "objects": poses.objects,
    "fetch-poses": poses.fetch,
    "kinematic": skills.kinematic,
    "physics": skills.physics,
    "fetch": skills.fetch,
}
DEPENDS = [
    *("cgtorch/graphs", "cgtorch/evolution", "cgtorch/improvement"),
    *("cgtorch/native", "cgtorch/simulation", "cgtorch/svm", "cgtorch/tabletop/data.py"),
    *("cgtorch/tabletop/kinematics", "cgtorch/tabletop/models", "cgtorch/tabletop/physics"),
    "cgtorch/tabletop/world",
]
"""Folders and files whose code the figure is of."""


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=click.Choice([*PARTS]), help="These parts only.")
@seeds_option("0:3")
@click.option("--count", default=1000, show_default=True, help="Poses, or placements.")
@click.option("--json", "as_json", is_flag=True, help="Print the figure as JSON, not as a table.")
@click.option("--figure", type=click.Path(path_type=Path), help="Write the figure to this file.")
def command(
    folder: Path,
    only: tuple[str, ...],
    seeds: range,
    count: int,
    as_json: bool,
    figure: Path | None,
) -> None:
    """Measure what FOLDER does not have yet, and print all that it has."""
    torch.set_num_threads(1)
    native.use_threads(cores())
    folder.mkdir(parents=True, exist_ok=True)
    sizes = Sizes(count, seeds)
    results = folder / "results.json"
    kept = read_json(results) if results.is_file() else {}
    for name in only or PARTS:
        for about, measured in PARTS[name](folder, sizes):
            if about not in kept:
                row = measured()
                click.echo(" | ".join(cells(row)), err=True)
                kept[about] = {"part": name, **asdict(row)}
                write_json(results, kept)
    whole = figure_of(in_order(kept.values()))
    text = json.dumps(whole, indent=1, ensure_ascii=False) + "\n"
    click.echo(text if as_json else markdown(whole, {}))
    if figure is not None:
        write_bytes(figure, text.encode())


def in_order(kept: Collection[dict[str, Any]]) -> list[Tried]:
    """The rows that are kept, part by part, each as it was measured."""
    names = list(PARTS)
    ordered = sorted(kept, key=lambda row: names.index(row["part"]))
    return [Tried(**{k: v for k, v in row.items() if k != "part"}) for row in ordered]


def figure_of(found: list[Tried]) -> dict[str, Any]:
    """A figure as `docs/figures` has it."""
    head = ["git", "rev-parse", "--short", "HEAD"]
    done = subprocess.run(
        head, capture_output=True, text=True, check=True, cwd=Path(__file__).parent
    )
    about = machine()
    return {
        "title": "Grasps and skills in physics",
        "command": "python tools/measure_physics.py FOLDER",
        "commit": done.stdout.strip(),
        "machine": f"{about['cores']} cores of {about['processor']}, shared with other work",
        "depends": DEPENDS,
        "code": code_hash(DEPENDS),
        "keys": 1,
        "columns": ["what was tried", "lifted", "strict", "asked"],
        "rows": [cells(row) for row in found],
    }


def cells(row: Tried) -> list[str]:
    """A row of the table."""
    return [row.about, *(f"{n:,} / {row.tried:,}" for n in (row.lifted, row.strict)), row.asked]


if __name__ == "__main__":
    command()
