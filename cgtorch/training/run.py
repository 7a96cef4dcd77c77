"""Training from Python, and what one does with a run; the commands stand on the same functions."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from cgtorch.domains.domain import rewarded
from cgtorch.domains.failures import Failures
from cgtorch.domains.registry import (
    driver_of,
    full_name,
    make_domain,
    settings_class,
    spec_of,
    specs_of,
    with_name,
)
from cgtorch.graphs import Skill, load_skill
from cgtorch.graphs.skill import a_skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.ground.files import write_bytes
from cgtorch.ground.given import a_function, given_folder, given_path, known_options, of_kind, truth
from cgtorch.ground.replacing import check_output
from cgtorch.report import ProgressDisplay
from cgtorch.report.console import LastingConsole
from cgtorch.runs.chosen import folder_of_last, without_skill
from cgtorch.runs.log import read_log
from cgtorch.runs.settings import Goal, RunSettings, defaults_of
from cgtorch.runs.stored_run import SKILL, StoredRun, read_run
from cgtorch.training.evaluate import Score, evaluate_skill
from cgtorch.training.explained import explained, failures_in
from cgtorch.training.session import (
    TrainingRequest,
    UserWatch,
    begun,
    carry_out,
    continued,
    prepared,
    resumed,
)

if TYPE_CHECKING:
    from cgtorch.domains.domain import Domain
    from cgtorch.domains.robot import RobotDriver
    from cgtorch.graphs import Action


class Run(StoredRun):
    """A run: its folder, settings, domain and actions, its skills, and what happened."""

    @classmethod
    def of(cls, run: StoredRun) -> Self:
        """The same run, with what one can do with it."""
        return cls(**vars(run))

    @property
    def skill(self) -> Skill:
        """The last skill, or the best of an interrupted stage; RunError if there is none yet."""
        if (last := folder_of_last(self)) is None:
            usual = "has no skill yet; resume it"
            raise RunError(f"run {str(self.folder)!r} {without_skill(self, usual)}")
        return load_skill(last / SKILL, self.actions)

    @property
    def skills(self) -> dict[str, Skill]:
        """The skill of each finished stage or round, by its name, in order."""
        files = {name: self.folder / name / SKILL for name in self.stages}
        return {name: load_skill(path, self.actions) for name, path in files.items()}

    @property
    def ledger(self) -> list[dict[str, Any]]:
        """A row of the log for each accepted skill, with the evidence for eq. 1."""
        rows = (row for row in self.log() if row["event"] == "accepted")
        return [row for row in rows if row["stage"] in self.stages]

    def log(self) -> list[dict[str, Any]]:
        """The events of the run, a row each, as `pandas.DataFrame` takes them (docs/log.md)."""
        return read_log(self.folder)

    def evaluate(
        self,
        count: int = 1000,
        scenarios: str | None = None,
        seed: int = 0,
        skill: Skill | None = None,
    ) -> Score:
        """Try a skill, by default the last one, on fresh scenarios of a kind in the world.

        SettingsError for a kind, a number of scenarios (at most a million) or a seed that is none.
        """
        skill = self.skill if skill is None else skill
        return evaluate_skill(skill, self.domain, scenarios or self.kind, count, seed)

    def failures(self, score: Score, skill: Skill | None = None) -> Failures:
        """Why a skill fails in a score of `evaluate`: kinds of failure, causes, and advice.

        The skill is given if it is none of the run's. SettingsError for what is no score or no
        skill, or for a score of another run or of another skill.
        """
        of_kind(score, Score, "score", "a Score, such as evaluate returns")
        return failures_in(self, score, None if skill is None else a_skill(skill))

    def report(self, path: Path | str, force: bool = False) -> None:
        """Write the run as one HTML page.

        With `force`, a file that exists is replaced, unless it is one of the run's own; RunError
        otherwise.
        """
        from cgtorch.report.page import report_page

        output = given_path(path)
        check_output(output, force, self.folder, "path", "give force=True")
        write_bytes(output, report_page(self, explained(self)))

    def resume(
        self,
        stage: str | None = None,
        *,
        watch: UserWatch | None = None,
        quiet: bool = False,
        **overrides: Any,
    ) -> Self:
        """Continue the run, to its own stage or goal, or to others; returns the run afterwards.

        `overrides` are settings to continue with, or `target`, `minutes`, `rounds`, `budget`,
        `device` and `checkpoint_seconds` as for `train`.
        """
        quiet = truth(quiet, "quiet")
        if watch is not None:
            a_function(watch, "watch")
        request, rest = TrainingRequest.taken_from({"stage": stage, **overrides})
        kind = type(self.domain.settings)
        own = {f.name for f in fields(kind)}
        rest |= known_options(RunSettings, {k: v for k, v in rest.items() if k not in own}, kind)
        settings = resumed(self, rest, rest)
        with continued(self), _progress(quiet) as display:
            work = prepared(self, settings, request)
            carry_out(work, display, watch)
        return type(self).of(work.run)


def _progress(quiet: bool) -> ProgressDisplay:
    """A display for a program, which goes on if nobody sees it."""
    return ProgressDisplay(LastingConsole(), quiet or not ranks.first())


def make(name: str, **settings: Any) -> "Domain[Any]":
    """A domain by the name that it has on the command line, with its own settings.

    DomainError if there is none, SettingsError for a setting that it does not have, or for what is
    no name.
    """
    of_kind(name, str, "name", "the name of a domain, such as 'tabletop', or call its class")
    kind = settings_class(name)
    return make_domain(name, kind(**known_options(kind, settings)))


def train(
    domain: "str | Domain[Any] | type[Domain[Any]] | type[RobotDriver]" = "tabletop",
    folder: Path | str | None = None,
    *,
    stage: str | None = None,
    target: float | None = None,
    actions: "Sequence[str | type[Action]]" = (),
    watch: UserWatch | None = None,
    quiet: bool = False,
    **settings: Any,
) -> Run:
    """Train a run, or continue it if `folder` has it: what `cgtorch-train` does.

    Args:
        domain: A domain, a class of one or of a `RobotDriver`, or a name as on the command line.
        folder: The folder of the run; runs/seed-N by default.
        stage: The last stage to make, or "auto" for rounds until the target is reached.
        target: The share of fresh scenarios to solve, or the mean return to reach, in rounds.
        actions: More actions for graphs: classes, or names as on the command line.
        watch: Receives every event (`cgtorch.improvement.events`), with the champion of each
            generation; the run stops if it returns True.
        quiet: Whether to show no progress.
        settings: Settings of the run and of the domain (docs/settings.md), and `minutes`, `rounds`,
            `budget` (such as {"motions": 300}), `device` and `checkpoint_seconds`.

    Returns:
        The run, which may have stopped before its goal.

    Raises:
        CgtorchError: Something given cannot work; the message says what and what to do.
    """
    quiet = truth(quiet, "quiet")
    spec, made = spec_of(domain)
    kind = settings_class(spec) if made is None else type(made.settings)
    returns = "target_return" in {f.name for f in fields(kind)} and (
        not settings.get("success") if made is None else rewarded(made)
    )
    if watch is not None:
        a_function(watch, "watch")
    if target is not None:
        Goal(**known_options(Goal, {"target": target}))  # which checks it
    aim = {"target_return" if returns else "target": target}
    request, rest = TrainingRequest.taken_from({"stage": stage, **aim, **settings})
    given = {f.name: rest.pop(f.name) for f in fields(kind) if f.name in rest}
    own = known_options(kind, given)
    if made is not None and own:
        name = next(iter(own))
        raise SettingsError(
            f"{name} is a setting of the domain, which is made already; set it there"
        )
    domain_settings = with_name(spec, kind(**own)) if made is None else made.settings
    spec = full_name(spec, domain_settings)
    rest |= {"actions": specs_of(actions), "domain": spec}
    rest.setdefault("driver", driver_of(spec) if made is None else "")
    run_settings = RunSettings(**{**defaults_of(kind), **known_options(RunSettings, rest, kind)})
    usual = Path("runs") / f"seed-{run_settings.seed}"
    place = given_folder(usual if folder is None else folder)
    with (
        ranks.together(),
        _progress(quiet) as display,
        begun(place, run_settings, domain_settings, request, made) as run,
    ):
        work = prepared(run, run_settings, request)
        carry_out(work, display, watch)
    return Run.of(work.run)


def open_run(
    folder: Path | str,
    domain: "str | Domain[Any] | type[Domain[Any]] | None" = None,
    actions: "Sequence[str | type[Action]]" = (),
) -> Run:
    """Open a run.

    Args:
        folder: The folder of the run.
        domain: The run's domain if it is your own: an object, its class, or its name.
        actions: The run's actions that are your own, as a file never names code to import.

    Raises:
        CgtorchError: There is no run, it is damaged, or something of it is not given.
    """
    spec, made = (None, None) if domain is None else spec_of(domain)
    return Run.of(read_run(given_folder(folder), specs_of(actions), made or spec))
