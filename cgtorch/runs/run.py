"""A run: a folder that holds everything it was made with and everything it produced.

run.json            format, versions, domain, settings, what it goes on to, what was changed when
robot/ …            what the domain keeps, such as the tabletop its robot
start/              what was known before the first stage: data, Γ, C
S0/ S1/ …           each finished stage: skill, W and M, data, Γ, C, specialists, result
auto-1/ auto-2/ …   each finished round of --stage auto: the same
journal/            of the stage or round that is not finished: all it has come to so far
set-aside/          journals of stages that were begun again, as settings or the version changed
ledger/             every accepted skill, with the evidence for eq. 1
summary.json        the final table
events.out.…        TensorBoard
"""

import itertools
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from cgtorch import native
from cgtorch.actions import ActionSet, check_action, resolve_actions
from cgtorch.domains.check import check_domain
from cgtorch.domains.domain import Domain
from cgtorch.domains.registry import (
    check_options,
    domain_class,
    is_code,
    make_domain,
    settings_class,
)
from cgtorch.domains.settings import from_plain, to_plain
from cgtorch.environment import ScenarioBatch
from cgtorch.ground.errors import ActionError, DomainError, RunError, SettingsError
from cgtorch.ground.files import read_versioned, whole_folder, write_json, writing
from cgtorch.ground.version import __version__
from cgtorch.runs.settings import NAMES, RunSettings

FORMAT, VERSION = "cgtorch-run", 2
AUTO = "auto"
"""What is asked for instead of a stage to have rounds, auto-1, auto-2, …, until a goal is met."""


@dataclass(frozen=True)
class Run:
    """An open run: where it is, what it is made with and about, and the primitive actions."""

    folder: Path
    settings: RunSettings
    domain: Domain[Any]
    actions: ActionSet

    @property
    def kind(self) -> str:
        """The kind of scenarios that it is about."""
        return kind_of(self.settings, self.domain)

    @property
    def stages(self) -> tuple[str, ...]:
        """The finished stages, in order, up to the first that is missing, then the rounds."""
        return (*itertools.takewhile(self._finished, self.domain.stages), *self.rounds)

    @property
    def rounds(self) -> tuple[str, ...]:
        """The finished rounds of `--stage auto`, in order."""
        return tuple(itertools.takewhile(self._finished, map(round_name, itertools.count(1))))

    @property
    def learns(self) -> bool:
        """Whether its skills are evolved in Γ and C, and not in the world itself."""
        chosen = self.settings.models
        return (self.domain.models if chosen == "auto" else chosen) == "learned"

    def like(self) -> ScenarioBatch:
        """No scenarios, but of the kind that the run is about."""
        return self.domain.draw(self.kind, 0, torch.Generator())

    def all_settings(self) -> dict[str, Any]:
        """Its settings and its domain's, by name, as plain data."""
        return {**to_plain(self.settings), **to_plain(self.domain.settings)}

    def _finished(self, stage: str) -> bool:
        return (self.folder / stage / "skill.json").is_file()


def round_name(number: int) -> str:
    """The name of a round, from 1, and of the skill it makes."""
    return f"{AUTO}-{number}"


def kind_of(settings: RunSettings, domain: Domain[Any]) -> str:
    """The kind of scenarios that a run is about."""
    return domain.usual_kind if settings.scenarios == "auto" else settings.scenarios


def versions() -> dict[str, str]:
    """What the last digits of a run's numbers depend on besides its settings, by name."""
    engine = "compiled" if native.available() else "torch"
    return {"cgtorch": __version__, "torch": str(torch.__version__), "engine": engine}


def planned_run(
    folder: Path, settings: RunSettings, domain_settings: Any = None, anew: bool = False
) -> Run:
    """A run as `write_run` would begin it in an empty or new folder; nothing is written.

    The domain's settings are the defaults if not given; `anew` if the folder has `only_begun`.

    Raises:
        DomainError: the domain cannot be made, or breaks its interface.
        ActionError: an action cannot be found.
        RunError: the folder cannot be written or holds other things.
    """
    check_options(settings.domain, NAMES)
    domain = make_domain(settings.domain, domain_settings)
    run = _checked(folder, settings, domain)
    if not anew and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RunError(f"{str(folder)!r} is not empty and holds no run; choose another folder")
    if folder.resolve() == Path.cwd():
        raise RunError("a run cannot replace the current folder; choose another, such as runs/one")
    return run


