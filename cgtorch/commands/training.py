"""The work of `cgtorch-train`, after its options are parsed, and what it says before and after."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from cgtorch.commands.common import resumable
from cgtorch.domains.domain import most_lanes, rewarded
from cgtorch.domains.registry import TABLETOP, with_name
from cgtorch.domains.settings import DomainSettings
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NOTHING
from cgtorch.ground.files import as_word
from cgtorch.native.rank_processes import in_ranks
from cgtorch.report import ProgressDisplay, final_table
from cgtorch.report.messages import asked_of
from cgtorch.runs.chosen import folder_of_last, last_skill, own_code, resuming
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.after import advice_after, unfinished
from cgtorch.training.auto import reached
from cgtorch.training.context import evolution_settings
from cgtorch.training.session import (
    TrainingRequest,
    Work,
    begun,
    carry_out,
    continued,
    prepared,
    resumed,
)
from cgtorch.training.train import stages_to_make

FEWEST = 4  # individuals for each process


def begin(
    folder: Path,
    settings: RunSettings,
    own: DomainSettings,
    request: TrainingRequest,
    quiet: bool,
    processes: int | None = None,
) -> None:
    """Begin a run, again if it has produced nothing yet, or continue one with the same settings."""
    with ExitStack() as writer:
        # A domain may have to look at its world for long, which is over before processes begin.
        with ProgressDisplay(quiet=quiet or not ranks.first()):
            own = with_name(settings.domain, own)
            run = writer.enter_context(begun(folder, settings, own, request))
        work = prepared(run, settings, request)
        in_ranks(partial(_train, work, quiet), processes or usual_processes(run))


def carry_on(
    run: StoredRun,
    given: Mapping[str, Any],
    overrides: Mapping[str, Any],
    request: TrainingRequest,
    quiet: bool,
    processes: int | None = None,
) -> None:
    """Continue a run under its settings. Given settings must equal them, except `overrides`."""
    settings = resumed(run, given, overrides)
    with continued(run):
        work = prepared(run, settings, request)
        in_ranks(partial(_train, work, quiet), processes or usual_processes(run))


def usual_processes(run: StoredRun) -> int:
    """One for each core where skills evolve in a world whose episodes take long, else one.

    Each of them has at least `FEWEST` individuals to try, and a lane.
    """
    if run.learns or not run.repeats or (lanes := most_lanes(run.domain)) is None:
        return 1
    return max(1, min(ranks.cores(), lanes, evolution_settings(run).population // FEWEST))


def _train(work: Work, quiet: bool) -> None:
    run, quiet = work.run, quiet or not ranks.first()
    with resumable(resuming(run)), ProgressDisplay(quiet=quiet) as display:
        if work.new:
            for line in _before(work):
                display.say(line, style="bold" if line.startswith("New") else "")
        results = carry_out(work, display)
        display.say(f"run {run.folder} {_end(work, results)}")
        if work.purse.total != NOTHING:
            display.say(asked_of("robot" if run.settings.driver else "world", work.purse))
    if ranks.first() and results:
        Console().print(final_table(results, run.domain))
    with ProgressDisplay(quiet=quiet) as display:
        for line in _after(work) if folder_of_last(run) else ():
            display.say(line)


def _before(work: Work) -> Iterator[str]:
    """The plan of a new run, and where to watch it."""
    run, settings = work.run, work.run.settings
    about = f"domain {settings.domain}, seed {settings.seed}"
    if work.auto:
        until = f"evolve skills until the target of {work.goal.target:.4g} is met"
        takes = f"It ends after {work.goal.minutes:g} minutes (--minutes) at the latest."
    else:
        until = f"evolve one skill for each of {', '.join(stages_to_make(run, work.stage))}"
        takes = "The time depends on the domain."
        if settings.domain == TABLETOP:
            takes = (
                "On two quiet cores, S0 to S2 take some 10 seconds, S0 to S3 some 15, and about "
                "ten times as long in physics (--world mujoco)."
            )
    yield f"New run {run.folder}: {until} ({about})."
    if run.learns:
        read = "Read the data that you give" if settings.data else ""
        collect = "collect more" if read else "Collect data"
        parts = ", ".join(part for part in (read, settings.transitions and collect) if part)
        yield f"  1. {parts}, and fit the transition model Γ and the success classifier C."
        yield "  2. Evolve skills inside Γ and C, and try the best of them in the world."
        yield "  3. Accept a skill if it forgets nothing and solves something new."
    elif run.imagines:
        yield "  1. Play a few short episodes of random controls, and fit Γ and rewards to them."
        yield "  2. Evolve skills in imagined episodes, and play the best of them in the world."
    elif rewarded(run.domain) and settings.method == "compose":
        yield "  1. Evolve skills in the world itself, on fresh episodes in each generation."
        yield "  2. Keep the best until another skill beats it on further fresh episodes."
    else:
        yield "  1. Evolve skills in the world itself; no models are learned."
        yield "  2. Accept a skill if it forgets nothing and solves something new."
    yield f"  {takes} Progress appears here, and in TensorBoard:"
    yield f"    tensorboard --logdir {as_word(run.folder)}"
    yield f"  Ctrl-C stops the run, and this command continues it: {resuming(run)}"


def _end(work: Work, results: list[dict[str, Any]]) -> str:
    """The end of the sentence about a run's outcome, after its folder's name."""
    purse = work.purse
    if purse.exhausted and not purse.late():
        limits = " and ".join(f"{limit:g} {name}" for name, limit in purse.limits.items())
        last = f"the best skill is {results[-1]['stage']}" if results else "there is no skill yet"
        return f"has spent its budget of {limits}; {last}; continue with --resume and more --budget"
    if not work.auto:
        return f"is complete up to {work.stage}"
    rounds = results[len(results) - len(work.run.rounds) :]
    if reached(work.goal, rounds):
        return f"has reached its goal of {work.goal.target:.4g}"
    if not rounds:
        return unfinished(work.run)
    return f"has not reached its goal of {work.goal.target:.4g}; {advice_after(work.run)}"


def _after(work: Work) -> Iterator[str]:
    """Whether the last skill has each additional action, and what to look at next."""
    run, folder, code = work.run, as_word(work.run.folder), own_code(work.run)
    if added := set(run.actions.names) - set(run.domain.actions().names):
        _, skill = last_skill(run.folder, run.settings.actions, run.settings.domain)
        for name in sorted(added):
            yield (
                f"{skill.name} uses the action {name}."
                if name in skill.used_actions
                else f"No node of {skill.name} is {name}: the search found no use for it. Another "
                "--seed may."
            )
    yield "Next:"
    yield f"  cgtorch-evaluate {folder}{code}  # try the skill on fresh scenarios"
    if not run.settings.driver:
        yield f"  cgtorch-view {folder}{code}  # watch it at work in the browser"
    yield f"  cgtorch-report {folder}{code} --output report.html  # the run, and where it fails"
    later = [name for name in run.domain.stages if name not in run.stages]
    if later and not work.auto:
        yield f"  {resuming(run)} --stage {later[-1]}  # more stages"
