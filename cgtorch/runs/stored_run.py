"""A run: a folder with everything it was made with and everything it produced.

The folder contains:

    run.json            format, versions, domain, settings, names of percept and control, goal
    robot/ …            files of the domain, such as the tabletop's robot
    start/              the state before the first stage: data, Γ, C
    S0/ S1/ …           each finished stage: skill, W and M, data, Γ, C, specialists
    auto-1/ auto-2/ …   each finished round of --stage auto: the same
    log.jsonl           what happened, a line each, with all results and every action of a robot
    journal/            the results so far of an unfinished stage or round
    writer.lock         who writes to it or did last, whose lock is on this file
    set-aside/          journals of stages that were repeated with other settings or versions
    events.out.…        TensorBoard, for people
"""

import itertools
import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch

from cgtorch import __version__, native
from cgtorch.domains.check import check_domain, check_sizes
from cgtorch.domains.domain import Adaptable, Domain, Sparing, rewarded
from cgtorch.domains.files import Files
from cgtorch.domains.live import DriverDomain, Placements, on_robot
from cgtorch.domains.models import Models
from cgtorch.domains.pictures import Pictures
from cgtorch.domains.registry import (
    check_name,
    check_options,
    domain_class,
    is_code,
    make_domain,
    make_driver,
    settings_class,
    spec_of,
)
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.domains.settings import from_plain, to_plain
from cgtorch.graphs import ActionSet, check_action, resolve_actions
from cgtorch.ground import distributed as ranks
from cgtorch.ground.environment import ScenarioBatch
from cgtorch.ground.errors import ActionError, DomainError, RunError, SettingsError
from cgtorch.ground.files import JsonLines, read_versioned, whole_folder, write_json, writing
from cgtorch.native.processes import counted
from cgtorch.runs.belonging import check_fields, check_parts, fields_of, instead_of_run
from cgtorch.runs.imagines import check_imagined, check_played, models_of, reward_models_of
from cgtorch.runs.log import LOG, Row, history_of, read_log, results_in
from cgtorch.runs.settings import NAMES, RunSettings
from cgtorch.runs.writer import WRITER

T = TypeVar("T")
FORMAT, VERSION = "cgtorch-run", 6
SKILL = "skill.json"
AUTO = "auto"
"""The stage name that asks for rounds, auto-1, auto-2, …, until a goal is reached."""


@dataclass(frozen=True)
class StoredRun:
    """An open run: its folder, settings, domain, and primitive actions.

    `repeats` is whether the domain says that its world repeats itself, and it was not seen to
    differ.
    """

    folder: Path
    settings: RunSettings
    domain: Domain[Any]
    actions: ActionSet
    repeats: bool = True

    @property
    def kind(self) -> str:
        """The kind of the run's scenarios."""
        return kind_of(self.settings, self.domain)

    @property
    def stages(self) -> tuple[str, ...]:
        """The finished stages, in the order in which they were made, then the rounds.

        Stages after one that is missing do not count, unless that has found no skill.
        """
        history = history_of(self.folder) if self.domain.stages else []
        failed = {stage for event, stage in history if event == "failed"}
        made = {stage: place for place, (event, stage) in enumerate(history) if event == "result"}
        there = itertools.takewhile(lambda s: self._finished(s) or s in failed, self.domain.stages)
        names = sorted(filter(self._finished, there), key=lambda s: made.get(s, len(made)))
        return (*names, *self.rounds)

    @property
    def rounds(self) -> tuple[str, ...]:
        """The finished rounds of `--stage auto`, in order."""
        return tuple(itertools.takewhile(self._finished, map(round_name, itertools.count(1))))

    @property
    def results(self) -> list[Row]:
        """The result of each finished stage or round, in order; RunError if the log lacks one."""
        stages = self.stages
        return results_in(read_log(self.folder), stages, self.folder) if stages else []

    @property
    def learns(self) -> bool:
        """Whether its skills are evolved in Γ and C, not in the world itself."""
        return self._has_models and not rewarded(self.domain)

    @property
    def imagines(self) -> bool:
        """Whether its skills are evolved in a Γ with rewards."""
        return self._has_models and rewarded(self.domain)

    @property
    def _has_models(self) -> bool:
        chosen = self.settings.models
        return self.domain.models is not None if chosen == "auto" else chosen == "learned"

    @property
    def models(self) -> Models[Any]:
        """The domain's inputs and fits of Γ and C."""
        return models_of(self.domain)

    @property
    def reward_models(self) -> RewardedModels[Any]:
        """The domain's inputs and fits of a Γ with rewards."""
        return reward_models_of(self.domain)

    @property
    def pictures(self) -> Pictures[Any]:
        """The contents of reports on the domain."""
        return self.domain.pictures(self.domain)

    @property
    def files(self) -> Files[Any]:
        """The domain's files in the run."""
        return self.domain.files(self.domain)

    def like(self) -> ScenarioBatch:
        """A batch of 0 scenarios of the run's kind, as its files have them."""
        if self.settings.driver:
            return Placements(torch.zeros(0).long(), torch.zeros(0).long())
        return self.domain.draw(self.kind, 0, torch.Generator())

    def all_settings(self) -> dict[str, Any]:
        """The settings of the run and of its domain, by name, as plain data."""
        return {**to_plain(self.settings), **to_plain(self.domain.settings)}

    def _finished(self, stage: str) -> bool:
        return (self.folder / stage / SKILL).is_file()


