"""Algorithm 1 over a domain's stages, such as the four experiments of section VI."""

from dataclasses import dataclass
from math import inf
from typing import Any

from torch import Generator

from cgtorch.evolution import Population
from cgtorch.graphs import Skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import CgtorchError
from cgtorch.ground.files import write_json
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    SkillAccepted,
    StageStarted,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress
from cgtorch.runs.journal import forget, journal_of
from cgtorch.runs.ledger import Entry, enter, entry_of
from cgtorch.runs.run import Run, whole_folder
from cgtorch.runs.stage_files import load_progress, save_progress
from cgtorch.runs.storage import load_result
from cgtorch.training.context import Training
from cgtorch.training.evaluate import Score, evaluate_skill, under_other_noise
from cgtorch.training.initial_models import initial_progress
from cgtorch.training.stages import exercise, stage_generator, stages_to_make

FRESH, OVERALL, FRESH_SEED = 40, 40, 7_000_001

METHODS = {"compose": improve, "paper": grow}


class NotImprovedError(CgtorchError, RuntimeError):
    """Within its budget a stage found no skill that meets eq. 1."""


@dataclass
class Tally:
    """What one stage cost, the skill it accepted last, and the fittest individual it has seen."""

    generations: int = 0
    transitions: int = 0
    searching: float = 0.0  # s
    accepted: SkillAccepted[Any] | None = None
    champion: Population | None = None
    best: float = -inf  # its fitness

    def count(self, event: Event) -> None:
        """Take note of what an event says."""
        if isinstance(event, GenerationDone):
            self.generations += 1
            self.transitions += event.generation.transitions
            self.searching += event.seconds
            self._compare(event.generation.champion, event.generation.best)
        elif isinstance(event, EvolutionRecalled):
            self.generations += event.generations
            self.transitions += event.transitions
            self.searching += event.seconds
            self._compare(event.champion, event.best)
        elif isinstance(event, SkillAccepted):
            self.accepted = event

    def _compare(self, champion: Population, fitness: float) -> None:
        if fitness > self.best:
            self.champion, self.best = champion, fitness


def train(training: Training, stage: str) -> list[dict[str, Any]]:
    """Make all stages up to one, except those the run has already.

    Returns:
        The result of every stage, as in its result.json.

    Raises:
        NotImprovedError: a stage ended without a skill that meets eq. 1.
        RunError: a file cannot be written or read, or the run has gone on in rounds.
        SettingsError: no such stage, or the run is about scenarios that have none.
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
    training: Training, name: str, names: tuple[str, ...], progress: Progress[Any]
) -> Progress[Any]:
    """Make one stage and keep it in the run."""
    run = training.run
    generator = stage_generator(run.domain, run.settings.seed, name)
    # The published protocol knows the tests only.
    practice = run.settings.practice if run.settings.method == "compose" else 0
    task = exercise(run, name, progress.missed, practice, generator)
    sizes = (len(progress.solved), len(task.scenarios))
    training.watch(StageStarted(name, names, *sizes, run.settings.attempts))
    tally, method = Tally(), METHODS[run.settings.method]

    def draw(generator: Generator) -> Any:
        return run.domain.draw(run.domain.stages[name], practice, generator)

    earlier, parent = len(progress.solved), progress.skill
    with journal_of(run.folder, name, training.watch, training.checkpoint_seconds) as journal:
        progress = method(
            training.setup(journal), progress, name, task.scenarios, task.targets, draw, generator,
            listener(training, tally),
        )  # fmt: skip
        if tally.accepted is not None:
            with training.working(f"testing {name} on fresh scenarios"):
                result = _result(run, name, tally.accepted, task.tests, earlier, tally)
            entry = evidence(training, tally.accepted, parent, progress)
            keep_stage(run, name, progress, result, entry)
    if tally.accepted is None:
        raise not_improved(run, name)
    return progress


def listener(training: Training, tally: Tally) -> Any:
    """What is told by a stage: the tally, and who watches the training."""

    def listen(event: Event) -> None:
        tally.count(event)
        training.watch(event)

    return listen


def keep_stage(
    run: Run, name: str, progress: Progress[Any], result: dict[str, Any], entry: Entry | None
) -> None:
    """Write what a stage or round has come to, the first rank only."""
    if not ranks.first():
        return
    if entry is not None:
        enter(run.folder, entry)
    with whole_folder(run.folder / name) as folder:
        save_progress(folder, progress, run.settings.seed)
        write_json(folder / "result.json", result)


def evidence(
    training: Training, accepted: SkillAccepted[Any], parent: Skill | None, after: Progress[Any]
) -> Entry:
    """The ledger's entry of a skill that was just accepted; see `entry_of`."""
    run, again = training.run, None
    if run.domain.noisy_world:
        with training.working(f"trying {accepted.stage} under other noise"):
            score = under_other_noise(accepted.skill, run.domain, after.solved, run.settings.seed)
        again = score.tried, score.successes
    return entry_of(accepted, parent, after, again)


def not_improved(run: Run, name: str) -> NotImprovedError:
    """The error of a stage that found nothing."""
    return NotImprovedError(
        f"stage {name} found no skill that keeps W and solves more within "
        f"{run.settings.attempts} attempts; raise --attempts, --generations or --population"
    )


def _result(
    run: Run, name: str, accepted: SkillAccepted[Any], tests: int, earlier: int, tally: Tally
) -> dict[str, Any]:
    """A stage's line of the final table; it began with W of `earlier`."""
    skill, succeeded = accepted.skill, accepted.succeeded
    seed = FRESH_SEED + run.settings.seed
    kind, usual = run.domain.stages[name], run.domain.usual_kind
    fresh = evaluate_skill(skill, run.domain, kind, FRESH, seed)
    overall = evaluate_skill(skill, run.domain, usual, OVERALL, seed)
    targets = succeeded[accepted.targets]
    return {
        "stage": name,
        "scenarios": kind,
        "targets_succeeded": int(targets[:tests].sum()),
        "targets": tests,
        "earlier_failures": len(targets) - tests,
        "earlier_failures_succeeded": int(targets[tests:].sum()),
        "w_size": earlier,
        "w_lost": int((~succeeded[accepted.keep]).sum()),
        "nodes": skill.num_nodes,
        "depth": skill.depth,
        "generations": tally.generations,
        "transitions": tally.transitions,
        "seconds": round(accepted.seconds, 1),
        "search_seconds": round(tally.searching, 3),
        "fresh": counts(kind, fresh),
        "overall": counts(usual, overall),
    }


def finished_generations(run: Run) -> int:
    """Generations of all finished stages."""
    return sum(load_result(run.folder / name / "result.json")["generations"] for name in run.stages)


def counts(kind: str, score: Score) -> dict[str, Any]:
    """A score as a result.json holds it."""
    about = {"scenarios": kind, "tried": score.tried, "succeeded": score.successes}
    return about if score.returns is None else {**about, "mean_return": score.mean_return}
