"""Which settings of a run can be changed after it has begun."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from cgtorch.ground.errors import SettingsError
from cgtorch.ground.files import as_word
from cgtorch.runs.settings import NAMES, RunSettings, all_fields, option_of
from cgtorch.runs.stored_run import StoredRun


def refuse_others(run: StoredRun, given: Mapping[str, Any], how: str) -> None:
    """SettingsError if a given setting differs from the run's; `how` says what to do instead."""
    fixed, known = fixed_settings(run), run.all_settings()
    for name, value in given.items():
        plain = list(value) if isinstance(value, tuple) else value
        if plain == (was := known[name]):
            continue
        about = f"run {str(run.folder)!r} has {name} {was}, not {plain}"
        if name in fixed:
            raise SettingsError(f"{about}, and cannot change it, as {fixed[name]}; {how}")
        raise SettingsError(
            f"{about}; {how}, or take it over with Run.resume({name}={value!r}), or --resume "
            f"{as_word(run.folder)} --override {option_of(name)[2:]}={value}"
        )


def fixed_settings(run: StoredRun) -> dict[str, str]:
    """Settings that cannot be changed, by name, and why."""
    own = {f.name: "the domain was made with it" for f in fields(run.domain.settings)}
    every = all_fields(type(run.domain.settings))
    return own | {f.name: f.metadata["fixed"] for f in every if f.metadata["fixed"]}


def overridden(run: StoredRun, overrides: Mapping[str, Any]) -> RunSettings:
    """The run's settings with `overrides`; SettingsError if one is fixed or cannot work."""
    fixed, known = fixed_settings(run), run.all_settings()
    for name, value in overrides.items():
        if name in fixed and (list(value) if isinstance(value, tuple) else value) != known[name]:
            raise SettingsError(
                f"{name} {known[name]} of run {str(run.folder)!r} cannot become "
                f"{value}, as {fixed[name]}; begin another run for it"
            )
    return replace(run.settings, **{k: v for k, v in overrides.items() if k in NAMES})
