"""Compare searches for skills that have the same primitives: ours, random, CMA-ES and PPO.

    python tools/compare_robot_tasks.py FOLDER metaworld:push-v3 [--seeds 0:5] [--searches ...]

All act by the same primitives, perceive the same, and count low-level steps in the same way. A
search ends when it solves 32 starts, and then 50 fresh ones, all in a row; `ours` may choose the
starts of its first group, and practises on 50. The result meets the official starts of
`measure_robot_tasks.py`. FOLDER keeps a JSON file for each task, search and seed; what is there is
not made again. The table is FOLDER/table.md. PPO needs `pip install -r tools/robot_tasks/peers.txt`
and is left out without it.
"""

import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import torch
from measure_robot_tasks import FETCH_STARTS, GOALS, official_of
from options.seeds import seeds_option
from robot_tasks import ours, ppo, random_search, scripted_cma
from robot_tasks.problem import BUDGET, Found, Problem
from robot_tasks.scripts import script_of
from robot_tasks.table import table

from cgtorch.ground.files import read_json, write_bytes, write_json
from cgtorch.manipulation.domain import Fetch

SEARCHES: Mapping[str, ModuleType] = {
    "ours": ours,
    "random": random_search,
    "cma": scripted_cma,
    "ppo": ppo,
}


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("domains", nargs=-1, required=True)
@seeds_option("0:5")
@click.option(
    "--searches",
    multiple=True,
    type=click.Choice(list(SEARCHES)),
    default=tuple(SEARCHES),
    show_default=True,
    help="What to compare; can be given several times.",
)
@click.option("--budget", default=BUDGET, show_default=True, help="Low-level steps requested.")
@click.option("--count", default=0, help="Official starts per task.  [50; 100 for Fetch]")
def command(
    folder: Path,
    domains: tuple[str, ...],
    seeds: range,
    searches: tuple[str, ...],
    budget: int,
    count: int,
) -> None:
    """Compare searches for skills that have the same primitives."""
    torch.set_num_threads(1)
    if "ppo" in searches and find_spec("stable_baselines3") is None:
        click.echo("ppo is left out; pip install -r tools/robot_tasks/peers.txt", err=True)
        searches = tuple(name for name in searches if name != "ppo")
    if "cma" in searches:
        for domain in domains:
            script_of(domain.partition(":")[2])
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        for domain in domains:
            for name in searches:
                click.echo(line(measured(folder, domain, seed, name, budget, count)), err=True)
    given = {name: module.GIVEN for name, module in SEARCHES.items()}
    text = table([read_json(path) for path in sorted(folder.glob("*.json"))], given)
    write_bytes(folder / "table.md", text.encode())
    click.echo(text)


def measured(
    folder: Path, domain: str, seed: int, name: str, budget: int, count: int
) -> dict[str, Any]:
    """The result of one search, from the folder if it is there."""
    path = folder / f"{domain.replace(':', '-')}-{name}-{seed}.json"
    if path.is_file():
        known: dict[str, Any] = read_json(path)
        return known
    problem = Problem(domain, seed, budget)
    search: Callable[[Problem], Found] = SEARCHES[name].search
    began = time.perf_counter()
    found = search(problem)
    seconds = time.perf_counter() - began
    few = count or (FETCH_STARTS if isinstance(problem.domain, Fetch) else GOALS)
    good, steps = 0, 0.0
    if found.play is not None:
        tried = official_of(found.play, problem.domain, problem.task, few)
        good, steps = tried.succeeded, tried.steps
    result = {
        "domain": domain,
        "task": problem.task,
        "search": name,
        "seed": seed,
        "budget": budget,
        "met": found.met,
        "requested": found.asked.steps,
        "simulated": found.asked.simulated,
        "official": [good, few, round(steps, 1)],
        "seconds": round(seconds, 1),
    }
    write_json(path, result)
    return result


def line(result: dict[str, Any]) -> str:
    """One result in a line."""
    good, tries, _ = result["official"]
    met = "met" if result["met"] else "not met"
    return (
        f"{result['task']} {result['search']} seed {result['seed']}: criterion {met}, "
        f"{result['requested']} steps requested, {result['simulated']} simulated, official "
        f"{good}/{tries}, {result['seconds']:.0f} s"
    )


if __name__ == "__main__":
    command()
