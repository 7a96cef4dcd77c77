"""Resuming a run with other settings or another version: what may change, and its history.

A run keeps the settings with which it began. Settings that only control the search can be changed
by name. Settings on which existing results depend cannot. Finished stages stay as they are. An
unfinished stage is repeated from its beginning, since a stage under mixed settings could not be
reproduced. Its unfinished work is set aside, not deleted.

run.json records all changes, oldest first:

    "history": [{"before": "S2", "changed": {"population": [400, 600]}, "set_aside": "set-aside/1"}]
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from cgtorch.domains.settings import to_plain
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.ground.files import read_json, write_json, writing
from cgtorch.runs.journal import FOLDER
from cgtorch.runs.settings import NAMES, RunSettings, all_fields, option_of
from cgtorch.runs.stored_run import AUTO, StoredRun, round_name, versions

ASIDE = "set-aside"


@dataclass(frozen=True)
class TakenOver:
    """A run with its present settings, and the stage or round `before` which they changed.

    `changed` contains old and new values by name: settings, cgtorch, torch. `set_aside` is the
    folder of the old journal within the run, or None.
    """

    run: StoredRun
    changed: Mapping[str, tuple[Any, Any]]
    before: str
    set_aside: str | None


def refuse_others(run: StoredRun, given: Mapping[str, Any], how: str) -> None:
    """SettingsError if a given setting differs from the run's; `how` says what to do instead."""
    fixed, known = fixed_settings(run), run.all_settings()
    for name, value in given.items():
        if not _differs(value, was := known[name]):
            continue
        told = list(value) if isinstance(value, tuple) else value
        about = f"run {str(run.folder)!r} has {name} {was}, not {told}"
        if name in fixed:
            raise SettingsError(f"{about}, and cannot change it, as {fixed[name]}; {how}")
        raise SettingsError(
            f"{about}; {how}, or take it over with Run.resume({name}={value!r}), or --resume "
            f"{run.folder} --override {option_of(name)[2:]}={value}"
        )


def _differs(value: Any, plain: Any) -> bool:
    """Whether a setting differs from its value as plain data."""
    return (list(value) if isinstance(value, tuple) else value) != plain


def fixed_settings(run: StoredRun) -> dict[str, str]:
    """Settings that cannot be changed, by name, and why."""
    own = {f.name: "the domain was made with it" for f in fields(run.domain.settings)}
    every = all_fields(type(run.domain.settings))
    return own | {f.name: f.metadata["fixed"] for f in every if f.metadata["fixed"]}


def overridden(run: StoredRun, overrides: Mapping[str, Any]) -> RunSettings:
    """The run's settings with `overrides`; SettingsError if one is fixed or cannot work."""
    fixed, known = fixed_settings(run), run.all_settings()
    for name, value in overrides.items():
        if name in fixed and _differs(value, known[name]):
            raise SettingsError(
                f"{name} {known[name]} of run {str(run.folder)!r} cannot become "
                f"{value}, as {fixed[name]}; begin another run for it"
            )
    return replace(run.settings, **{k: v for k, v in overrides.items() if k in NAMES})


def take_over(run: StoredRun, settings: RunSettings, stage: str) -> TakenOver:
    """Continue under these settings with this version of the library, and record the changes.

    A journal from other settings or another version is set aside first. So an interruption at any
    point can at most repeat the stage under the old settings.
    """
    about = read_json(run.folder / "run.json")
    old, new = to_plain(run.settings), to_plain(settings)
    changed = {name: (old[name], new[name]) for name in old if old[name] != new[name]}
    current = {**versions(), **run.files.made_with()}
    changed |= {k: (about.get(k), v) for k, v in current.items() if about.get(k) != v}
    before = _next(run, stage)
    if not changed:
        return TakenOver(run, {}, before, None)
    history = about.get("history", [])
    if not isinstance(history, list):
        raise RunError(f"history in {str(run.folder / 'run.json')!r} is no list; restore the file")
    stale = set(changed) - {"torch", "engine"} and (run.folder / FOLDER).is_dir()
    names = (f"{ASIDE}/{i}" for i in itertools.count(1))
    aside = next(name for name in names if not (run.folder / name).exists()) if stale else None
    ranks.wait()  # all have read before anyone writes
    if ranks.first():
        entry: dict[str, Any] = {"before": before, "changed": {k: [*v] for k, v in changed.items()}}
        if aside is not None:
            with writing(run.folder / ASIDE):
                (run.folder / ASIDE).mkdir(exist_ok=True)
                (run.folder / FOLDER).rename(run.folder / aside)
            entry["set_aside"] = aside
        now = {**about, **current, "settings": new, "history": [*history, entry]}
        write_json(run.folder / "run.json", now)
    ranks.wait()
    return TakenOver(replace(run, settings=settings), changed, before, aside)


def _next(run: StoredRun, stage: str) -> str:
    """The next stage or round that a run makes when asked for a stage."""
    missing = [name for name in run.domain.stages if name not in run.stages]
    if stage == AUTO or run.rounds or not missing:
        return round_name(len(run.rounds) + 1)
    return missing[0]


def goes_on_to(run: StoredRun) -> dict[str, Any]:
    """What the run was last asked for: the stage, and the goal of "auto"; {} if nothing yet."""
    found = read_json(run.folder / "run.json").get("goes_on_to", {})
    if not isinstance(found, dict):
        raise RunError(f"goes_on_to of {str(run.folder / 'run.json')!r} is no object; restore it")
    return found


def remember_goal(run: StoredRun, wanted: Mapping[str, Any]) -> None:
    """Record in run.json what the run is asked for, on the first rank only."""
    if ranks.first() and goes_on_to(run) != wanted:
        about = read_json(run.folder / "run.json")
        write_json(run.folder / "run.json", {**about, "goes_on_to": dict(wanted)})
    ranks.wait()
