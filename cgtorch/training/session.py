"""From what is asked of a run to its result: begin or continue it, and write its files."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, fields
from math import inf
from numbers import Real
from pathlib import Path
from typing import Any, Self, TypeAlias

import torch

from cgtorch import native
from cgtorch.domains.domain import Domain, rewarded
from cgtorch.domains.settings import LAST, DomainSettings, to_plain
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NAMES as ASKED
from cgtorch.ground.asked import Purse
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.ground.files import check_name_of
from cgtorch.ground.given import known_options, of_kind, real_number, says_true, shown
from cgtorch.improvement.events import Event, Watch
from cgtorch.report import ProgressDisplay, TensorBoardWatch
from cgtorch.runs.changes import overridden, refuse_others
from cgtorch.runs.journal import (
    SECONDS,
    TakenOver,
    goes_on_to,
    recalled_generations,
    remember_goal,
    take_over,
)
from cgtorch.runs.settings import MOST_SHARE, Goal, RunSettings
from cgtorch.runs.stored_run import (
    AUTO,
    StoredRun,
    only_begun,
    planned_run,
    read_about,
    read_run,
    write_run,
)
from cgtorch.runs.writer import check_unwritten, sole_writer
from cgtorch.training.auto import train_until
from cgtorch.training.context import Training
from cgtorch.training.device import device_for, device_named
from cgtorch.training.start import given_data
from cgtorch.training.train import finished_generations, stages_to_make, train

SOON = 0.5  # s after which one who has begun a run has its lock
UserWatch: TypeAlias = Callable[[Event], object]
"""Receives every event of a training. If it returns True, the run stops and can be resumed."""


@dataclass(frozen=True)
class TrainingRequest:
    """The request for a training besides its settings.

    Attributes:
        stage: The last stage to make, "auto" for rounds, or None for the usual one.
        goal: The given parts of the goal of rounds, by name.
        budget: The largest numbers of what may be asked of the world, by name.
        device: Where populations are evaluated: "cpu", "cuda", "cuda:N", or "auto" for the fastest.
        checkpoint_seconds: Seconds between two checkpoints of an evolution.
    """

    stage: str | None = None
    goal: Mapping[str, Any] = field(default_factory=dict)
    budget: Mapping[str, float] = field(default_factory=dict)
    device: str = "auto"
    checkpoint_seconds: float = SECONDS

    def __post_init__(self) -> None:
        """SettingsError for what cannot be used, before anything is written."""
        Goal(**known_options(Goal, self.goal))
        real_number(self.checkpoint_seconds, "checkpoint_seconds")
        of_kind(self.device, str, "device", "auto, cpu or cuda")
        asked = 'limits by name, such as {"motions": 300}'
        of_kind(self.budget, Mapping, "budget", asked)  # type: ignore[type-abstract]
        if self.device != "auto":
            device_named(self.device)
        for name, limit in self.budget.items():
            whole = isinstance(limit, Real) and limit >= 0 and limit in (inf, limit // 1)
            if name not in ASKED or not whole:
                raise SettingsError(
                    f"budget {name}={shown(limit, 40)} is no limit; give whole numbers of "
                    f"{', '.join(ASKED)}"
                )

    @classmethod
    def taken_from(cls, values: Mapping[str, Any]) -> tuple[Self, dict[str, Any]]:
        """The request in these values by name, None for what is not asked, and the others."""
        own, aims = [f.name for f in fields(cls)], [f.name for f in fields(Goal)]
        given = {name: value for name, value in values.items() if value is not None}
        goal = known_options(Goal, {name: given.pop(name) for name in aims if name in given})
        if goal and "stage" not in given:
            given["stage"] = AUTO
        asked = {name: given.pop(name) for name in own if name in given and name != "goal"}
        return cls(goal=goal, **asked), given


@dataclass(frozen=True)
class Work:
    """A run that is about to be trained: to which stage or goal, where, and what has changed.

    `purse` counts what its world is asked.
    """

    run: StoredRun
    stage: str
    goal: Goal
    taken: TakenOver
    request: TrainingRequest
    new: bool
    purse: Purse

    @property
    def auto(self) -> bool:
        """Whether it is trained in rounds, until the goal is reached."""
        return self.stage == AUTO


class _StopTraining(BaseException):
    """The user's watch has asked for the end."""


