"""The log of a run: what happened, one JSON object a line, in RUN/log.jsonl (docs/log.md)."""

import json
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.evolution.population import STRATEGY
from cgtorch.graphs import NO_NODE, Graphs, Skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NAMES as ASKED
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import JsonLines
from cgtorch.improvement import events

LOG = "log.jsonl"
SOON = 1.0  # s after which generations are written
SPREAD_EVERY = 20  # generations of one evolution between two spreads of strategy parameters
MIDDLE = (0.1, 0.9)  # quantiles between which a spread lies

Row: TypeAlias = dict[str, Any]
Shape: TypeAlias = Any
"""The shape of a value: a type, [shape of all members], {key: shape} (with `str` as the key: of
all keys), or a tuple of shapes of which one fits. `float` is any finite number, at least 0 if it is
of `seconds`; `int` is a count."""

_SHARE = {"succeeded": int, "tried": int}
_SCORE = (
    {"scenarios": str, "mean_return": (float, None), "error": (float, None), **_SHARE}, None
)  # fmt: skip
_CANDIDATE = {
    "stage": str, "candidate": str,
    "solved_w": int, "size_w": int, "solved_m": int, "size_m": int,
}  # fmt: skip
_CURVE = ({"sizes": [float], "train_scores": [[float]], "test_scores": [[float]]}, None)
_CHOICE = {"C": float, "gamma": float, "epsilon": float}
_GAMMA = {
    "rows": int, "informative": int, "coordinates": [str], "units": [str], "error": [float],
    "baseline_error": [float], "choice": [(_CHOICE, None)], "centres": int,
    "learning_curve": _CURVE,
}  # fmt: skip
_CLASSIFIER = {
    "rows": int, "positive": float, "balanced_accuracy": float, "brier": float,
    "calibration_error": float, "reliability": [[float]], "choice": _CHOICE, "centres": int,
    "learning_curve": _CURVE,
}  # fmt: skip
_EPISODE = {"stage": str, "phase": str, "episode": int}
COLUMNS: dict[str, dict[str, Shape]] = {
    "stage": {"stage": str, "stages": [str], "size_w": int, "size_m": int, "attempts": int},
    "models": {
        "stage": str, "text": str, "first": bool, "seconds": float,
        "gamma": (_GAMMA, None), "classifier": (_CLASSIFIER, None),
    },
    "generation": _CANDIDATE | {
        "generation": int, "limit": int, "best": (float, None), "mean": (float, None),
        "low": (float, None), "high": (float, None), "unsolved": float, "nodes": int,
        "nodes_mean": float, "not_finite": int, "distinct_parents": int, "transitions": int,
        "executed": int, "seconds": float, "strategy": ({str: [float]}, None),
    },
    "recalled": {"stage": str, "candidate": str, "generations": int},
    "candidate": _CANDIDATE,
    "asked": {"stage": str, "phase": str, "succeeded": int, **dict.fromkeys(ASKED, int)},
    "practised": {"stage": str, "skill": str, "in_a_row": int, "wanted": int},
    "mean": {
        "stage": str, "skill": str, "new": bool, "mean": (float, None), "error": (float, None),
        "tried": int, "scenarios": int, "episodes": int,
    },
    "played": {
        "stage": str, "phase": str, "returned": (float, None), "steps": int, "total": int,
    },
    "chance": {"stage": str, **_SHARE},
    "accepted": {
        "stage": str, "skill": str, "parent": (str, None), "members": [str], "nodes": int,
        "depth": int, "w_before": int, "w_lost": int, "m_before": int, "m_solved": int,
        "targets": int, "targets_solved": int, "w_other_noise": (_SHARE, None), "seconds": float,
    },
    "tested": {
        "stage": str, "skill": str, "target": float, "decisive": bool,
        "mean_return": (float, None), "error": (float, None), **_SHARE,
    },
    "result": {
        "stage": str, "scenarios": str, "skill": str, "targets": int, "targets_succeeded": int,
        "earlier_failures": int, "earlier_failures_succeeded": int, "w_size": int, "w_lost": int,
        "nodes": int, "depth": int, "generations": int, "transitions": int, "seconds": float,
        "search_seconds": float, "asked": {str: dict.fromkeys(ASKED, int)}, "fresh": _SCORE,
        "overall": _SCORE, "decisive": _SCORE, "mean_holds": (bool, None), "in_a_row": (int, None),
        "practice": (int, None),
    },
    "failed": {"stage": str, "attempts": int},
    "damaged": {"stage": str, "files": [str]},
    "changed": {"stage": str, "changed": {str: list}, "set_aside": (str, None)},
    "ended": {
        "stage": str, "reached": (bool, None), "target": (float, None), "minutes": (float, None),
        "rounds": (int, None),
    },
    "look": _EPISODE | {"percept": [float]},
    "action": _EPISODE | {
        "what": str, "percept": [float], "control": ([float], None), "next": [float],
        "done": bool, "seconds": float, "error": (str, None),
    },
    "episode": _EPISODE | {"succeeded": bool, "left": [int]},
}  # fmt: skip
"""The columns of each kind of row, besides `event` and `time`; None is also for a missing one."""

