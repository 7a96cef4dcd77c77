"""Measure how much faster several ranks, each with one thread, evaluate a population than one.

    python tools/measure_ranks.py [--ranks 1 --ranks 2] [--population 4000] [--repeats 7]

The same generation of random graphs is evaluated on 20 scenarios in the models of runs/reference,
alternately with each number of ranks. All must give the same fitness, bit for bit.
"""

import hashlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import torch

from cgtorch.evolution import EvolutionSettings, evaluator
from cgtorch.evolution.population import random_population
from cgtorch.ground import distributed as ranks
from cgtorch.improvement.trial import first_percepts
from cgtorch.runs.storage import load_knowledge
from cgtorch.runs.stored_run import read_run

REFERENCE = Path(__file__).resolve().parent.parent / "runs" / "reference"
SCENARIOS = 20


@click.command()
@click.option("--ranks", "counts", multiple=True, default=(1, 2), help="Ranks; may be repeated.")
@click.option("--population", default=4000, show_default=True, help="Individuals.")
@click.option("--repeats", default=7, show_default=True, help="Times that each is measured.")
@click.option("--as-rank", is_flag=True, hidden=True)
def command(counts: Sequence[int], population: int, repeats: int, as_rank: bool) -> None:
    """How much faster several ranks evaluate a population than one."""
    if as_rank:
        evaluate_as_rank(population, repeats)
        return
    found = {count: measured(count, population, repeats) for count in counts}
    if len({result["fitness"] for result in found.values()}) > 1:
        raise click.ClickException("ranks computed different fitness")
    one = found[counts[0]]
    for count, result in found.items():
        speed = result["transitions"] / statistics.median(result["seconds"])
        ratio = statistics.median(one["seconds"]) / statistics.median(result["seconds"])
        low, high = min(result["seconds"]), max(result["seconds"])
        click.echo(
            f"{count} ranks: {speed / 1e6:.2f} M transitions/s, {ratio:.2f} x as many as "
            f"{counts[0]}; {low:.2f} to {high:.2f} s for {population} x {SCENARIOS}"
        )


def measured(count: int, population: int, repeats: int) -> dict[str, Any]:
    """The measurements of so many ranks."""
    options = ["--as-rank", "--population", str(population), "--repeats", str(repeats)]
    result: dict[str, Any] = json.loads(torchrun(count, [__file__, *options]))
    return result


def torchrun(count: int, words: Sequence[str]) -> str:
    """The output of a program on so many ranks with one thread each."""
    program = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    ended = subprocess.run(
        [*program, f"--nproc-per-node={count}", *words],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise click.ClickException(f"{count} ranks: {ended.stderr[-2000:]}")
    return ended.stdout


def evaluate_as_rank(population: int, repeats: int) -> None:
    """Evaluate the population with the other ranks; the first one prints the measurements."""
    torch.set_num_threads(1)
    generator, run = torch.Generator().manual_seed(0), read_run(REFERENCE)
    domain, models = run.domain, run.models
    percepts = first_percepts(domain.world(domain.draw("perimeter", SCENARIOS, generator)))
    knowledge = load_knowledge(REFERENCE / "S3", models.unfitted())
    environment = models.imagine(knowledge, percepts, 1, generator)
    settings = EvolutionSettings(population)
    sizes = settings.capacity, settings.initial_nodes
    graphs = random_population(population, run.actions, *sizes, generator).graphs
    keep = torch.zeros(SCENARIOS, dtype=torch.bool)
    with ranks.together():
        seconds = []
        for _ in range(repeats + 1):
            ranks.wait()
            began = time.perf_counter()
            result = evaluator(run.actions, environment, keep)(graphs)
            seconds.append(time.perf_counter() - began)
        if ranks.first():
            digest = hashlib.sha256(result.scores.numpy().tobytes()).hexdigest()
            measured = {
                "seconds": seconds[1:],
                "transitions": result.transitions,
                "fitness": digest,
            }
            click.echo(json.dumps(measured))


if __name__ == "__main__":
    command()
