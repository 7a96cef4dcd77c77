"""Settings shared by command line, API and files. It imports no torch, so help appears at once."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar, TypeVar

from cgtorch.ground.errors import SettingsError

T = TypeVar("T")
MOST = 2**31 - 1
LAST = "last"
_ENDLESS = ("inf", "-inf")


def option(
    default: Any,
    text: str,
    fixed: str = "",
    *,
    choices: tuple[str, ...] = (),
    least: float = 1,
    most: float = MOST,
    also: tuple[int, ...] = (),
    when: str = "",
    before: Any = None,
) -> Any:
    """A dataclass field with a default and the help text of its command-line option.

    Args:
        default: The default, whose type is the option's.
        text: The help text.
        fixed: Why the setting cannot change once a run has begun; "" if it can.
        choices: The possible values of a text; any if empty.
        least: The least value of a number.
        most: The largest value of a number.
        also: Further whole numbers that are possible.
        when: When to change the setting.
        before: The value in runs that began before the setting existed.
    """
    about = {
        "help": text, "fixed": fixed, "choices": choices, "least": least, "most": most,
        "also": also, "when": when, "before": before,
    }  # fmt: skip
    return field(default=default, metadata=about)


def check_options(settings: Any) -> None:
    """SettingsError if a field made by `option` has an impossible value."""
    for f in fields(settings):
        value, about = getattr(settings, f.name), f.metadata
        least, most = about.get("least", 1), about.get("most", MOST)
        said = f"is {value!r:.40}"
        if isinstance(f.default, int):
            also = about.get("also", ())
            usable = type(value) is int and (least <= value <= most or value in also)
            above = type(value) is int and value > most
            bound = f"at most {most}" if above else f"at least {least}"
            wanted = " or ".join([f"give a whole number of {bound}", *map(str, also)])
        elif isinstance(f.default, float):  # no comparison holds for nan
            usable = type(value) in (int, float) and least <= value <= most
            wanted = f"give a number from {least} to {most}"
        elif isinstance(f.default, str):
            choices = about.get("choices", ())
            usable = isinstance(value, str) and (not choices or value in choices)
            wanted = f"use one of {', '.join(choices)}" if choices else "give a text"
        else:
            usable = isinstance(value, tuple) and all(isinstance(one, str) for one in value)
            said, wanted = f"are {value!r:.60}", "give names in a tuple"
        if not usable:
            raise SettingsError(f"{f.name} {said}; {wanted}")


@dataclass(frozen=True)
class DomainSettings:
    """The settings of a domain without any; others are frozen dataclasses of `option`s.

    SettingsError for a value that cannot work.

    Attributes:
        run_defaults: The domain's own defaults of settings that every run has.
        usual_stage: The stage that `cgtorch-train` makes by default, or `LAST` for the last one.
    """

    run_defaults: ClassVar[Mapping[str, Any]] = {}
    usual_stage: ClassVar[str] = "auto"

    def __post_init__(self) -> None:
        """Check every value."""
        check_options(self)


def to_plain(settings: Any) -> dict[str, Any]:
    """Settings as plain data for a file; numbers that are not finite become texts."""
    return {name: _plain(value) for name, value in asdict(settings).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return list(value) if isinstance(value, tuple) else value


def from_plain(kind: type[T], data: Any) -> T:
    """Settings from the data of `to_plain`; SettingsError if one is unknown, missing or wrong."""
    names = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    if isinstance(data, dict):
        before = {name: f.metadata.get("before") for name, f in names.items()}
        data = {**{name: value for name, value in before.items() if value is not None}, **data}
    if not isinstance(data, dict):
        raise SettingsError(f"settings are {data!r:.40}, so each is unknown or missing; give all")
    if set(data) != set(names):
        odd = sorted(set(names) ^ set(data))[0]
        raise SettingsError(f"setting {odd!r} is unknown or missing; is this run of this version?")
    values = dict(data)
    for name, value in data.items():
        default = names[name].default
        if isinstance(default, float) and value in _ENDLESS:
            values[name] = float(value)
        elif isinstance(default, tuple) and isinstance(value, list):
            values[name] = tuple(value)
    return kind(**values)