LASTING = ("look", "action", "episode", "changed")
"""Rows that stay if their stage begins again: actions of a robot, and changes of settings."""
_TIMES = ("time", "seconds", "search_seconds")


class LogWatch:
    """A `Watch` that appends to the log of a run, on the first rank only.

    An interrupted run repeats events. Those that the log has already, but for times, are not
    written again. Generations are written together within `SOON` seconds, or before the next event
    of another kind, as each write takes a millisecond.
    """

    def __init__(self, folder: Path):
        """A watch that appends to the log in a run's folder."""
        self._folder, self._log = folder, JsonLines(folder / LOG)
        self._waiting = list[Row]()
        self._known: Counter[str] | None = None
        self._last = ""

    def __call__(self, event: events.Event) -> None:
        """Write an event, if it has a row and the log lacks it."""
        if not ranks.first():
            return
        row = row_of(event)
        if row is not None and not self._has(row):
            self._waiting.append({"event": row["event"], "time": round(time.time(), 3), **row})
        generation = isinstance(event, events.GenerationDone) and self._waiting
        if not generation or time.time() - self._waiting[0]["time"] > SOON:
            waiting, self._waiting = self._waiting, []
            self._log.append(*waiting)

    def _has(self, row: Row) -> bool:
        """Whether the row is in the log since before this process, which counts it off."""
        if self._known is None:
            every = [_identity(known) for known in read_log(self._folder)]
            self._known, self._last = Counter(every), (every or [""])[-1]
        name = _identity(row)
        found = name == self._last if row["event"] == "ended" else self._known[name] > 0
        self._known[name] -= found
        self._last = name
        return found


def _identity(row: Row) -> str:
    """The columns by which a row equals one from before an interruption."""
    if row["event"] == "generation":  # whose last digits may depend on the machine
        return f"generation {row['stage']} {row['candidate']} {row['generation']}"
    return json.dumps({name: row[name] for name in row if name not in _TIMES}, sort_keys=True)


def read_log(folder: Path) -> list[Row]:
    """All rows of the log of a run, in order, up to a line that is cut.

    Rows of a stage that began again under other settings are left out, except a robot's actions.
    RunError if a line is damaged.
    """
    rows = list[Row]()
    for number, row in enumerate(JsonLines(folder / LOG).rows(), 1):
        columns = COLUMNS.get(str(row.get("event")), {})
        for name, shape in {"event": str, "time": float, **columns}.items():
            negative = name.endswith("seconds") and fits(row.get(name), float) and row[name] < 0
            if negative or not fits(row.get(name), shape):
                raise RunError(
                    f"{name} in line {number} of {str(folder / LOG)!r} is {row.get(name)!r:.40}; "
                    "restore the file"
                )
        if row["event"] == "changed" and row["set_aside"]:
            rows = [r for r in rows if r["event"] in LASTING or r.get("stage") != row["stage"]]
        rows.append(row)
    return rows


def history_of(folder: Path) -> list[tuple[str, str]]:
    """The stages of a run that were made ("result") or found no skill ("failed"), in order."""
    found = list[tuple[str, str]]()
    kinds = (f'{{"event": "{name}"' for name in ("result", "failed", "changed"))
    for row in JsonLines(folder / LOG).rows(*kinds):
        event, stage = str(row["event"]), str(row.get("stage"))
        if event == "changed":
            found = [one for one in found if not (row.get("set_aside") and one[1] == stage)]
        else:
            found.append((event, stage))
    return found


def results_in(rows: Sequence[Row], stages: Sequence[str], folder: Path) -> list[Row]:
    """The result of each of the finished stages; RunError if the log in `folder` lacks one."""
    found = {row["stage"]: row for row in rows if row["event"] == "result"}
    if lacking := [name for name in stages if name not in found]:
        raise RunError(f"{str(folder / LOG)!r} has no result of {lacking[0]}; restore the file")
    times = ("event", "time")
    return [{k: v for k, v in found[name].items() if k not in times} for name in stages]


def fits(value: Any, shape: Shape) -> bool:
    """Whether a value from a file has a shape; succeeded of tried can be at most all."""
    if isinstance(shape, tuple):
        return any(fits(value, each) for each in shape)
    if isinstance(shape, list):
        return isinstance(value, list) and all(fits(each, shape[0]) for each in value)
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return False
        if str in shape:
            return all(fits(each, shape[str]) for each in value.values())
        at_most = "tried" not in shape or value.get("succeeded", 0) <= value.get("tried", 0)
        return at_most and all(fits(value.get(name), each) for name, each in shape.items())
    if shape is None:
        return value is None
    if shape is int:
        return type(value) is int and 0 <= value < 2**53
    if shape is float:
        return type(value) in (int, float) and abs(value) < 1e15
    return isinstance(value, shape)


