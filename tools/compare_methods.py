"""Compare `--method paper` with the default: success, evaluations and seconds, over many seeds.

    python tools/compare_methods.py FOLDER [--seeds 0:10] [--methods ...] [--budget N]

For each seed, data and models are made once for the default, by its exploration, and once for the
paper's method, from as many random data as it had. After each accepted skill it is tried on fresh
perimeter placements in the world, which costs it nothing. FOLDER keeps
one JSON file per seed and method; what is there is not made again, so that a long comparison can
be interrupted, and the table, FOLDER/table.md, is made from all files. Evaluations are actions
executed in the models, seconds are CPU seconds of one thread.
"""

import math
import shutil
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import click
import torch
from comparison.table import summary, table
from options.seeds import seeds_option

from cgtorch.evolution import EvolutionSettings, tournament
from cgtorch.ground.files import read_json, write_bytes, write_json
from cgtorch.improvement.events import Event, GenerationDone, SkillAccepted
from cgtorch.improvement.grow import grow
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.runs.log import LOG
from cgtorch.runs.settings import Goal, RunSettings, defaults_of
from cgtorch.runs.stored_run import StoredRun, planned_run, read_run, round_name, write_run
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.auto import ENOUGH, act, train_until
from cgtorch.training.context import Training
from cgtorch.training.evaluate import evaluate_skill
from cgtorch.training.start import initial_progress
from cgtorch.training.train import NotImprovedError, stage_generator, train

FRESH_SEED = 9_000_001  # of the placements that skills are measured on


@dataclass
class Meter:
    """A watch that notes what every accepted skill had cost when it was accepted, and its success.

    `measuring` are the CPU seconds of its own trials, which belong to nobody.
    """

    run: StoredRun
    placements: int
    transitions: int = 0
    generations: int = 0
    search: float = 0.0
    measuring: float = 0.0
    points: list[dict[str, Any]] = field(default_factory=list)
    began: float = field(default_factory=time.process_time)
    last: float = field(default_factory=time.process_time)

    def __call__(self, event: Event) -> None:
        """Take note of an event."""
        now = time.process_time()
        if isinstance(event, GenerationDone):
            self.transitions += event.generation.transitions
            self.generations += 1
            self.search += now - self.last
        elif isinstance(event, SkillAccepted):
            spent, seed = self.cost, FRESH_SEED + self.run.settings.seed
            domain = self.run.domain
            score = evaluate_skill(event.skill, domain, "perimeter", self.placements, seed)
            point = {"stage": event.stage, **spent, "succeeded": score.successes}
            size = {"nodes": event.skill.num_nodes, "depth": event.skill.depth}
            self.points.append({**point, **size})
            self.measuring += time.process_time() - now
        self.last = time.process_time()

    @property
    def cost(self) -> dict[str, Any]:
        """What was spent so far; `seconds` are those of search, learning and trials together."""
        return {
            "transitions": self.transitions,
            "generations": self.generations,
            "search_seconds": round(self.search, 3),
            "seconds": round(time.process_time() - self.began - self.measuring, 1),
        }


def by_stages(run: StoredRun, meter: Meter, budget: float) -> None:
    """The default: S0 to S3."""
    train(Training(run, meter, quietly), list(run.domain.stages)[-1])


def by_rounds(run: StoredRun, meter: Meter, budget: float) -> None:
    """The default with `--stage auto`; it ends by its goal, not by the clock."""
    train_until(Training(run, meter, quietly), Goal(minutes=1e6))


def published(setup: Setup[Any]) -> Setup[Any]:
    """The settings that the paper and the code it names publish.

    The paper: tournament selection, elitism, τ = 0.05, 20 transitions, half of the first population
    the last graph. Its code: 200 individuals of 100 nodes, a pool of 20, elitism 1, up to 10,000
    generations, and no other end than success.
    """
    evolution = EvolutionSettings(
        population=200,
        selection=tournament(20),
        elite=1,
        capacity=128,
        initial_nodes=(100, 100),
    )
    budget = Budget(generations=10_000, stall=10_000)
    return replace(setup, evolution=evolution, budget=budget, max_transitions=20)


def paper(run: StoredRun, meter: Meter, budget: float) -> None:
    """The paper's method with its own settings."""
    training = Training(run, meter, quietly)
    grow_all(training, published(training.setup("S0")), meter, budget)


def paper_here(run: StoredRun, meter: Meter, budget: float) -> None:
    """The paper's method with the run's population, tournament and end of evolutions."""
    training = Training(run, meter, quietly)
    grow_all(training, training.setup("S0"), meter, budget)


METHODS: dict[str, Callable[[StoredRun, Meter, float], None]] = {
    "stages": by_stages,
    "auto": by_rounds,
    "paper": paper,
    "paper-here": paper_here,
}
DEFAULTS = ("stages", "auto")  # their cost is the others' budget
USUAL = ("stages", "auto", "paper")