def round_name(number: int) -> str:
    """The name of a round (from 1), which is also the name of its skill."""
    return f"{AUTO}-{number}"


def kind_of(settings: RunSettings, domain: Domain[Any]) -> str:
    """The kind of scenarios of a run."""
    return domain.kinds[0] if settings.scenarios == "auto" else settings.scenarios


def versions() -> dict[str, str]:
    """Versions on which the last digits of a run's numbers depend, besides its settings."""
    engine = "compiled" if native.available() else "torch"
    return {"cgtorch": __version__, "torch": str(torch.__version__), "engine": engine}


def planned_run(
    folder: Path,
    settings: RunSettings,
    domain_settings: Any = None,
    anew: bool = False,
    domain: Domain[Any] | None = None,
) -> StoredRun:
    """A run that `write_run` can begin in an empty or new folder; nothing is written.

    With `anew`, the folder may contain a run that has `only_begun`. The domain is made from the
    settings if it is not given.

    Raises:
        DomainError: The domain cannot be made, or breaks its interface.
        ActionError: An action cannot be found.
        RunError: The folder contains other things.
    """
    if domain is None:
        check_options(settings.domain, NAMES)
        domain = make_domain(settings.domain, domain_settings)
    run = _checked(folder, settings, domain, settings.driver)
    if not anew and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        usual = "is not empty and holds no run; choose another folder"
        raise RunError(f"{str(folder)!r} {instead_of_run(folder, usual)}")
    if Path(os.path.realpath(folder)) == Path.cwd():  # `resolve` fails for a loop of links
        raise RunError("a run cannot replace the current folder; choose another, such as runs/one")
    return run


def only_begun(run: StoredRun) -> bool:
    """Whether a run has produced nothing yet, so other settings would lose nothing."""
    names, known = (path.name for path in run.folder.iterdir()), ("run.json", WRITER)
    return all(name in (*known, *run.files.names) or ".tfevents." in name for name in names)


def write_run(run: StoredRun, anew: bool = False) -> None:
    """Write the folder of a planned run; RunError if it cannot be written.

    Without `anew`, that is also so if another process has begun a run there since it was planned.
    """
    folder = run.folder
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
    about = {
        "format": FORMAT,
        "version": VERSION,
        **versions(),
        **run.files.made_with(),
        "settings": to_plain(run.settings),
        "domain_settings": to_plain(run.domain.settings),
        **fields_of(run.domain),
    }
    with nullcontext(folder) if anew else whole_folder(folder) as new:
        run.files.write(new)
        write_json(new / "run.json", about)


