"""Algorithm 1 over the stages of a domain, such as the four experiments of section VI."""

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from typing import Any, TypeAlias

import torch
from torch import Generator

from cgtorch.domains.domain import Domain
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.errors import CgtorchError, RunError, SettingsError
from cgtorch.ground.files import whole_folder
from cgtorch.improvement.events import (
    Event,
    SkillAccepted,
    StageFailed,
    StageFinished,
    StageStarted,
    TrainingEnded,
)
from cgtorch.improvement.expected import improve_expected
from cgtorch.improvement.grow import grow
from cgtorch.improvement.imagined import improve_imagined
from cgtorch.improvement.improve import improve
from cgtorch.improvement.rehearse import rehearse
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.runs.journal import FOLDER, forget, journal_of
from cgtorch.runs.log import history_of, read_log
from cgtorch.runs.storage import load_progress, save_progress
from cgtorch.runs.stored_run import AUTO, StoredRun
from cgtorch.training.advice import about_search
from cgtorch.training.after import why_late
from cgtorch.training.context import Training, for_means
from cgtorch.training.deadline import deadline
from cgtorch.training.evaluate import Score, evaluate_skill
from cgtorch.training.kept import best_at_hand, kept_skill
from cgtorch.training.searched import searched_of
from cgtorch.training.start import initial_progress, recall_spent, spent_of
from cgtorch.training.tally import Tally

FRESH, OVERALL, FRESH_SEED = 40, 40, 7_000_001
METHODS = {"compose": improve, "paper": grow}

Made: TypeAlias = tuple[Progress[Any], dict[str, Any]]
"""The progress after a stage or round, and its result."""


class NotImprovedError(CgtorchError, RuntimeError):
    """A stage found no skill that meets eq. 1 within its budget."""


def train(training: Training, stage: str) -> list[dict[str, Any]]:
    """Make all stages up to one, except those that the run has; returns their results.

    After a stage that finds no skill, the others go on, and it is tried again after them.

    Raises:
        NotImprovedError: Some stages found no skill that meets eq. 1, also after the others.
        RunError: A file cannot be written or read, or the run has continued in rounds.
        SettingsError: There is no such stage, or none for the run's kind of scenarios.
    """
    run = training.run
    names = stages_to_make(run, stage)
    recall_spent(training)
    progress = initial_progress(training)
    for name in run.stages:
        progress = load_progress(run, run.folder / name)
        forget(run.folder / FOLDER / name)  # in case its process was killed before it could
    while not training.purse.exhausted:
        ranks.wait()  # until the first rank has written the stage
        found = next_stage(names, run.stages, history_of(run.folder))
        if found is None:
            break
        name, failures = found
        try:
            progress = _stage(training, name, names, progress, failures)
        except NotImprovedError:
            if training.purse.exhausted:
                break
            training.told(StageFailed(name, training.attempts))
    ranks.wait()
    missing = " and ".join(name for name in names if name not in run.stages)
    if missing and not training.purse.exhausted:
        raise _not_improved(training, missing)
    training.log(TrainingEnded(stage))
    return [result for result in run.results if result["stage"] in names]


def next_stage(
    names: Sequence[str], made: Collection[str], history: Sequence[tuple[str, str]]
) -> tuple[str, int] | None:
    """The next stage to make, and how often it has found no skill; None if there is none.

    Stages that have not been tried come first. One that found no skill is tried again if others
    have been made since. `history` is that of `cgtorch.runs.log.history_of`.
    """
    tries = Counter(stage for event, stage in history if event == "failed")
    for name in names:
        if name not in made and not tries[name]:
            return name, 0
    for name in names:
        if name not in made:
            since = list(reversed(history))[: list(reversed(history)).index(("failed", name))]
            if any(event == "result" for event, _ in since):
                return name, tries[name]
    return None


