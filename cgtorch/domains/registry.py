"""Domains by name, checked before anything long begins; torch is imported only if needed."""

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import Field, fields, replace
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cgtorch.domains.settings import DomainSettings
from cgtorch.ground.errors import CgtorchError, DomainError, SettingsError

if TYPE_CHECKING:
    from cgtorch.domains.domain import Domain
    from cgtorch.domains.robot import RobotDriver

ENTRY_POINTS = "cgtorch.domains"
TABLETOP, GYMNASIUM = "tabletop", "gymnasium"
EXAMPLES = {
    GYMNASIUM: "gymnasium:CartPole-v1",
    "metaworld": "metaworld:push-v3",
    "gymnasium-robotics": "gymnasium-robotics:FetchPush-v4",
}
"""The domains whose names end with that of an environment."""
REWARD = "reward="
"""Begins the part of a name that is the function of given rewards."""
_SETTINGS = {
    TABLETOP: "cgtorch.tabletop.settings:TabletopSettings",
    GYMNASIUM: "cgtorch.domains.gymnasium_settings:GymnasiumSettings",
    "metaworld": "cgtorch.manipulation.settings:ManipulationSettings",
    "gymnasium-robotics": "cgtorch.manipulation.settings:FetchSettings",
}
_CLASSES = {
    TABLETOP: "cgtorch.tabletop.domain:Tabletop",
    GYMNASIUM: "cgtorch.domains.gymnasium:Gymnasium",
    "metaworld": "cgtorch.manipulation.domain:MetaWorld",
    "gymnasium-robotics": "cgtorch.manipulation.domain:Fetch",
}
"""The domains of the library by name."""
CONSTRUCTOR = "give it a constructor that needs no other arguments"
NOT_FOUND = "is it spelt right, and is its file in this folder, on PYTHONPATH or installed?"


def known_names() -> list[str]:
    """Names of the domains of the library and of installed packages."""
    return sorted({*_CLASSES, *(e.name for e in entry_points(group=ENTRY_POINTS))})


def is_code(spec: str) -> bool:
    """Whether a name has a "package.module:" that would be imported."""
    name, _, argument = spec.partition(":")
    return ":" in (argument if name in EXAMPLES else spec)


def domain_class(spec: str) -> type["Domain[Any]"]:
    """The class of a domain; DomainError if there is no such domain.

    `spec` is "tabletop", "gymnasium:ENV_ID" (see `with_name`), the name of an entry point of the
    group "cgtorch.domains" of an installed package, or "package.module:Class".
    """
    from cgtorch.domains.domain import Domain
    from cgtorch.domains.live import domain_of_driver
    from cgtorch.domains.robot import RobotDriver

    place = _CLASSES.get(spec.partition(":")[0], spec)
    declared = {e.name: e for e in entry_points(group=ENTRY_POINTS)}
    if ":" not in place and spec not in declared:
        raise DomainError(
            f"unknown domain {spec!r}; known are {', '.join(known_names())}, or give "
            f"'package.module:Class'{_of_gymnasium(spec)}"
        )
    entry = EntryPoint("domain", place, ENTRY_POINTS) if ":" in place else declared[spec]
    found = foreign(entry.load, f"cannot import domain {spec!r}", NOT_FOUND)
    if isinstance(found, type) and issubclass(found, RobotDriver):
        return domain_of_driver(found)
    if not (isinstance(found, type) and issubclass(found, Domain)):
        raise DomainError(f"domain {spec!r} is {found!r:.80}; give a subclass of cgtorch.Domain")
    return found


def _of_gymnasium(given: Any) -> str:
    """How an environment of Gymnasium is given, if it seems to be one: a name, object or class."""
    name = given if isinstance(given, str) else getattr(getattr(given, "spec", None), "id", None)
    environment = hasattr(given, "reset") and hasattr(given, "step")
    if not environment and not re.fullmatch(r"[\w./:-]+-v\d+", str(name)):
        return ""
    named = f"{GYMNASIUM}:{name:.60}" if isinstance(name, str) else EXAMPLES[GYMNASIUM]
    return f"; an environment of Gymnasium is given by its name, such as '{named}'"


def driver_of(spec: str) -> str:
    """The name of a domain if it is that of a driver, else ""."""
    from cgtorch.domains.live import DriverDomain

    return spec if is_code(spec) and issubclass(domain_class(spec), DriverDomain) else ""


