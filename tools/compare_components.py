"""Show what each part of the search for rewards is worth, from searches without it.

    python tools/standard_tasks.py --library cgtorch --library "one lineage" ... --output RESULTS
    python tools/compare_components.py RESULTS [--figure docs/figures/components.json]

RESULTS is what `tools/standard_tasks.py` has kept of this library and its variants
(`tools/standard/components.py`). Of each task and variant the table says how many seeds have solved
the task, and the median of evaluations, in which a seed that has not solved it counts as more than
any other. p is that of Wilcoxon's signed-rank test of these against this library with all its
parts, seed by seed, over the seeds that both have tried.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TypeAlias

import click
from searches.statistics import signed_rank
from standard.measure import Result
from standard.peers import VARIANTS
from standard.tasks import TASKS

from cgtorch.ground.files import read_json, write_json

BASE = "cgtorch"
NONE = "–"
"""Of what was not tried, or solved by less than half of the seeds."""

Costs: TypeAlias = Mapping[int, float]
"""Evaluations until solved by seed, inf where it was not."""


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.argument("results", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--figure", type=click.Path(path_type=Path), help="Whose table is replaced.")
def command(results: Path, figure: Path | None) -> None:
    """Print the table, and write it into the figure."""
    columns, rows = table([Result(**each) for each in read_json(results)["results"]])
    for line in [columns, ["---"] * len(columns), *rows]:
        click.echo(f"| {' | '.join(line)} |")
    if figure:
        write_json(figure, read_json(figure) | {"columns": columns, "rows": rows})


def table(results: Sequence[Result]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows: a column for each task that a variant has tried, a row for each variant.

    The first row is that of the library with all its parts.
    """
    costs: dict[tuple[str, str], dict[int, float]] = {}
    for each in results:
        found = float(each.evaluations) if each.solved else math.inf
        costs.setdefault((each.task, each.library), {})[each.seed] = found
    tried = {library for _, library in costs}
    varied = {task for task, library in costs if library != BASE}
    tasks = [name for name in TASKS if name in varied and (name, BASE) in costs]
    rows = [
        [name, *(_cell(costs.get((task, name), {}), costs[task, BASE]) for task in tasks)]
        for name in (BASE, *VARIANTS)
        if name in tried
    ]
    return ["search", *(TASKS[task].title for task in tasks)], rows


def _cell(costs: Costs, base: Costs) -> str:
    """Solved, the median, and p if it is not our own row."""
    if not costs:
        return NONE
    solved = sum(map(math.isfinite, costs.values()))
    middle = median(costs.values())
    shown = f"{middle:,.0f}" if math.isfinite(middle) else NONE
    said = f"{solved} of {len(costs)}, {shown}"
    if costs is base:
        return said
    worse = [_difference(costs[seed], base[seed]) for seed in costs.keys() & base.keys()]
    return f"{said}, p {signed_rank(worse):.2g}"


def _difference(cost: float, base: float) -> float:
    """How much more it costs; 0 where both have failed."""
    return 0.0 if cost == base else cost - base


if __name__ == "__main__":
    command()