def _stage(
    training: Training, name: str, names: tuple[str, ...], before: Progress[Any], failures: int
) -> Progress[Any]:
    """Make one stage, which has failed so often, and store it in the run."""
    run = training.run
    kind = run.domain.stages[name]
    tests = run.domain.tests(kind)
    sizes = len(before.solved), len(tests) + len(before.missed)
    training.told(StageStarted(name, names, *sizes, training.attempts))

    def test(after: Progress[Any], tally: Tally) -> Made | None:
        accepted = tally.accepted
        if accepted is None:
            return None
        skill, targets = accepted.skill, accepted.succeeded[accepted.targets]
        # Where nothing can be tried twice, tests are met after what was missed before.
        old, again = len(before.missed), run.repeats and not before.chance
        first = again or run.settings.method == "paper"
        own = torch.arange(len(targets)) < len(targets) - old
        own = own if first else own.flip(0)
        usual, seed = run.domain.kinds[0], FRESH_SEED + run.settings.seed
        result = {
            "stage": name,
            "scenarios": kind,
            "targets_succeeded": int(targets[own].sum()),
            "targets": len(tests),
            "earlier_failures": old,
            "earlier_failures_succeeded": int(targets[~own].sum()),
            **tally.result(before, skill, accepted.seconds, spent_of(training.purse)),
        }
        if not run.settings.driver:  # only a report wants these
            with training.working(f"testing {name} on fresh scenarios"):
                fresh = evaluate_skill(skill, run.domain, kind, FRESH, seed)
                overall = evaluate_skill(skill, run.domain, usual, OVERALL, seed)
            result |= {"fresh": counts(kind, fresh), "overall": counts(usual, overall)}
        return after, result

    return make_stage(training, name, kind, before, tests, test, failures)[0]


def make_stage(
    training: Training,
    name: str,
    kind: str,
    before: Progress[Any],
    tests: Any,
    test: Callable[[Progress[Any], Tally], Made | None],
    failures: int = 0,
    target: float = inf,
) -> Made:
    """Make one stage or round and store it in the run; NotImprovedError if there is no skill.

    Where skills are judged by means, it ends once these reach the target. `test` maps the progress
    and its cost to the final progress and the result, or to None if there is no skill.
    """
    run, tally = training.run, Tally()
    generator = stage_generator(run.domain, run.settings.seed, name, failures)

    def listen(event: Event) -> None:
        tally.count(event)
        training.told(event)

    def draw(count: int, generator: Generator) -> Any:
        return run.domain.draw(kind, count, generator)

    again = f"{name} again {failures}" if failures else name
    kept = kept_skill(run, name, again)
    with journal_of(run.folder, again, training.told, training.checkpoint_seconds) as journal:
        setup = training.setup(name, journal)
        setup = replace(setup, name=name, generator=generator, watch=listen, kept=kept)
        began, after = time.perf_counter(), before
        with best_at_hand(run, again, tally, kept), _late_as_no_skill(training, name):
            with deadline(training.purse):
                if run.imagines:
                    about = before, tests, draw, run.reward_models
                    aim = run.domain.target_return if target == inf else target
                    after = improve_imagined(for_means(run, setup, aim), *about)
                elif not training.by_mean(before):
                    after = _improved(training, setup, kind, before, tests, draw)
                if not run.imagines and training.by_mean(after) and not training.purse.exhausted:
                    after = improve_expected(for_means(run, setup, target), after, tests, draw)
            tally.seconds = time.perf_counter() - began
            made = test(after, tally)
            if made is None and training.purse.late():
                raise _not_improved(training, name)
        if made is not None:
            _keep(training, name, tally.accepted, made)
            return made
    raise _not_improved(training, name)


@contextmanager
def _late_as_no_skill(training: Training, name: str) -> Iterator[None]:
    """A context in which the end of the time is a NotImprovedError, wherever it comes."""
    try:
        yield
    except BudgetSpentError as e:
        if not training.purse.late():
            raise
        training.purse.exhausted = True
        raise _not_improved(training, name) from e


