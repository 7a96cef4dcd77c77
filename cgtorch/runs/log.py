"""The log of a run: what happened, a line each, in RUN/log.jsonl.

Lines are JSON objects with `event` and `time` (s since 1970). Events of training:

    stage      stage, size_w, size_m
    models     stage, text, seconds
    generation stage, candidate, generation, best, mean, nodes, transitions, seconds, and as below
    candidate  stage, candidate, solved_w, size_w, solved_m, size_m
    asked      stage, phase, motions, tests, looks, episodes, succeeded
    practised  stage, skill, in_a_row, wanted
    chance     stage, succeeded, tried
    accepted   stage, skill, nodes, kept, lost, solved, seconds
    tested     stage, skill, succeeded, tried, target, decisive, mean_return

`best` and `mean` are null where nothing counts. A generation that was computed again after an
interruption is there twice; `rows_of` gives the last one.

With a robot there is a line for each of its actions besides: `look` begins an episode, `action` is
a motion or a test with its percepts and outcome, and `episode` ends it (`cgtorch.domains.robot`).
"""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Self

from cgtorch.evolution.fitness import WORTHLESS
from cgtorch.ground.files import JsonLines
from cgtorch.improvement import events

SOON = 1.0  # s after which generations are written


class LogWatch:
    """A `Watch` that writes events into a log; those from before an interruption are there.

    Generations are written together within `SOON` seconds, or with the next event of another kind,
    as each line that reaches the disk takes a millisecond. As a context it writes the last ones.
    """

    def __init__(self, log: JsonLines):
        """A watch that appends to `log`."""
        self._log, self._waiting = log, list[dict[str, Any]]()

    def __call__(self, event: events.Event) -> None:
        """Write an event, if it has a line."""
        if row := row_of(event):
            self._waiting.append({"time": round(time.time(), 3), **row})
        several = isinstance(event, events.GenerationDone) and self._waiting
        if not several or time.time() - self._waiting[0]["time"] > SOON:
            self._write()

    def __enter__(self) -> Self:
        """The watch itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Write what waits."""
        self._write()

    def _write(self) -> None:
        waiting, self._waiting = self._waiting, []
        self._log.append(*waiting)


def rows_of(log: JsonLines) -> list[dict[str, Any]]:
    """All rows in order, without generations that were computed again later."""
    found: dict[object, dict[str, Any]] = {}
    for number, row in enumerate(log.rows()):
        again = row.get("event") == "generation"
        key = (row["stage"], row["candidate"], row["generation"]) if again else number
        found.pop(key, None)
        found[key] = row
    return list(found.values())


def row_of(event: events.Event) -> Mapping[str, Any] | None:
    """The line of an event; None if it has none."""
    match event:
        case events.StageStarted():
            sizes = {"size_w": event.size_w, "size_m": event.size_m}
            return {"event": "stage", "stage": event.stage, **sizes}
        case events.GenerationDone():
            return {"event": "generation", **_generation(event), **_counts(event)}
        case events.WorldTested():
            return {"event": "candidate", **_counts(event)}
        case events.ModelsFitted():
            about = {"text": event.summary.text, "seconds": round(event.seconds, 3)}
            return {"event": "models", "stage": event.stage, **about}
        case events.WorldAsked() if not event.recalled:
            about = {"stage": event.stage, "phase": event.phase, "succeeded": event.succeeded}
            return {"event": "asked", **about, **asdict(event.asked)}
        case events.Practised():
            about = {"stage": event.stage, "skill": event.skill.name}
            return {
                "event": "practised",
                **about,
                "in_a_row": event.in_a_row,
                "wanted": event.wanted,
            }
        case events.ChanceFound():
            return {"event": "chance", **asdict(event)}
        case events.FreshTested():
            return {"event": "tested", **asdict(event)}
        case events.SkillAccepted():
            kept = event.succeeded[event.keep]
            counts = {"kept": int(kept.sum()), "lost": int((~kept).sum())}
            solved = int(event.succeeded[~event.keep].sum())
            size = {"nodes": event.skill.num_nodes, "seconds": round(event.seconds, 3)}
            about = {"stage": event.stage, "skill": event.skill.name}
            return {"event": "accepted", **about, **size, **counts, "solved": solved}
    return None


def _counts(event: events.CandidateTested) -> dict[str, Any]:
    """How much of W and M a candidate solves."""
    names = "stage", "candidate", "solved_w", "size_w", "solved_m", "size_m"
    return {name: getattr(event, name) for name in names}


def _generation(event: events.GenerationDone) -> dict[str, Any]:
    """What a generation came to."""
    found = event.generation
    fitness = found.fitness.cpu()
    counts = fitness[fitness > WORTHLESS].double()
    return {
        "generation": found.number,
        "best": _finite(found.best if found.best > WORTHLESS else math.nan),
        "mean": _finite(float(counts.mean())),
        "nodes": int(found.champion.graphs.num_nodes[0]),
        "transitions": found.transitions,
        "seconds": round(event.seconds, 4),
    }


def _finite(number: float) -> float | None:
    """The number, None if it is not finite, which JSON cannot say."""
    return number if math.isfinite(number) else None