@contextmanager
def begun(
    folder: Path,
    settings: RunSettings,
    domain_settings: DomainSettings,
    request: TrainingRequest,
    domain: Domain[Any] | None = None,
) -> Iterator[StoredRun]:
    """A new run, or the one in `folder` if it has the same settings or has produced nothing yet.

    In this context no other process writes to it. RunError if another does, or the folder has a
    name that cannot be written or contains other things.
    """
    check_name_of(folder)
    given = {**to_plain(settings), **to_plain(domain_settings)}
    about = settings.actions, domain or settings.domain, settings.driver or None
    with ExitStack() as writer:
        run = None
        if not (new := ranks.broadcast(not (folder / "run.json").is_file())):
            writer.enter_context(sole_writer(folder))
            run = read_run(folder, *about)
        if run is None or ranks.broadcast(only_begun(run) and run.all_settings() != given):
            # On every rank, as they share what the world has to compute.
            with _another_told(folder, new):
                run = planned_run(folder, settings, domain_settings, anew=not new, domain=domain)
            _stage(run, request, {})
            _goal(run, request.goal)
            if settings.data:
                given_data(run)  # bad files are refused before anything is written
            ranks.wait()  # all have seen the folder before anyone writes
            if ranks.first():
                with _another_told(folder, new):
                    write_run(run, anew=not new)
            ranks.wait()
        if new:
            writer.enter_context(sole_writer(folder))
        refuse_others(run, given, "choose another run folder (folder, --run-dir)")
        yield run


@contextmanager
def _another_told(folder: Path, new: bool) -> Iterator[None]:
    """A context to begin a run, whose failure is told as that of the second one to do so."""
    try:
        yield
    except RunError:
        if new and (folder / "run.json").is_file():
            time.sleep(SOON)
            check_unwritten(folder)
        raise


def resumed(run: StoredRun, given: Mapping[str, Any], overrides: Mapping[str, Any]) -> RunSettings:
    """The settings under which a run continues. Given ones must equal them, except `overrides`."""
    if run.stages and run.learns and not (run.folder / "start").is_dir():
        raise RunError(
            f"run {str(run.folder)!r} is stored without its data and models, and cannot continue "
            "without them; train a new run in another folder"
        )
    settings = overridden(run, overrides)
    rest = {name: value for name, value in given.items() if name not in overrides}
    refuse_others(run, rest, "leave it out")
    return settings


@contextmanager
def continued(run: StoredRun) -> Iterator[None]:
    """A context in which no other process writes to an open run.

    RunError if another does, or has done so since the run was opened.
    """
    with sole_writer(run.folder):
        if read_about(run.folder)["settings"] != to_plain(run.settings):
            raise RunError(f"run {str(run.folder)!r} has other settings by now; open it again")
        yield


def prepared(run: StoredRun, settings: RunSettings, request: TrainingRequest) -> Work:
    """The work that is asked for, by default that for which the run was begun."""
    stage, goal = _asked(run, request)
    taken = take_over(run, settings, stage)
    made = (taken.run.folder / name for name in ("start", "journal"))
    new = not taken.run.stages and not any(path.exists() for path in made)
    return Work(taken.run, stage, goal, taken, request, new, Purse(request.budget))