def spec_of(domain: Any) -> "tuple[str, Domain[Any] | None]":
    """The name of a domain that is an object, a class or a name, and the object if it is given.

    DomainError for anything else.
    """
    from cgtorch.domains.domain import Domain
    from cgtorch.domains.robot import RobotDriver

    if isinstance(domain, str):
        return domain, None
    kind: Any = type(domain) if isinstance(domain, Domain) else domain
    if not (isinstance(kind, type) and issubclass(kind, Domain | RobotDriver)):
        raise DomainError(
            f"domain is {domain!r:.60}; give a name, a Domain or RobotDriver, or a class of one"
            f"{_of_gymnasium(domain)}"
        )
    spec = spec_of_class(kind)
    for name, place in _CLASSES.items():
        if place == spec:
            own = getattr(domain, "settings", None)
            spec = own.name if name in EXAMPLES and own else name
    module, _, name = spec.partition(":")
    script = getattr(sys.modules["__main__"], "__file__", None)
    if module == "__main__" and script and issubclass(kind, Domain):
        spec = f"{Path(script).stem}:{name}"  # by which other programs import it
    if isinstance(domain, Domain):
        return spec, domain
    if issubclass(kind, Domain) and (module == "__main__" or "<locals>" in name):
        return spec, kind()  # the name would run the program again, or find nothing
    return spec, None


def spec_of_class(kind: Any) -> str:
    """The name "package.module:Class" of a class; a name stays as it is."""
    return kind if isinstance(kind, str) else f"{kind.__module__}:{kind.__qualname__}"


def specs_of(actions: Any) -> tuple[str, ...]:
    """The names of actions that are given as names or classes; SettingsError for anything else."""
    said = f"actions is {actions!r:.60}; give a list of names or classes, such as [Wait]"
    if isinstance(actions, str):
        raise SettingsError(
            f"actions is the text {actions!r:.60}, not a list of names; give a list, such as "
            f"[{actions!r:.60}]"
        )
    if not isinstance(actions, Iterable):
        raise SettingsError(said)
    given = tuple(actions)
    if not all(isinstance(each, str | type) for each in given):
        raise SettingsError(said)
    return tuple(map(spec_of_class, given))


def make_driver(spec: str) -> "RobotDriver":
    """The driver of a robot, "package.module:Class"; DomainError if there is none."""
    from cgtorch.domains.robot import RobotDriver

    if ":" not in spec:
        raise DomainError(f"driver {spec!r:.60} is no name; give package.module:Class")
    entry = EntryPoint("driver", spec, ENTRY_POINTS)
    found = foreign(entry.load, f"cannot import driver {spec!r}", NOT_FOUND)
    if not (isinstance(found, type) and issubclass(found, RobotDriver)):
        raise DomainError(f"driver {spec!r} is {found!r:.80}; give a subclass of RobotDriver")
    if missing := sorted(getattr(found, "__abstractmethods__", ())):
        raise DomainError(f"driver {spec!r} lacks {' and '.join(missing)}; implement it")
    made: RobotDriver = foreign(found, f"driver {spec!r} cannot be made", CONSTRUCTOR)
    return made


def settings_class(spec: str) -> type[DomainSettings]:
    """The class of a domain's settings; DomainError if it is none, and see `domain_class`."""
    name = spec.partition(":")[0]
    if name in _SETTINGS:
        known: type[DomainSettings] = EntryPoint("settings", _SETTINGS[name], ENTRY_POINTS).load()
        return known
    domain = domain_class(spec)
    found, declared = domain.settings_type, vars(domain).get("__annotations__", {}).get("settings")
    if declared is not None and found is DomainSettings:
        raise DomainError(
            f"domain {spec!r} declares its settings but has no settings_type; give it both, as in "
            "settings_type = WindySettings"
        )
    settings = isinstance(found, type) and issubclass(found, DomainSettings)
    if not settings or any(isinstance(value, Field) for value in vars(found).values()):
        raise DomainError(
            f"domain {spec!r} has settings_type {found!r:.80}; give a subclass of "
            "cgtorch.DomainSettings that is decorated with @dataclass(frozen=True)"
        )
    return found


