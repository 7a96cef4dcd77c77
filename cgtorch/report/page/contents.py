"""What there is to tell of a run: its folder, read as far as the run has come."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.graphs import Skill, load_skill
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_json
from cgtorch.report.page.event_files import Told, read_event_files
from cgtorch.report.tensorboard import BY_ROWS
from cgtorch.runs.journal import FOLDER as JOURNAL
from cgtorch.runs.journal import FileJournal
from cgtorch.runs.ledger import read_index
from cgtorch.runs.run import Run, open_run
from cgtorch.runs.storage import CLASSIFIER, GAMMA, load_models, load_result, load_scenarios
from cgtorch.svm import LearningCurve

START = "start"


@dataclass(frozen=True)
class Stage:
    """A finished stage or round.

    Attributes:
        name: of the stage.
        result: its result.json.
        skill: what the run could do when it ended.
        solved: W, all that the skill has succeeded on.
        missed: M, all that it has failed on.
        accepted: its line in the ledger; None if no skill was accepted.
    """

    name: str
    result: dict[str, Any]
    skill: Skill
    solved: Any
    missed: Any
    accepted: dict[str, Any] | None


@dataclass(frozen=True)
class Begun:
    """A stage that is not finished, and the generations its journal knows."""

    name: str
    generations: int


@dataclass(frozen=True)
class Fitted:
    """What the fits of Γ and C found, and the folder of the run that has it."""

    where: str
    gamma: TransitionReport
    classifier: SuccessReport


@dataclass(frozen=True)
class Contents:
    """All that the page is made of."""

    run: Run
    about: dict[str, Any]
    summary: dict[str, Any]
    stages: tuple[Stage, ...]
    begun: tuple[Begun, ...]
    fitted: Fitted | None
    told: Told
    by_rows: Told


def read_contents(folder: Path, trusted: Sequence[str] = (), domain: str | None = None) -> Contents:
    """Read a run; nothing is tried or computed again.

    Args:
        folder: of the run.
        trusted: actions of its own that may be imported, as in `open_run`.
        domain: likewise.

    Raises:
        CgtorchError: there is no run, or a file of it is damaged.
    """
    run = open_run(folder, trusted, domain)
    index = {line["name"]: line for line in read_index(folder)}
    summary = folder / "summary.json"
    return Contents(
        run,
        _an_object(folder / "run.json"),
        _an_object(summary) if summary.is_file() else {},
        tuple(_stage(run, name, index.get(name)) for name in run.stages),
        tuple(_begun(run)),
        _fitted(run),
        read_event_files(folder),
        read_event_files(folder / BY_ROWS),
    )


def _an_object(path: Path) -> dict[str, Any]:
    data = read_json(path)
    if not isinstance(data, dict):
        raise RunError(f"{str(path)!r} holds no object; restore the file")
    return data


def _stage(run: Run, name: str, accepted: dict[str, Any] | None) -> Stage:
    folder = run.folder / name
    solved, missed = load_scenarios(folder / "scenarios.json", ("W", "M"), run.like())
    skill = load_skill(folder / "skill.json", run.actions)
    return Stage(name, load_result(folder / "result.json"), skill, solved, missed, accepted)


def _begun(run: Run) -> Iterable[Begun]:
    for path in sorted((run.folder / JOURNAL).glob("*")):
        if path.is_dir() and path.name not in run.stages:
            yield Begun(path.name, FileJournal(path).generations)


def _fitted(run: Run) -> Fitted | None:
    """The reports that came last; a run may be passed on without models."""
    for name in (*reversed(run.stages), START):
        folder = run.folder / name
        if (folder / GAMMA).is_file() and (folder / CLASSIFIER).is_file():
            models = load_models(folder, run.domain.unfitted())
            gamma, classifier = models.gamma_report, models.classifier_report
            if not (_sound_gamma(gamma) and _sound_classifier(classifier)):
                raise RunError(f"a report of the models in {str(folder)!r} is damaged; restore it")
            return Fitted(name, gamma, classifier)
    return None


def _sound_gamma(report: TransitionReport) -> bool:
    return (
        _numbers((report.rows, report.centres, report.informative))
        and isinstance(report.coordinates, tuple)
        and isinstance(report.units, tuple)
        and len(report.units) == len(report.coordinates)
        and all(isinstance(name, str) for name in (*report.coordinates, *report.units))
        and all(
            isinstance(errors, tuple)
            and len(errors) == len(report.coordinates)
            and _numbers(errors)
            for errors in (report.error, report.baseline_error)
        )
        and all(c is None or _numbers((c.C, c.gamma, c.epsilon)) for c in report.choice)
        and _sound_curve(report.learning_curve)
    )


def _sound_classifier(report: SuccessReport) -> bool:
    shares = (report.positive, report.balanced_accuracy, report.brier, report.calibration_error)
    return (
        _numbers((report.rows, report.centres, *shares, report.choice.C, report.choice.gamma))
        and isinstance(report.reliability, tuple)
        and all(isinstance(b, tuple) and len(b) == 3 for b in report.reliability)
        and all(_numbers(b) and 0 <= b[0] <= 1 and b[2] >= 1 for b in report.reliability)
        and all(0 <= b[1] <= 1 and b[2] == int(b[2]) for b in report.reliability)
        and _sound_curve(report.learning_curve)
    )


def _sound_curve(curve: LearningCurve | None) -> bool:
    if curve is None:
        return True
    scores = (curve.train_scores, curve.test_scores)
    return (
        isinstance(curve.sizes, tuple)
        and _numbers(curve.sizes)
        and all(isinstance(s, tuple) and len(s) == len(curve.sizes) for s in scores)
        and all(isinstance(f, tuple) and f and _numbers(f) for s in scores for f in s)
    )


def _numbers(values: Iterable[Any]) -> bool:
    return all(type(v) in (int, float) and math.isfinite(v) and abs(v) < 1e15 for v in values)
