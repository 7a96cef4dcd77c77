"""Measure this library and its peers on standard tasks, with the same worlds and budgets.

    python tools/standard_tasks.py [--only cartpole] [--library evosax] [--seeds 0:10] [--jobs 2]
                                   [--json] [--output FILE] [--figure FILE] [--cpu-seconds 600]

A champion that is good enough in training is tried on 100 fresh episodes, and has solved the task
if their mean return passes the task's threshold, and further tests where a task has such
(`tools/standard/`). Evaluations, episodes and world steps are those of the training until then, CPU
seconds those of the process with all its tests. Each search has a process and a thread of its own.
The peers are installed by `pip install -r tools/standard/peers.txt`; those that are not are left
out, and the table says so. `--library` takes variants of this library, too, which have one part of
its search changed (`tools/standard/components.py`).
"""

import importlib
import importlib.metadata
import importlib.util
import json
import multiprocessing
import os
import platform
from collections import ChainMap
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeAlias

import click
from options.seeds import seeds_option
from standard.measure import BUDGETS, Budget, Result, Trial
from standard.peers import LIBRARIES, VARIANTS, UnsuitableError
from standard.tables import figure_rows, markdown, summary
from standard.tasks import TASKS

from cgtorch.ground.files import read_json, write_json

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
FAILED = "failed: "
"""How the note of a search begins that has to be made again."""

EVERY = ChainMap(LIBRARIES, VARIANTS)
"""What can be measured; variants are if they are asked for."""
NOT_INSTALLED = "not installed"
Work: TypeAlias = tuple[str, str, int]
"""A task, a library and a seed."""


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.option("--only", multiple=True, type=click.Choice([*TASKS]), help="Of these tasks only.")
@click.option("--library", multiple=True, type=click.Choice([*EVERY]), help="Of these only.")
@seeds_option("0:10")
@click.option("--evaluations", default=10**9, help="Give a search up after so many at the latest.")
@click.option("--cpu-seconds", type=float, help="In place of what a task's searches are given.")
@click.option("--jobs", default=1, show_default=True, help="Searches side by side.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON in place of the table.")
@click.option("--output", type=click.Path(path_type=Path), help="Where results are kept.")
@click.option("--kept-only", is_flag=True, help="Measure nothing, show what --output holds.")
@click.option("--figure", type=click.Path(path_type=Path), help="Whose rows of these are replaced.")
def command(
    only: tuple[str, ...],
    library: tuple[str, ...],
    seeds: range,
    evaluations: int,
    cpu_seconds: float | None,
    jobs: int,
    as_json: bool,
    output: Path | None,
    kept_only: bool,
    figure: Path | None,
) -> None:
    """Measure what is not kept yet, and print what has come out."""
    tasks, libraries = only or tuple(TASKS), library or tuple(LIBRARIES)
    there = [name for name in libraries if importlib.util.find_spec(EVERY[name].package)]
    kept = _kept(output)
    work = [(task, name, seed) for task in tasks for name in there for seed in seeds]
    if kept_only:
        work = [each for each in work if each in kept]
    budgets = {task: _budget(task, evaluations, cpu_seconds) for task in tasks}
    for found in measured([each for each in work if each not in kept], budgets, jobs):
        kept[found.task, found.library, found.seed] = found
        click.echo(_line(found), err=True)
        if output:
            results = [asdict(result) for result in kept.values()]
            write_json(output, {"results": results, "machine": machine(), "versions": versions()})
    wanted = [kept[each] for each in work]
    missing = {name: NOT_INSTALLED for name in libraries if name not in there}
    about = summary(wanted, tasks, libraries, missing)
    if as_json:
        whole = {"tasks": about, "machine": machine(), "versions": versions()}
        click.echo(json.dumps(whole, indent=1))
    else:
        click.echo(markdown(about))
    if figure:
        shown = read_json(figure)
        new = {tuple(row[:2]): row for row in figure_rows(about, shown["columns"])}
        rows = [new.pop(tuple(row[:2]), row) for row in shown["rows"]]
        write_json(figure, shown | {"rows": [*rows, *new.values()]})


def _budget(task: str, evaluations: int, cpu_seconds: float | None) -> Budget:
    """A task's budget, with fewer evaluations and other seconds if that is asked for."""
    usual = BUDGETS[task]
    return Budget(cpu_seconds or usual.cpu_seconds, min(usual.evaluations, evaluations))


def measured(work: list[Work], budgets: dict[str, Budget], jobs: int) -> Iterator[Result]:
    """Results as they come in."""
    os.environ.update(ONE_THREAD)  # for the processes that are started
    with ThreadPoolExecutor(max(1, jobs)) as pool:
        running = [pool.submit(apart, *each, budgets[each[0]]) for each in work]
        for future in as_completed(running):
            yield future.result()


def apart(task: str, library: str, seed: int, budget: Budget) -> Result:
    """The result of a search in a process of its own, whatever becomes of that."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["torch", "cgtorch.evolution"]
    )  # takes longer than most searches
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(
        target=_search, args=(sender, task, library, seed, budget), daemon=True
    )
    process.start()
    sender.close()
    failed = partial(_failed, task, library, seed)
    patience = 20 * budget.cpu_seconds + 600
    try:
        found: Result = receiver.recv() if receiver.poll(patience) else failed("no end")
    except EOFError:
        process.join()
        found = failed(f"exit code {process.exitcode}")
    process.kill()
    process.join()
    return found


def _failed(task: str, library: str, seed: int, why: str) -> Result:
    """The result of a search that has not come to an end."""
    return Result(task, library, seed, False, 0, 0, 0, 0.0, None, None, FAILED + why)


def _search(sender: Connection, task: str, library: str, seed: int, budget: Budget) -> None:
    """Search, in this process, and send the result."""
    import torch

    torch.set_num_threads(1)
    try:
        module = importlib.import_module(EVERY[library].module)
    except ImportError as error:
        sender.send(_failed(task, library, seed, f"cannot be imported ({error})"))
        return
    trial, note = Trial(TASKS[task], library, seed, budget), ""
    try:
        module.search(trial)
    except UnsuitableError as error:
        note = str(error)
    except Exception as error:
        note = f"{FAILED}{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    sender.send(trial.result(note))


def _kept(output: Path | None) -> dict[Work, Result]:
    """What a file holds already, but what has failed."""
    if output is None or not output.is_file():
        return {}
    results = [Result(**each) for each in read_json(output)["results"]]
    good = [each for each in results if not each.note.startswith(FAILED)]
    return {(each.task, each.library, each.seed): each for each in good}


def _line(found: Result) -> str:
    """A line on a search that has ended."""
    outcome = "solved" if found.solved else "not solved"
    cost = f"{found.evaluations:,} evaluations, {found.cpu_seconds:.1f} CPU s"
    note = f" ({found.note})" if found.note else ""
    return f"{found.task}, {found.library}, seed {found.seed}: {outcome}, {cost}{note}"


def machine() -> dict[str, Any]:
    """What it was measured on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def _processor() -> str:
    """The name of the processor, as far as it is known."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def versions() -> dict[str, str | None]:
    """Versions of all that takes part, None of what is not installed."""
    names = [name for each in LIBRARIES.values() for name in (each.distribution, *each.others)]
    return {name: _version(name) for name in dict.fromkeys(names)}


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    command()
