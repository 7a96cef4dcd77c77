"""The contents of a run's folder, finished or not."""

from dataclasses import dataclass, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.graphs import Skill, load_skill
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import read_json
from cgtorch.report.page.event_files import EventData, read_event_files
from cgtorch.report.tensorboard import BY_ROWS
from cgtorch.runs.journal import FOLDER as JOURNAL
from cgtorch.runs.journal import FileJournal
from cgtorch.runs.ledger import read_index
from cgtorch.runs.storage import CLASSIFIER, GAMMA, load_models, load_result, load_scenarios
from cgtorch.runs.stored_run import StoredRun
from cgtorch.svm import LearningCurve

START = "start"


@dataclass(frozen=True)
class Stage:
    """A finished stage or round: its result.json, and what the run could solve at its end."""

    name: str
    result: dict[str, Any]
    skill: Skill
    solved: Any  # W, all scenarios that the skill has succeeded on
    missed: Any  # M, all that it has failed on
    accepted: dict[str, Any] | None  # its line in the ledger; None if no skill was accepted


@dataclass(frozen=True)
class Fitted:
    """The reports of the fits of Γ and C, and the folder that contains them."""

    where: str
    gamma: TransitionReport
    classifier: SuccessReport


@dataclass(frozen=True)
class Contents:
    """Everything that the page shows."""

    run: StoredRun
    about: dict[str, Any]
    summary: dict[str, Any]
    stages: tuple[Stage, ...]
    begun: tuple[tuple[str, int], ...]
    fitted: Fitted | None
    events: EventData
    by_rows: EventData


def read_contents(run: StoredRun) -> Contents:
    """Read all files of a run; nothing is tried or computed again."""
    folder = run.folder
    index = {line["name"]: line for line in read_index(folder)}
    summary = folder / "summary.json"
    return Contents(
        run,
        _an_object(folder / "run.json"),
        _an_object(summary) if summary.is_file() else {},
        tuple(_stage(run, name, index.get(name)) for name in run.stages),
        # Stages that are not finished, and the generations that their journals know.
        tuple(
            (path.name, FileJournal(path).generations)
            for path in sorted((run.folder / JOURNAL).glob("*"))
            if path.is_dir() and path.name not in run.stages
        ),
        _fitted(run),
        read_event_files(folder),
        read_event_files(folder / BY_ROWS),
    )


def _an_object(path: Path) -> dict[str, Any]:
    data = read_json(path)
    if not isinstance(data, dict):
        raise RunError(f"{str(path)!r} holds no object; restore the file")
    return data


def _stage(run: StoredRun, name: str, accepted: dict[str, Any] | None) -> Stage:
    folder = run.folder / name
    solved, missed = load_scenarios(folder / "scenarios.json", run.like())
    skill = load_skill(folder / "skill.json", run.actions)
    result = load_result(folder / "result.json")
    for test in ("fresh", "overall"):  # which a robot is not asked for
        result[test] = result.get(test) or {"scenarios": run.kind, "tried": 0, "succeeded": 0}
    return Stage(name, result, skill, solved, missed, accepted)


def _fitted(run: StoredRun) -> Fitted | None:
    """The latest reports of the models; a run may have been copied without models."""
    for name in (*reversed(run.stages), START):
        folder = run.folder / name
        if (folder / GAMMA).is_file() and (folder / CLASSIFIER).is_file():
            _, _, gamma, classifier = load_models(folder, run.models.unfitted())
            if not (_sound_gamma(gamma) and _sound_classifier(classifier)):
                raise RunError(f"a report of the models in {str(folder)!r} is damaged; restore it")
            return Fitted(name, gamma, classifier)
    return None


def _sound_gamma(report: TransitionReport) -> bool:
    columns = report.coordinates, report.units, report.error, report.baseline_error
    return (
        _fits(report, TransitionReport)
        and len({*map(len, columns)}) == 1
        and _sound_curve(report.learning_curve)
    )


def _sound_classifier(report: SuccessReport) -> bool:
    return (
        _fits(report, SuccessReport)
        and all(0 <= mean <= 1 and 0 <= often <= 1 for mean, often, _ in report.reliability)
        and all(rows >= 1 for *_, rows in report.reliability)
        and _sound_curve(report.learning_curve)
    )


def _sound_curve(curve: LearningCurve | None) -> bool:
    scores = () if curve is None else (curve.train_scores, curve.test_scores)
    return all(len(s) == len(curve.sizes) and all(s) for s in scores if curve)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value matches its annotation and has finite numbers."""
    origin, args = get_origin(kind), get_args(kind)
    if kind in (int, float):
        return type(value) in (int, kind) and abs(value) < 1e15
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind).items()
        return isinstance(value, kind) and all(_fits(getattr(value, n), h) for n, h in hints)
    if origin is UnionType:
        return any(_fits(value, one) for one in args)
    if origin is tuple and isinstance(value, tuple):
        wanted = args[:1] * len(value) if args[-1] is ... else args
        return len(value) == len(wanted) and all(map(_fits, value, wanted))
    return origin is list or (origin is None and isinstance(value, kind))