def _improved(
    training: Training, setup: Setup[Any], kind: str, before: Progress[Any], tests: Any, draw: Any
) -> Progress[Any]:
    """The progress after a stage or round by the run's method.

    Where the world repeats itself, a kind that an earlier stage has learned is only rehearsed.
    """
    run, stages, skill = training.run, training.run.domain.stages, before.skill
    rehearses = setup.repeats and run.settings.method == "compose" and setup.name in stages
    if rehearses and skill is not None:
        learned = [x["fresh"] for x in run.results if x["scenarios"] == kind and "fresh" in x]
        if learned:
            last = learned[-1]
            share = last["succeeded"] / last["tried"]
            return rehearse(setup, before, skill, tests, draw, share)
    return METHODS[run.settings.method](setup, before, tests, draw)


def _not_improved(training: Training, missing: str) -> NotImprovedError:
    """The error of stages without a skill, which says what was too little."""
    if training.purse.late():
        why = why_late(training.run.domain, training.purse)
        return NotImprovedError(f"the time was over before stage {missing} had a skill{why}")
    said = f"stage {missing} found no skill that keeps W and solves more"
    searched = searched_of(read_log(training.run.folder), missing)
    if searched is not None and searched.generations and not searched.solving:
        return NotImprovedError(f"{said}. {' '.join(about_search(searched))}")
    return NotImprovedError(
        f"{said} within {training.attempts} attempts; raise attempts, generations or population"
    )


def _keep(
    training: Training,
    name: str,
    accepted: SkillAccepted[Any] | None,
    made: Made,
) -> None:
    """Write the result of a stage or round: its row, and then its folder, on the first rank."""
    run, (after, result) = training.run, made
    if ranks.first():
        with whole_folder(run.folder / name) as folder:
            save_progress(folder, after, run.settings.seed, accepted)
            training.log(StageFinished(name, result))


def finished_generations(run: StoredRun) -> int:
    """Number of generations of all finished stages."""
    return sum(result["generations"] for result in run.results)


def counts(kind: str, score: Score) -> dict[str, Any]:
    """A score as in the result of a stage."""
    about = {"scenarios": kind, "tried": score.tried, "succeeded": score.successes}
    if score.returns is None:
        return about
    return {**about, "mean_return": score.mean_return, "error": score.error}


_SEED_STRIDE = 1_000_003
_AGAIN = 300_000  # by which they differ after a failure
_AUTO_SEEDS = 500_000  # far from seeds that one would evaluate with


def stages_to_make(run: StoredRun, stage: str) -> tuple[str, ...]:
    """All stages up to `stage`, which the run must have or still be able to make.

    SettingsError if there is no such stage, RunError if the run has continued in rounds.
    """
    every, usual = tuple(run.domain.stages), run.domain.kinds[0]
    if stage not in every:
        raise SettingsError(f"unknown stage {stage!r}; use one of {', '.join((*every, AUTO))}")
    if run.kind != usual:
        raise SettingsError(
            f"stages {every[0]} to {every[-1]} use {usual} scenarios, not {run.kind}; use "
            f"stage {AUTO!r} (--stage {AUTO})"
        )
    names = every[: every.index(stage) + 1]
    if run.rounds and not set(names) <= set(run.stages):
        raise RunError(
            f"run {str(run.folder)!r} has continued in rounds and cannot make a single stage any "
            f"more; continue with stage {AUTO!r} (--stage {AUTO}), or choose another run folder"
        )
    return names


def stage_generator(domain: Domain[Any], seed: int, stage: str, failures: int = 0) -> Generator:
    """The generator of one stage or round; it does not depend on the results of earlier ones.

    It is another one for a stage that has failed.
    """
    if stage in domain.stages:
        offset = list(domain.stages).index(stage) + 1
    else:
        offset = _AUTO_SEEDS + int(stage.removeprefix(f"{AUTO}-"))
    return Generator().manual_seed(seed * _SEED_STRIDE + offset + failures * _AGAIN)