def read_run(
    folder: Path,
    trusted: Sequence[str] = (),
    domain: str | Domain[Any] | None = None,
    driver: str | None = None,
) -> StoredRun:
    """Open a run.

    Args:
        folder: The folder of the run.
        trusted: "package.module:Class" of actions that may be imported. A name in a file is never
            enough to import code.
        domain: The domain, or its "package.module:Class", if it is your own code; else None.
        driver: "package.module:Class" of the robot's driver, to act; None to leave the robot alone.

    Raises:
        RunError: There is no run, it has another version, or it is damaged.
        DomainError: Its domain is not trusted or cannot be found.
        ActionError: It uses an action that is not trusted or cannot be found, or does not use one
            that is trusted.
    """
    about = read_about(folder)
    settings = settings_in(folder, RunSettings, about.get("settings"))
    named = domain if domain is None or isinstance(domain, str) else spec_of(domain)[0]
    if named is not None and named != settings.domain:
        raise DomainError(
            f"run {str(folder)!r} is about domain {settings.domain!r}, not {named!r}; give "
            "that, or another run folder (--run-dir) for a new run"
        )
    if is_code(settings.domain) and domain is None:
        raise DomainError(
            f"run {str(folder)!r} is about domain {settings.domain!r}, which is code of its own; "
            f"if you trust it, give it as domain (--domain {settings.domain})"
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
                f"it, give it among the actions (--actions {spec})"
            )
    if driver is not None and driver != settings.driver:
        began = repr(settings.driver) if settings.driver else "no driver"
        raise DomainError(
            f"run {str(folder)!r} was begun with {began}, not {driver!r}; give that, or another "
            "run folder (--run-dir) for a new run"
        )
    if isinstance(domain, Domain):
        run = _checked(folder, settings, domain, driver or "")
    else:
        own = settings_in(folder, settings_class(settings.domain), about.get("domain_settings"))
        check_name(settings.domain, own)
        made = domain_class(settings.domain)
        run = _checked(folder, settings, made.files.read(made, own, folder), driver or "")
    check_fields(folder, about, run.domain)
    check_parts(folder, ("start", *run.domain.stages), run.rounds, settings.seed)
    return run


def settings_in(folder: Path, kind: type[T], data: Any) -> T:
    """Settings from the data of a run's run.json, which a SettingsError names."""
    try:
        return from_plain(kind, data)
    except SettingsError as e:
        raise SettingsError(f"in {str(folder / 'run.json')!r}, {e}") from e


def read_about(folder: Path) -> dict[str, Any]:
    """The content of run.json; RunError if there is no run, or it has another version."""
    if not (folder / "run.json").is_file():
        raise RunError(f"{str(folder)!r} {instead_of_run(folder)}")
    return read_versioned(folder / "run.json", FORMAT, VERSION, "a cgtorch run")


def _checked(folder: Path, settings: RunSettings, domain: Domain[Any], driver: str) -> StoredRun:
    """The run, after a dry run of its domain, and of its actions unless the library made both.

    With a `driver`, the world is a robot, of which nothing is asked here.
    """
    kind = kind_of(settings, domain)
    if kind not in domain.kinds:
        raise SettingsError(f"scenarios is {kind!r:.40}; use one of {', '.join(domain.kinds)}")
    if isinstance(domain, Adaptable):
        domain = domain.for_run(kind, settings.method)
    if settings.models == "learned" and isinstance(domain, Sparing):
        domain = domain.sparing()
    if (driver or not domain.repeats) and (count := ranks.count()) > 1:
        raise SettingsError(
            f"the world does not repeat itself, which {count} processes cannot share; train with "
            "one"
        )
    if driver:
        domain = on_robot(domain, make_driver(driver), JsonLines(folder / LOG))
    elif isinstance(domain, DriverDomain):
        return StoredRun(folder, settings, domain, domain.actions(), repeats=False)
    checked = counted("dry runs of the domain", 1)
    repeats = check_domain(domain, kind)
    checked(1)
    sizes = len(domain.percept), len(domain.control)
    actions = resolve_actions(settings.actions, domain.actions(), sizes)
    every = zip(actions.names, actions.actions, strict=True)
    foreign = _foreign(domain)
    own = {name: action for name, action in every if foreign or _foreign(action)}
    if own and not driver:
        world = domain.world(domain.draw(kind, 2, torch.Generator().manual_seed(0)))
        for name, action in own.items():
            check_sizes(name, action, *sizes)
            check_action(name, action, world)
    run = StoredRun(folder, settings, domain, actions, repeats)
    check = check_imagined if run.imagines else check_played
    check(settings, domain, repeats)
    return run


def _foreign(part: object) -> bool:
    """Whether the class of a domain or action is not the library's."""
    return not type(part).__module__.startswith("cgtorch.")
