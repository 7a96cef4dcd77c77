"""The log of a run: what happened, a line each, in RUN/log.jsonl.

Lines are JSON objects with `event` and `time` (s since 1970). Events of training:

    stage      stage, size_w, size_m
    models     stage, text, seconds
    asked      stage, phase, motions, tests, looks, episodes, succeeded
    practised  stage, skill, in_a_row, wanted
    chance     stage, succeeded, tried
    accepted   stage, skill, nodes, kept, lost, solved, seconds
    tested     stage, skill, succeeded, tried, target, decisive, mean_return

With a robot there is a line for each of its actions besides: `look` begins an episode, `action` is
a motion or a test with its percepts and outcome, and `episode` ends it (`cgtorch.domains.live`).
"""

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from cgtorch.ground.json_lines import JsonLines
from cgtorch.improvement import events


class LogWatch:
    """A `Watch` that writes events into a log; those from before an interruption are there."""

    def __init__(self, log: JsonLines):
        """A watch that appends to `log`."""
        self._log = log

    def __call__(self, event: events.Event) -> None:
        """Write an event, if it has a line."""
        if row := row_of(event):
            self._log.append({"time": round(time.time(), 3), **row})


def row_of(event: events.Event) -> Mapping[str, Any] | None:
    """The line of an event; None if it has none."""
    match event:
        case events.StageStarted():
            sizes = {"size_w": event.size_w, "size_m": event.size_m}
            return {"event": "stage", "stage": event.stage, **sizes}
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