def make_domain(spec: str, settings: DomainSettings | None = None) -> "Domain[Any]":
    """A domain with these settings, or a DomainError; "gymnasium:ENV_ID" names its environment."""
    kind = domain_class(spec)
    settings = with_name(spec, kind.settings_type() if settings is None else settings)
    if missing := sorted(getattr(kind, "__abstractmethods__", ())):
        raise DomainError(
            f"domain {spec!r}: class {kind.__name__} lacks {' and '.join(missing)}; implement it "
            "as cgtorch.Domain describes"
        )
    failure = f"domain {spec!r} cannot be made as {kind.__name__}(settings)"
    return foreign(lambda: kind(settings), failure, CONSTRUCTOR)


def with_name(spec: str, settings: DomainSettings) -> DomainSettings:
    """The settings with what follows the colon of the domain's name.

    For Gymnasium this is ENV_ID or module:ENV_ID, and "+module:function" for each wrapper, and
    "+reward=module:function" for given rewards.
    """
    name, _, argument = spec.partition(":")
    if name not in EXAMPLES:
        return settings
    environment, *parts = argument.split("+")
    wrappers = [part for part in parts if not part.startswith(REWARD)]
    rewards = [part.removeprefix(REWARD) for part in parts if part.startswith(REWARD)]
    usual = hasattr(settings, "wrappers")
    pattern = r"([\w.]+:)?[\w./-]+" if usual else r"[\w.-]+"
    if not re.fullmatch(pattern, environment) or (parts and not usual):
        raise DomainError(
            f"domain {spec!r} names no environment; give {name}:NAME, such as {EXAMPLES[name]}"
        )
    named: Any = replace(settings, environment=environment)  # type: ignore[call-arg]
    if wrappers and named.wrappers not in ((), tuple(wrappers)):
        raise DomainError(
            f"domain {spec!r} names other wrappers than {', '.join(named.wrappers)}; give them once"
        )
    if rewards and named.reward not in ("", rewards[0]):
        raise DomainError(f"domain {spec!r} names another reward than {named.reward}; give it once")
    code: dict[str, Any] = {"wrappers": tuple(wrappers)} if wrappers else {}
    code |= {"reward": rewards[0]} if rewards else {}
    found: DomainSettings = replace(named, **code)
    return found


def full_name(spec: str, settings: DomainSettings) -> str:
    """The domain's name with all code that its settings import, which a run file must not hide.

    The settings are those of `with_name`.
    """
    return str(getattr(settings, "name", spec)) if spec.partition(":")[0] in EXAMPLES else spec


def check_name(spec: str, settings: DomainSettings) -> None:
    """DomainError if the settings of a run are not of the domain that it names."""
    if (full := full_name(spec, settings)) != spec:
        raise DomainError(
            f"a run about domain {spec!r} has settings of {full!r}; restore its run.json"
        )


def check_options(spec: str, names: Sequence[str]) -> None:
    """DomainError if a domain has a setting of every run, or a default for none of them.

    `names` are those of the settings that every run has.
    """
    settings = settings_class(spec)
    for f in fields(settings):
        if f.name in names:
            raise DomainError(
                f"domain {spec!r} has a setting {f.name!r}, which every run has; rename it"
            )
    for name in settings.run_defaults:
        if name not in names:
            close = " or ".join(map(repr, get_close_matches(name, names))) or "a setting of a run"
            raise DomainError(f"domain {spec!r} has run_defaults for {name!r}; name {close}")


def foreign(call: Callable[[], Any], failure: str, advice: str) -> Any:
    """The result of user code, or a DomainError for any exception.

    Advice on what was named or called is given unless the exception comes from within.
    """
    from cgtorch.ground.own_modules import INSIDE, as_module, is_relative

    try:
        return as_module(call)
    except CgtorchError:
        raise
    except Exception as e:
        from cgtorch.ground.dry_run import failed_at, reason

        place = failed_at(e)
        own = ImportError | AttributeError if advice == NOT_FOUND else TypeError
        inside = (advice == CONSTRUCTOR and place) or not isinstance(e, own)
        if inside and advice in (CONSTRUCTOR, NOT_FOUND):
            advice = "correct that first"
        if is_relative(e):
            advice = INSIDE
        raise DomainError(f"{failure} ({reason(e)}){place}; {advice}") from e