def grow_all(training: Training, setup: Setup[Any], meter: Meter, budget: float) -> None:
    """Algorithm 1 as published: S0 to S3 and then fresh failures, until the budget is spent.

    A stage goes on until all of its scenarios are solved or its share of what is left is spent;
    what it has missed joins the next one. Only one evolution is made at a time, so that each skill
    it accepts is measured.
    """
    run, progress = training.run, initial_progress(training)
    stages = list(run.domain.stages)
    names = [*stages, *(round_name(i + 1) for i in range(1000))]
    for i, name in enumerate(names):
        if meter.transitions >= budget:
            return
        generator = stage_generator(run.domain, run.settings.seed, name)
        if name in stages:
            todo = run.domain.tests(run.domain.stages[name]).joined(progress.missed)
        elif progress.skill is None:
            raise NotImprovedError(f"nothing was accepted in {', '.join(stages)}")
        else:
            score = act(run, progress.skill, Goal().screening, generator)
            todo = score.scenarios[(~score.succeeded).nonzero()[:ENOUGH, 0]]
            if not len(todo):
                return
        end = meter.transitions + (budget - meter.transitions) / max(1, len(stages) - i)
        progress = replace(progress, missed=todo)
        for _ in range(setup.attempts):
            if not len(progress.missed) or meter.transitions >= end:
                break
            progress = grow_once(setup, progress, name, end, meter, generator)


def grow_once(
    setup: Setup[Any],
    progress: Progress[Any],
    name: str,
    end: float,
    meter: Meter,
    generator: torch.Generator,
) -> Progress[Any]:
    """One evolution on all that is missed, which ends at `end` transitions at the latest."""
    left = replace(setup.budget, transitions=end - meter.transitions)
    once = replace(setup, attempts=1, budget=left)
    nothing = progress.missed[:0]  # all that is to be solved is in M already
    stage = replace(once, name=name, generator=generator, watch=meter)
    return grow(stage, progress, nothing, lambda *_: nothing)


def quietly(message: str) -> nullcontext[None]:
    """Long steps say nothing."""
    return nullcontext()


def compare(
    folder: Path, settings: RunSettings, methods: tuple[str, ...], budget: float, placements: int
) -> None:
    """Make the files of one seed that are not there yet.

    Args:
        folder: of the comparison.
        settings: of all runs, also their seed; the method is that of each.
        methods: keys of `METHODS`.
        budget: transitions of the paper's method; 0 for those of the default with more of them.
        placements: that skills are measured on.
    """
    seed = settings.seed
    made = {name: folder / f"seed-{seed}-{name}.json" for name in METHODS}
    if all(made[name].is_file() for name in methods):
        return
    for name in methods:
        if made[name].is_file():
            continue
        if name not in DEFAULTS and not budget:
            spent = [read_json(made[d])["transitions"] for d in DEFAULTS if made[d].is_file()]
            if not spent:
                raise click.ClickException(f"seed {seed}: make {' or '.join(DEFAULTS)} first")
            limit = max(spent)
        else:
            limit = math.inf if name in DEFAULTS else budget
        place = folder / f"seed-{seed}" / name
        shutil.rmtree(place, ignore_errors=True)  # one that was interrupted
        own = replace(settings, method="compose" if name in DEFAULTS else "paper")
        run, begin = begun(place, own), beginning(folder, own)
        shutil.copytree(begin.folder / "start", place / "start")
        shutil.copy(begin.folder / LOG, place / LOG)
        meter, failure = Meter(run, placements), None
        try:
            METHODS[name](run, meter, limit)
        except NotImprovedError as e:
            failure = str(e)
        about = {"method": name, "seed": seed, "placements": placements, "failure": failure}
        limited = {"budget": None if math.isinf(limit) else limit}
        write_json(
            made[name],
            {
                **about,
                **limited,
                **meter.cost,
                "points": meter.points,
                "settings": asdict(run.settings),
            },
        )
        click.echo(f"seed {seed}, {name}: {summary(read_json(made[name]))}", err=True)


def beginning(folder: Path, settings: RunSettings) -> StoredRun:
    """A run with the first data and models of a seed and method, made unless it is there."""
    run = begun(folder / f"seed-{settings.seed}" / f"begin-{settings.method}", settings)
    initial_progress(Training(run, lambda event: None, quietly))
    return run


def begun(folder: Path, settings: RunSettings) -> StoredRun:
    """A run in a folder, new or as it is."""
    if (folder / "run.json").is_file():
        return read_run(folder, settings.actions)
    run = planned_run(folder, settings)
    write_run(run)
    return run


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@seeds_option("0:10")
@click.option(
    "--methods", multiple=True, type=click.Choice(list(METHODS)), default=USUAL, show_default=True
)
@click.option(
    "--budget", default=0.0, help="Transitions of the paper's method; else what the default took."
)
@click.option("--placements", default=1000, show_default=True, help="Fresh ones for each skill.")
def main(
    folder: Path, seeds: range, methods: tuple[str, ...], budget: float, placements: int
) -> None:
    """Compare the paper's method with the default and print a table in Markdown."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        settings = RunSettings(**{**defaults_of(TabletopSettings), "seed": seed})
        compare(folder, settings, methods, budget, placements)
    results = [read_json(path) for path in sorted(folder.glob("seed-*.json"))]
    text = table(results)
    write_bytes(folder / "table.md", text.encode())
    click.echo(text)


if __name__ == "__main__":
    main()