def only_begun(folder: Path) -> bool:
    """Whether a run has made nothing yet, and so would lose nothing under other settings."""
    return all(p.name == "run.json" or ".tfevents." in p.name for p in folder.iterdir())


def write_run(run: Run) -> None:
    """Write the folder of a planned run; RunError if it cannot be written."""
    folder = run.folder
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
    about = {
        "format": FORMAT,
        "version": VERSION,
        **versions(),
        **run.domain.made_with(),
        "settings": to_plain(run.settings),
        "domain_settings": to_plain(run.domain.settings),
    }
    with nullcontext(folder) if (folder / "run.json").exists() else whole_folder(folder) as new:
        run.domain.write(new)
        write_json(new / "run.json", about)


def open_run(folder: Path, trusted: Sequence[str] = (), domain: str | None = None) -> Run:
    """Open a run.

    Args:
        folder: where it is.
        trusted: "package.module:Class" of actions that may be imported. What a file names is not
            imported just because the file says so.
        domain: the same of the domain; None for one that is not code of its own.

    Raises:
        RunError: there is none, or it is of another version, or damaged.
        DomainError: its domain is not trusted or cannot be found.
        ActionError: it uses an action that is not trusted or cannot be found, or does not use
            one that is trusted.
    """
    about = read_about(folder)
    settings = from_plain(RunSettings, about.get("settings"))
    if domain is not None and domain != settings.domain:
        raise DomainError(
            f"run {str(folder)!r} is about domain {settings.domain!r}, not {domain!r}; leave "
            "--domain out or give that"
        )
    if is_code(settings.domain) and domain is None:
        raise DomainError(
            f"run {str(folder)!r} is about domain {settings.domain!r}, which is code of its own; "
            f"if you trust it, add --domain {settings.domain}"
        )
    if unused := [spec for spec in trusted if spec not in settings.actions]:
        raise ActionError(
            f"run {str(folder)!r} was begun without action {unused[0]!r} and cannot use it; leave "
            "it out"
        )
    for spec in settings.actions:
        if ":" in spec and spec not in trusted:
            raise ActionError(
                f"run {str(folder)!r} uses action {spec!r}, which is code of its own; if you trust "
                f"it, add --actions {spec}"
            )
    own = from_plain(settings_class(settings.domain), about.get("domain_settings"))
    return _checked(folder, settings, domain_class(settings.domain).read(own, folder))


def read_about(folder: Path) -> dict[str, Any]:
    """The run.json of a run; RunError if there is none, or it is of another version."""
    if not (folder / "run.json").is_file():
        raise RunError(f"{str(folder)!r} is no run (it has no run.json); give the folder of a run")
    return read_versioned(folder / "run.json", FORMAT, VERSION, "a cgtorch run")


def _checked(folder: Path, settings: RunSettings, domain: Domain[Any]) -> Run:
    """The run, its domain and the actions that are not the domain's own tried on two lanes."""
    kind = kind_of(settings, domain)
    if kind not in (kinds := domain.trained_kinds or domain.kinds):
        raise SettingsError(f"scenarios is {kind!r:.40}; use one of {', '.join(kinds)}")
    domain = domain.for_run(kind, settings.method)
    check_domain(domain, kind)
    basic = domain.actions()
    sizes = len(domain.percept), len(domain.control)
    actions = resolve_actions(settings.actions, basic, sizes)
    added = [n for n in actions.names if n not in basic.names]
    if added:
        world = domain.world(domain.draw(kind, 2, torch.Generator().manual_seed(0)))
        for name in added:
            check_action(name, actions.actions[actions.names.index(name)], world)
    run = Run(folder, settings, domain, actions)
    if run.learns and domain.rewarded:
        raise SettingsError(
            f"domain {settings.domain!r} gives rewards, which Γ and C do not know; its skills are "
            "evolved in the world itself: --models none"
        )
    return run
