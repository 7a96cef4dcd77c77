"""Algorithm 1 over the stages of a domain, such as the four experiments of section VI."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any, TypeAlias

from torch import Generator

from cgtorch.evolution import Generation, Population
from cgtorch.graphs import Skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import CgtorchError
from cgtorch.ground.files import whole_folder, write_json
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    SkillAccepted,
    StageStarted,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Stage
from cgtorch.improvement.stopping import Found
from cgtorch.runs.journal import forget, journal_of
from cgtorch.runs.ledger import enter, entry_of
from cgtorch.runs.run import Run
from cgtorch.runs.storage import load_progress, load_result, save_progress
from cgtorch.training.context import Training, initial_progress
from cgtorch.training.evaluate import Score, evaluate_skill, under_other_noise
from cgtorch.training.stages import Exercise, exercise, stage_generator, stages_to_make

FRESH, OVERALL, FRESH_SEED = 40, 40, 7_000_001

METHODS = {"compose": improve, "paper": grow}

Made: TypeAlias = tuple[Progress[Any], dict[str, Any]]
"""The progress after a stage or round, and its result."""


class NotImprovedError(CgtorchError, RuntimeError):
    """A stage found no skill that meets eq. 1 within its budget."""


@dataclass
class Tally:
    """The cost of a stage, the last skill it accepted, and the fittest individual."""

    generations: int = 0
    transitions: int = 0
    searching: float = 0.0  # s
    seconds: float = 0.0  # of all of it
    accepted: SkillAccepted[Any] | None = None
    champion: Population | None = None
    best: float = -inf  # its fitness

    def count(self, event: Event) -> None:
        """Update by an event."""
        if isinstance(event, GenerationDone):
            self._add(1, event.generation, event.seconds)
        elif isinstance(event, EvolutionRecalled):
            self._add(event.found.generations, event.found, event.found.seconds)
        elif isinstance(event, SkillAccepted):
            self.accepted = event

    def _add(self, generations: int, found: Generation | Found, seconds: float) -> None:
        self.generations += generations
        self.transitions += found.transitions
        self.searching += seconds
        if found.best > self.best:
            self.champion, self.best = found.champion, found.best

    def result(self, before: Progress[Any], skill: Skill, seconds: float) -> dict[str, Any]:
        """The common part of the results of stages and rounds, given the progress before."""
        accepted = self.accepted
        lost = 0 if accepted is None else int((~accepted.succeeded[accepted.keep]).sum())
        return {
            "w_size": len(before.solved),
            "w_lost": lost,
            "nodes": skill.num_nodes,
            "depth": skill.depth,
            "generations": self.generations,
            "transitions": self.transitions,
            "seconds": round(seconds, 1),
            "search_seconds": round(self.searching, 3),
        }


def train(training: Training, stage: str) -> list[dict[str, Any]]:
    """Make all stages up to one, except those that the run has; returns their results.

    Raises:
        NotImprovedError: A stage ended without a skill that meets eq. 1.
        RunError: A file cannot be written or read, or the run has continued in rounds.
        SettingsError: There is no such stage, or none for the run's kind of scenarios.
    """
    run = training.run
    names = stages_to_make(run, stage)
    progress = initial_progress(training)
    for name in names:
        if name in run.stages:
            progress = load_progress(run, run.folder / name)
            forget(run.folder, name)
        else:
            progress = _stage(training, name, names, progress)
    ranks.wait()
    results = [load_result(run.folder / name / "result.json") for name in names]
    if ranks.first():
        write_json(run.folder / "summary.json", {"stages": results, **run.all_settings()})
    return results


def _stage(
    training: Training, name: str, names: tuple[str, ...], before: Progress[Any]
) -> Progress[Any]:
    """Make one stage and store it in the run."""
    run = training.run
    generator = stage_generator(run.domain, run.settings.seed, name)
    # The published protocol knows the tests only.
    practice = run.settings.practice if run.settings.method == "compose" else 0
    task = exercise(run, name, before.missed, practice, generator)
    sizes = len(before.solved), len(task.scenarios)
    training.watch(StageStarted(name, names, *sizes, run.settings.attempts))

    def test(after: Progress[Any], tally: Tally) -> Made | None:
        accepted = tally.accepted
        if accepted is None:
            return None
        skill, targets = accepted.skill, accepted.succeeded[accepted.targets]
        kind, usual = run.domain.stages[name], run.domain.usual_kind
        with training.working(f"testing {name} on fresh scenarios"):
            seed = FRESH_SEED + run.settings.seed
            fresh = evaluate_skill(skill, run.domain, kind, FRESH, seed)
            overall = evaluate_skill(skill, run.domain, usual, OVERALL, seed)
        return after, {
            "stage": name,
            "scenarios": kind,
            "targets_succeeded": int(targets[: task.tests].sum()),
            "targets": task.tests,
            "earlier_failures": len(targets) - task.tests,
            "earlier_failures_succeeded": int(targets[task.tests :].sum()),
            **tally.result(before, skill, accepted.seconds),
            "fresh": counts(kind, fresh),
            "overall": counts(usual, overall),
        }

    return make_stage(training, name, before, task, generator, test)[0]


def make_stage(
    training: Training,
    name: str,
    before: Progress[Any],
    task: Exercise,
    generator: Generator,
    test: Callable[[Progress[Any], Tally], Made | None],
) -> Made:
    """Make one stage or round and store it in the run; NotImprovedError if there is no skill.

    `test` tries the skill on fresh scenarios. It maps the progress and its cost to the final
    progress and the result, or to None if there is no skill.
    """
    run, tally = training.run, Tally()

    def listen(event: Event) -> None:
        tally.count(event)
        training.watch(event)

    with journal_of(run.folder, name, training.watch, training.checkpoint_seconds) as journal:
        stage = Stage(training.setup(journal), name, generator, listen)
        began, method = time.perf_counter(), METHODS[run.settings.method]
        after = method(stage, before, task.scenarios, task.targets, task.draw)
        tally.seconds = time.perf_counter() - began
        made = test(after, tally)
        if made is not None:
            _keep(training, name, tally.accepted, before, made)
            return made
    raise NotImprovedError(
        f"stage {name} found no skill that keeps W and solves more within "
        f"{run.settings.attempts} attempts; raise --attempts, --generations or --population"
    )


def _keep(
    training: Training,
    name: str,
    accepted: SkillAccepted[Any] | None,
    before: Progress[Any],
    made: Made,
) -> None:
    """Write the result of a stage or round, on the first rank only."""
    run, (after, result) = training.run, made
    again = None
    if accepted is not None and run.domain.noisy_world:
        with training.working(f"testing {name} on W under other noise"):
            score = under_other_noise(accepted.skill, run.domain, after.solved, run.settings.seed)
        again = {"tried": score.tried, "succeeded": score.successes}
    if not ranks.first():
        return
    if accepted is not None:
        enter(run.folder, entry_of(accepted, before.skill, after, again))
    with whole_folder(run.folder / name) as folder:
        save_progress(folder, after, run.settings.seed)
        write_json(folder / "result.json", result)


def finished_generations(run: Run) -> int:
    """Number of generations of all finished stages."""
    return sum(load_result(run.folder / name / "result.json")["generations"] for name in run.stages)


def counts(kind: str, score: Score) -> dict[str, Any]:
    """A score in the form of result.json."""
    about = {"scenarios": kind, "tried": score.tried, "succeeded": score.successes}
    return about if score.returns is None else {**about, "mean_return": score.mean_return}
