"""The commands that make a run again."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from cgtorch.experiments.goal import AUTO, Goal
from cgtorch.experiments.run import Run
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.stages import STAGES
from cgtorch.experiments.takeover import option_of
from cgtorch.kinematics import robots_folder

AGAIN = "runs/again"
ENGINE, OLD_ENGINE = "engine", "torch"
"""What computes in a run, and what did before there was another and runs said so."""


def changes_of(about: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """What a run went on with otherwise than before, oldest first.

    Args:
        about: its run.json.

    Returns:
        The stage that was made next, the setting or version, its old and its new value; entries
        that are none are left out.
    """
    history = about.get("history", [])
    found = []
    for entry in history if isinstance(history, list) else []:
        changed = entry.get("changed") if isinstance(entry, dict) else None
        for name, values in changed.items() if isinstance(changed, dict) else ():
            if isinstance(values, list) and len(values) == 2:
                found.append((str(entry.get("before")), name, *map(str, values)))
    return found


def training_commands(run: Run, about: Mapping[str, Any], summary: Mapping[str, Any]) -> list[str]:
    """The commands that train the run again, from nothing.

    What was taken over on the way is taken over at the same place.

    Args:
        run: that is to be made again.
        about: its run.json.
        summary: its summary.json, which knows the goal of `--stage auto`; empty if there is none.
    """
    names = {ENGINE, *(f.name for f in fields(RunSettings))}
    taken = [c for c in changes_of(about) if c[1] in names]
    at_first = {name: old for _, name, old, _ in reversed(taken)}
    engine = at_first.get(ENGINE, str(about.get(ENGINE, OLD_ENGINE)))
    legs = _legs(run, summary, [before for before, *_ in taken])
    commands = []
    for number, (words, before) in enumerate(legs):
        here = [(name, new) for place, name, _, new in taken if number and place == before]
        engine = dict(here).get(ENGINE, engine)
        overrides = [
            f"--override {shlex.quote(f'{name}={new}')}" for name, new in here if name != ENGINE
        ]
        begin = [*_robot(run), *_settings(run, at_first), f"--run-dir {AGAIN}"]
        rest = [f"--resume {AGAIN}", *overrides] if number else begin
        program = ["CGTORCH_NATIVE=0"] * (engine == OLD_ENGINE) + ["cgtorch-train"]
        commands.append(" ".join([*program, *words, *rest]))
    return commands


def _legs(
    run: Run, summary: Mapping[str, Any], changed: Sequence[str]
) -> list[tuple[list[str], str | None]]:
    """Words for each stretch under the same settings, and before what it was changed."""
    stages = [name for name in run.stages if name in STAGES] or ([] if run.rounds else ["S0"])
    legs: list[tuple[list[str], str | None]] = []
    start: str | None = None
    for i, name in enumerate(stages):
        if i == len(stages) - 1 or stages[i + 1] in changed:
            legs.append(([f"--stage {name}"], start))
            start = stages[i + 1] if i + 1 < len(stages) else None
    if run.rounds:
        goal = [
            f"{option_of(f.name)} {summary[f.name]}"
            for f in fields(Goal)
            if type(summary.get(f.name)) in (int, float) and f.name != "rounds"
        ]
        words = [f"--stage {AUTO}", *goal]
        ends = [i for i, name in enumerate(run.rounds) if i and name in changed]
        for i, end in zip([0, *ends], [*ends, len(run.rounds)], strict=True):
            before = run.rounds[i] if run.rounds[i] in changed else None
            legs.append(([*words, f"--rounds {end}"], before))
    return legs


def _settings(run: Run, at_first: Mapping[str, str]) -> list[str]:
    """The options of all settings that are not the default."""
    words = []
    for f in fields(RunSettings):
        value = getattr(run.settings, f.name)
        if f.name == "actions":
            words += [f"--actions {shlex.quote(name)}" for name in value]
        elif f.name == "seed" or at_first.get(f.name, str(value)) != str(f.default):
            words.append(f"{option_of(f.name)} {shlex.quote(at_first.get(f.name, str(value)))}")
    return words


def _robot(run: Run) -> list[str]:
    """The options of a robot that is not the built-in one."""
    own, built_in = run.folder / "robot", robots_folder() / "pr2"
    pairs = (("robot.urdf", "pr2.urdf"), ("robot.json", "robot.json"))
    if all((own / a).read_bytes() == (built_in / b).read_bytes() for a, b in pairs):
        return []
    where = run.folder.resolve().name
    return [
        f"--urdf {shlex.quote(f'{where}/robot/robot.urdf')}",
        f"--robot {shlex.quote(f'{where}/robot/robot.json')}",
    ]
