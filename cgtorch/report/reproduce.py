"""The commands that make a run again."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from cgtorch.domains.domain import rewarded
from cgtorch.domains.registry import with_name
from cgtorch.runs.log import Row
from cgtorch.runs.settings import Goal, all_fields, defaults_of, option_of
from cgtorch.runs.stored_run import AUTO, StoredRun

AGAIN = "runs/again"
ENGINE, TORCH = "engine", "torch"
"""The name of the engine in run.json, and its value if nothing is compiled."""


def changes_of(log: Sequence[Row]) -> list[tuple[str, str, str, str]]:
    """For each change of a run, in order: the next stage, the name, the old and the new value."""
    return [
        (row["stage"], name, *map(str, values))
        for row in log
        if row["event"] == "changed"
        for name, values in row["changed"].items()
        if len(values) == 2
    ]


def training_commands(run: StoredRun, about: Mapping[str, Any], log: Sequence[Row]) -> list[str]:
    """The commands that train a run again, with the same changes of settings at the same stages."""
    names = {ENGINE, *run.all_settings()}
    taken = [c for c in changes_of(log) if c[1] in names]
    legs = _legs(run, log, [before for before, *_ in taken])
    # A stage begins again where settings change in its middle, so the first one has the new ones.
    first = legs[0][1] if legs else None
    at_first = {name: old for before, name, old, _ in reversed(taken) if before != first}
    engine = at_first.get(ENGINE, str(about.get(ENGINE)))
    commands = []
    for number, (words, before) in enumerate(legs):
        here = [(name, new) for place, name, _, new in taken if number and place == before]
        engine = dict(here).get(ENGINE, engine)
        words_of = (f"{name}={new}" for name, new in here if name != ENGINE)
        overrides = [f"--override {shlex.quote(one)}" for one in words_of]
        begin = [*_settings(run, at_first), f"--run-dir {AGAIN}"]
        rest = [f"--resume {AGAIN}", *overrides] if number else begin
        program = ["CGTORCH_NATIVE=0"] * (engine == TORCH) + ["cgtorch-train"]
        commands.append(" ".join([*program, *words, *rest]))
    return commands


def _legs(
    run: StoredRun, log: Sequence[Row], changed: Sequence[str]
) -> list[tuple[list[str], str | None]]:
    """The options of each part of a run under the same settings, and what changed before it."""
    own = list(run.domain.stages)
    stages = [name for name in run.stages if name in own] or ([] if run.rounds else own[:1])
    ended = ([row for row in log if row["event"] == "ended"] or [{}])[-1]
    goal = [
        f"{option_of(f.name)} {ended[f.name]}"
        for f in fields(Goal)
        if ended.get(f.name) not in (None, f.default)
        and f.name != "rounds"
        and not (rewarded(run.domain) and f.name == "target")
    ]
    made = [(name, [f"--stage {name}"]) for name in stages]
    made += [
        (name, [f"--stage {AUTO}", *goal, f"--rounds {count}"])
        for count, name in enumerate(run.rounds or ([] if own else [""]), 1)
    ]
    if ended.get("reached") and ended is log[-1]:
        made[-1][1].pop()  # it ends by itself after as many rounds
    legs: list[tuple[list[str], str | None]] = []
    for i, (name, words) in enumerate(made):
        if i in (0, len(stages)) or name in changed:
            legs.append((words, name if name in changed else None))
        else:
            legs[-1] = words, legs[-1][1]
    return legs


def _settings(run: StoredRun, at_first: Mapping[str, str]) -> list[str]:
    """The options of all settings that differ from the default."""
    own = type(run.domain.settings)
    stored = run.files.options(run.folder)
    values = {**run.all_settings(), **stored}
    usual = defaults_of(own)
    named = vars(with_name(run.settings.domain, own()))  # which the domain's name says already
    words = []
    for f in all_fields(own):
        value = str(values[f.name])
        default = str(usual.get(f.name, named.get(f.name)))
        if isinstance(f.default, tuple):
            said = tuple(values[f.name]) == named.get(f.name)
            each = () if said else values[f.name]
            words += [f"{option_of(f.name)} {shlex.quote(name)}" for name in each]
        elif f.name == "seed" or at_first.get(f.name, value) != default:
            name = "target" if f.name == "target_return" else f.name
            words.append(f"{option_of(name)} {shlex.quote(at_first.get(f.name, value))}")
    return words