def carry_out(
    work: Work, display: ProgressDisplay, watch: UserWatch | None = None
) -> list[dict[str, Any]]:
    """Train the run, and write its log and TensorBoard's files; the results of stages and rounds.

    Raises:
        NotImprovedError: A stage or round ended without a skill.
        RunError: A file cannot be written or read.
    """
    run, auto = work.run, work.auto
    with _one_thread_each():
        native.available()  # so that no time of a stage has that of the compiler
        for line in (
            *run.domain.pictures(run.domain).remarks(),
            *_earlier_stages(work),
            *_changes(work.taken),
        ):
            display.say(line)
        settled = run.all_settings() | (vars(work.goal) if auto else {})
        with _board(run, settled) as board:

            def told(event: Event) -> None:
                board(event)
                display(event)
                if watch is not None and says_true(watch(event)):
                    raise _StopTraining

            device = device_for(run, work.request.device, display)
            about = display.working, device, work.request.checkpoint_seconds, work.purse
            training = Training(run, told, *about)
            try:
                found = train_until(training, work.goal) if auto else train(training, work.stage)
            except _StopTraining:
                found = run.results
    return found


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """A context in which torch uses one thread, as the tensors of a generation are too small."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    native.use_threads(ranks.cores())
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _asked(run: StoredRun, request: TrainingRequest) -> tuple[str, Goal]:
    """The stage and goal that are asked for; by default those for which the run was begun."""
    before = goes_on_to(run)
    stage, goal = _stage(run, request, before), _goal(run, request.goal)
    if request.stage is None and isinstance(before.get("goal"), dict):
        try:
            goal = _goal(run, {**before["goal"], **request.goal})
        except (TypeError, SettingsError) as e:
            raise SettingsError(f"the goal of run {str(run.folder)!r} is damaged ({e})") from e
    remember_goal(run, {"stage": stage, **({"goal": asdict(goal)} if stage == AUTO else {})})
    return stage, goal


def _goal(run: StoredRun, given: Mapping[str, Any]) -> Goal:
    """The goal of rounds; SettingsError for a target that is no share, unless there are rewards."""
    if rewarded(run.domain):
        return Goal(**{"target": run.domain.target_return, **given})
    goal = Goal(**given)
    if not 0 < goal.target <= MOST_SHARE:
        raise SettingsError(
            f"target is {goal.target:g}, which is no share of scenarios to solve; give a number "
            f"above 0, up to {MOST_SHARE}"
        )
    return goal


def _stage(run: StoredRun, request: TrainingRequest, before: Mapping[str, Any]) -> str:
    """The stage to make, by default that of the run; SettingsError for a goal without auto."""
    stage = request.stage
    if stage is None:
        usual = type(run.domain.settings).usual_stage
        usual = [AUTO, *run.domain.stages][-1] if usual == LAST else usual
        stage = str(before.get("stage") or usual)
    if stage != AUTO:
        if request.goal:
            raise SettingsError(
                f"target, minutes and rounds are for stage {AUTO!r} (--stage {AUTO}); ask for that "
                "or leave them out"
            )
        stages_to_make(run, stage)
    return stage


def _earlier_stages(work: Work) -> Iterator[str]:
    """The stages that are made first, though others were asked for."""
    missing = [s for s in work.run.domain.stages if s not in work.run.stages]
    if not (work.new or work.auto) and work.stage in missing[1:]:
        earlier = ", ".join(missing[: missing.index(work.stage)])
        made = "is made" if work.stage == missing[1] else "are made"
        yield f"{work.stage} builds on {earlier}, which {made} first"


def _changes(taken: TakenOver) -> Iterator[str]:
    """The changes under which a run continues."""
    again = f"; {taken.before} begins again" if taken.set_aside else f" from {taken.before} on"
    versions = [name for name in ("cgtorch", "torch", "engine") if name in taken.changed]
    for name in (n for n in taken.changed if n not in versions):
        was, now = taken.changed[name]
        yield f"{name} is {now} instead of {was}{again}"
    if versions:
        was, now = (
            " and ".join(f"{name} {taken.changed[name][i]!s:.20}" for name in versions)
            for i in (0, 1)
        )
        yield (
            f"run {taken.run.folder} was made with {was} so far, this is {now}: finished stages "
            f"stay, later results may differ from those of {was}{again}"
        )
    if taken.set_aside:
        yield f"the unfinished work on {taken.before} is in {taken.run.folder / taken.set_aside}"


def _board(run: StoredRun, settings: dict[str, Any]) -> AbstractContextManager[Watch]:
    """A context that writes the run's TensorBoard files, on the first rank."""
    if not ranks.first():
        return nullcontext(lambda event: None)
    recalled = recalled_generations(run.folder)
    models = int((run.folder / "start").is_dir())
    return TensorBoardWatch(
        run.folder,
        settings,
        models + finished_generations(run) + len(run.stages) + recalled,
        recalled=recalled,
        actions=run.actions,
        draw_scenarios=run.pictures.scenarios,
    )
