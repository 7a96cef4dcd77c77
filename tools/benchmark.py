"""Measure what cgtorch promises: one table, or with --json one object with all details.

    python tools/benchmark.py [--quick] [--json] [--only NAME ...] [--device cuda]

Every line checks that both sides give the same results, then times them in turns in this one
process. A new line is a function `Effort -> Line` in `benchmarks/`, entered in `LINES`.
"""

import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import click
from benchmarks.cold_start import cold_start
from benchmarks.gamma import gamma_ceiling
from benchmarks.gating import gating_gradient
from benchmarks.generation import overhead_share
from benchmarks.grasps import grasp_way
from benchmarks.grid import (
    svc_grid_search,
    svc_grid_search_large,
    svr_grid_search,
    svr_grid_search_large,
)
from benchmarks.growth import growth_10x, padding
from benchmarks.gymnasium_steps import gymnasium_steps
from benchmarks.inference import inference_ceiling, inference_vs_sklearn
from benchmarks.measure import FULL, QUICK, Effort, Line, cores
from benchmarks.million import memory_of_a_million
from benchmarks.on_gpu import GENERATIONS, gpu_generation, gpu_rollouts
from benchmarks.operators import operators_vs_networkx
from benchmarks.own import own_action, own_action_unused, own_world
from benchmarks.own_models import own_models
from benchmarks.rollouts import paper_way, strong_cpu, tensor_way
from benchmarks.touching import touching
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cgtorch.ground.errors import CgtorchError

LINES: dict[str, Callable[[Effort], Line]] = {
    "inference_vs_sklearn": inference_vs_sklearn,
    "inference_ceiling": inference_ceiling,
    "svc_grid_search": svc_grid_search,
    "svr_grid_search": svr_grid_search,
    "svc_grid_search_large": svc_grid_search_large,
    "svr_grid_search_large": svr_grid_search_large,
    "paper_way": paper_way,
    "strong_cpu": strong_cpu,
    "tensor_way": tensor_way,
    "operators_vs_networkx": operators_vs_networkx,
    "gamma_ceiling": gamma_ceiling,
    "overhead_share": overhead_share,
    "growth_10x": growth_10x,
    "padding": padding,
    "own_action_unused": own_action_unused,
    "own_action": own_action,
    "own_world": own_world,
    "own_models": own_models,
    "gymnasium_steps": gymnasium_steps,
    "gating_gradient": gating_gradient,
    "touching": touching,
    "grasp_way": grasp_way,
    "cold_start": cold_start,
    "memory_of_a_million": memory_of_a_million,
}

ON_GPU: dict[str, Callable[[Effort], Line]] = {
    "gpu_rollouts": gpu_rollouts,
    **{f"gpu_generation_{size}": partial(gpu_generation, size) for size in GENERATIONS},
}
"""The lines of --device cuda: a GPU beside the cores of its machine."""

LONG = {"svc_grid_search_large", "svr_grid_search_large", "cold_start", "memory_of_a_million"}
"""Lines that take a minute or more even with --quick; with it, they run only by name."""

PACKAGES = ("cgtorch", "torch", "numpy", "scikit-learn", "networkx")


def as_json(lines: list[Line], effort: Effort, seconds: float) -> dict[str, Any]:
    """The whole measurement as JSON values; `ratios` holds one number per line."""
    return {
        "ratios": {line.name: line.ratio for line in lines},
        "lines": {line.name: asdict(line) for line in lines},
        "effort": asdict(effort),
        "seconds": seconds,
        "machine": {"cores": cores(), "cpu": _cpu(), "load": list(os.getloadavg())},
        "versions": {"python": platform.python_version()} | {p: _version(p) for p in PACKAGES},
    }


def as_table(lines: list[Line]) -> Table:
    """One row per case of each line: seconds per call as median and extremes, and the ratio.

    A target is the least that the ratio should be, or with ≤ the most. Further notes on a case,
    such as rates, are below.
    """
    table = Table(title=f"{cores()} cores, {_cpu()}", title_justify="left")
    for heading in ("line", "case", "ours, s", "other, s", "ratio", "target", "clock"):
        table.add_column(heading, justify="left" if heading in ("line", "case") else "right")
    for line in lines:
        for part in line.parts:
            times = [
                f"{t.median:.3g} ({t.fastest:.3g}–{t.slowest:.3g})" for t in (part.ours, part.other)
            ]
            ratio = f"{part.ratio:.3g} {line.unit}"
            table.add_row(line.name, part.label, *times, ratio, _target(line), line.clock)
    notes = [f"{x.name}, {p.label}: {p.note}" for x in lines for p in x.parts if p.note]
    table.caption, table.caption_justify = Text("\n".join(notes)), "left"
    return table


def _target(line: Line) -> str:
    return f"{'≤' if line.at_most else '≥'} {line.target:g}"


def _cpu() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            return next(row for row in file if row.startswith("model name")).split(":")[1].strip()
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@click.command()
@click.option("--quick", is_flag=True, help="Smaller sizes and five repeats: under two minutes.")
@click.option("--json", "print_json", is_flag=True, help="Print one JSON object, no table.")
@click.option(
    "--only",
    multiple=True,
    type=click.Choice([*LINES, *ON_GPU]),
    help="This line; may be repeated.",
)
@click.option(
    "--device",
    type=click.Choice(["cpu", "cuda"]),
    default="cpu",
    help="With cuda, a GPU beside this machine's cores.",
)
def main(quick: bool, print_json: bool, only: tuple[str, ...], device: str) -> None:
    """Measure cgtorch and the alternatives."""
    effort, begin, lines = QUICK if quick else FULL, time.perf_counter(), []
    known = LINES | ON_GPU
    usual = [name for name in LINES if not (quick and name in LONG)]
    for name in only or (usual if device == "cpu" else list(ON_GPU)):
        click.echo(f"{name} ...", err=True)
        try:
            lines.append(line := known[name](effort))
        except ModuleNotFoundError as e:
            raise click.ClickException(f"{e.name} is missing; pip install '.[test]'") from e
        except CgtorchError as e:
            raise click.ClickException(f"{name}: {e}") from e
        click.echo(f"{name}: {line.ratio:.3g} {line.unit}, target {_target(line)}", err=True)
    if print_json:
        found = as_json(lines, effort, time.perf_counter() - begin)
        click.echo(json.dumps(found, indent=1, allow_nan=False))
    else:
        Console(width=None if sys.stdout.isatty() else 140).print(as_table(lines))


if __name__ == "__main__":
    main()