def row_of(event: events.Event) -> Row | None:
    """The row of an event, without its time; None if it has none."""
    match event:
        case events.GenerationDone():
            return generation_row(event)
        case events.SkillAccepted():
            return _accepted(event)
        case events.StageFinished():
            return {"event": "result", **event.result}
        case events.ModelsFitted():
            summary = event.summary
            reports = {name: _plain(asdict(report)) for name, report in summary.reports.items()}
            about = {"text": summary.text, "first": summary.first, **reports}
            return {"event": "models", "stage": event.stage, **about, "seconds": event.seconds}
        case events.WorldAsked():
            about = {"stage": event.stage, "phase": event.phase, "succeeded": event.succeeded}
            return {"event": "asked", **about, **asdict(event.asked)}
        case events.EvolutionRecalled():
            about = {"stage": event.stage, "candidate": event.candidate}
            return {"event": "recalled", **about, "generations": event.found.generations}
    if (name := _NAMES.get(type(event))) is None:
        return None
    return {"event": name, **{column: _plain(value) for column, value in vars(event).items()}}


_NAMES: dict[type[events.Event], str] = {
    events.StageStarted: "stage",
    events.WorldTested: "candidate",
    events.Practised: "practised",
    events.MeanTested: "mean",
    events.EpisodePlayed: "played",
    events.ChanceFound: "chance",
    events.FreshTested: "tested",
    events.StageFailed: "failed",
    events.JournalDamaged: "damaged",
    events.TrainingEnded: "ended",
}
"""The kinds of rows that have the fields of an event as they are."""


def _accepted(event: events.SkillAccepted[Any]) -> Row:
    """The evidence for eq. 1: what was in W and M before, and what of it is solved."""
    kept, targets = event.keep, event.targets
    noise = event.other_noise
    return {
        "event": "accepted",
        "stage": event.stage,
        "skill": event.skill.name,
        "parent": event.parent,
        "members": list(event.skill.sub_skills),
        "nodes": event.skill.num_nodes,
        "depth": event.skill.depth,
        "w_before": int(kept.sum()),
        "w_lost": int((kept & ~event.succeeded).sum()),
        "m_before": int((~kept).sum()),
        "m_solved": int((~kept & event.succeeded).sum()),
        "targets": int(targets.sum()),
        "targets_solved": int((targets & event.succeeded).sum()),
        "w_other_noise": noise and {"tried": noise[1], "succeeded": noise[0]},
        "seconds": event.seconds,
    }


def generation_row(event: events.GenerationDone) -> Row:
    """The row of a generation; fitness and its spread are of individuals that count."""
    found = event.generation
    population, size = found.population, len(found.fitness)
    fitness = found.fitness.cpu().numpy()  # NumPy is twice as fast on arrays this small
    counts = fitness[fitness > WORTHLESS]
    low, high = np.quantile(counts, MIDDLE).tolist() if len(counts) else (None, None)
    spread = population.strategy.cpu().numpy() if found.number % SPREAD_EVERY == 0 else None
    return {
        "event": "generation",
        **{name: getattr(event, name) for name in _CANDIDATE},
        "generation": found.number,
        "limit": event.limit,
        "best": found.best if found.best > WORTHLESS else None,
        "mean": float(counts.mean(dtype=np.float64)) if len(counts) else None,
        "low": low,
        "high": high,
        "unsolved": (size - len(counts) + np.count_nonzero(counts == 0)) / size,
        "nodes": _nodes(found.champion.graphs),
        "nodes_mean": _nodes(population.graphs) / size,
        "not_finite": found.not_finite,
        "distinct_parents": found.distinct_parents,
        "transitions": found.transitions,
        "executed": found.executed,
        "seconds": round(event.seconds, 6),
        "strategy": None if spread is None else dict(zip(STRATEGY, spreads(spread), strict=True)),
    }


def spreads(values: NDArray[np.float32]) -> list[list[float]]:
    """The 10 % quantile, the mean and the 90 % quantile of each column of values (P, S)."""
    low, high = np.quantile(values, MIDDLE, axis=0)
    return np.stack([low, values.mean(0, dtype=np.float64), high], 1).round(6).tolist()


def _nodes(graphs: Graphs) -> int:
    """The total number of nodes of all graphs."""
    return int(np.count_nonzero(graphs.action.numpy() != NO_NODE))


def _plain(value: Any) -> Any:
    """A value as JSON: a skill by its name, reports without grids, None for what is not finite."""
    if isinstance(value, Skill):
        return value.name
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if not k.startswith("grid_")}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
