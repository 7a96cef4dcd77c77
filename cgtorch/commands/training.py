"""The work of `cgtorch-train`, after its options are parsed: what it says before and after."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from cgtorch.commands import guidance
from cgtorch.commands.command import resumable
from cgtorch.domains.registry import with_name
from cgtorch.domains.settings import DomainSettings
from cgtorch.ground import distributed as ranks
from cgtorch.report import ProgressDisplay, final_table
from cgtorch.report.event_messages import asked_of
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.auto import reached
from cgtorch.training.session import (
    Outcome,
    TrainingRequest,
    Work,
    begun,
    carry_out,
    prepared,
    resumed,
)


def begin(
    folder: Path, settings: RunSettings, own: DomainSettings, request: TrainingRequest, quiet: bool
) -> None:
    """Begin a run, again if it has produced nothing yet, or continue one with the same settings."""
    run = begun(folder, settings, with_name(settings.domain, own), request)
    _train(prepared(run, settings, request), quiet)


def carry_on(
    run: StoredRun,
    given: Mapping[str, Any],
    overrides: Mapping[str, Any],
    request: TrainingRequest,
    quiet: bool,
) -> None:
    """Continue a run under its settings. Given settings must equal them, except `overrides`."""
    _train(prepared(run, resumed(run, given, overrides), request), quiet)


def _train(work: Work, quiet: bool) -> None:
    display = ProgressDisplay(quiet=quiet or not ranks.first())
    with resumable(guidance.resuming(work.run)), display:
        if work.new:
            for line in guidance.before(work):
                display.say(line, style="bold" if line.startswith("New") else "")
        outcome = carry_out(work, display)
        display.say(f"run {work.run.folder} {_end(outcome)}")
        display.say(asked_of("robot" if work.run.domain.live else "world", outcome.purse))
    if ranks.first():
        Console().print(final_table(outcome.results, work.run.domain))
    with ProgressDisplay(quiet=quiet or not ranks.first()) as display:
        for line in guidance.after(work):
            display.say(line)


def _end(outcome: Outcome) -> str:
    """The end of the sentence about a run's outcome, after its folder's name."""
    work, results, purse = outcome.work, outcome.results, outcome.purse
    if purse.exhausted:
        limits = " and ".join(f"{limit:g} {name}" for name, limit in purse.limits.items())
        last = f"the best skill is {results[-1]['stage']}" if results else "there is no skill yet"
        return f"has spent its budget of {limits}; {last}; continue with --resume and more --budget"
    if not work.auto:
        return f"is complete up to {work.stage}"
    rounds = results[len(results) - len(work.run.rounds) :]
    aim = work.run.domain.target_return if work.run.domain.rewarded else work.goal.target
    if reached(work.goal, rounds):
        return f"has reached its goal of {aim:.4g}"
    if not rounds:
        return "has made no round; raise --minutes"
    return f"has not reached its goal of {aim:.4g}; continue with --resume"
