"""The work of `cgtorch-train`, after its options are parsed."""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import torch
from rich.console import Console

from cgtorch import native
from cgtorch.commands import guidance
from cgtorch.commands.command import resumable
from cgtorch.domains.registry import with_name
from cgtorch.domains.settings import DomainSettings, to_plain
from cgtorch.environment.asked import Purse
from cgtorch.ground import distributed as ranks
from cgtorch.ground.counted_work import listening
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.ground.json_lines import JsonLines
from cgtorch.improvement.events import Event, Watch
from cgtorch.native.gpu import launcher_of
from cgtorch.report import ProgressDisplay, TensorBoardWatch, final_table
from cgtorch.report.event_messages import asked_of
from cgtorch.runs.goal import Goal
from cgtorch.runs.journal import recalled_generations
from cgtorch.runs.log import LogWatch
from cgtorch.runs.resume_settings import (
    TakenOver,
    goes_on_to,
    overridden,
    refuse_others,
    remember_goal,
    take_over,
)
from cgtorch.runs.run import AUTO, LOG, Run, only_begun, open_run, planned_run, write_run
from cgtorch.runs.settings import RunSettings
from cgtorch.simulation.compiled_actions import WITH_MEMORY
from cgtorch.training.auto import reached, train_until
from cgtorch.training.context import Training
from cgtorch.training.given_data import given_data
from cgtorch.training.stages import stages_to_make
from cgtorch.training.train import finished_generations, train

WORTH_A_GPU = 4000
"""Population size from which a GPU is faster than the CPU (docs/decisions/engine.md)."""


@dataclass(frozen=True)
class Wish:
    """The options of `cgtorch-train` that are not settings.

    Attributes:
        stage: The last stage to make, "auto" for rounds, or None for the usual one.
        goal: The goal of rounds.
        goal_given: The names of the goal's options that were given.
        device: The device, or None for the fastest.
        checkpoint_seconds: Seconds between two checkpoints.
        quiet: Whether to print the result only.
        budget: The largest numbers of what may be asked of the world, by name.
    """

    stage: str | None
    goal: Goal
    goal_given: frozenset[str]
    device: torch.device | None
    quiet: bool
    budget: Mapping[str, float]
    checkpoint_seconds: float


def begin(folder: Path, settings: RunSettings, domain_settings: DomainSettings, wish: Wish) -> None:
    """Begin a run, again if it has produced nothing yet, or continue one with the same settings."""
    domain_settings = with_name(settings.domain, domain_settings)
    given = {**to_plain(settings), **to_plain(domain_settings)}
    new = ranks.broadcast(not (folder / "run.json").is_file())
    about = settings.actions, settings.domain, settings.driver or None
    run = None if new else open_run(folder, *about)
    if run is None or ranks.broadcast(only_begun(folder) and run.all_settings() != given):
        # On every rank, as they share what the world has to compute.
        run = planned_run(folder, settings, domain_settings, anew=not new)
        _stage(run, wish, {})
        if settings.data:
            given_data(run)  # what is wrong with the files is said before anything is written
        ranks.wait()  # all have seen the folder before anyone writes
        if ranks.first():
            write_run(run)
        ranks.wait()
    refuse_others(run, given, "choose another --run-dir")
    _train(run, settings, wish)


def carry_on(run: Run, given: Mapping[str, Any], overrides: Mapping[str, Any], wish: Wish) -> None:
    """Continue a run under its settings. Given settings must equal them, except `overrides`."""
    if run.stages and run.learns and not (run.folder / "start").is_dir():
        raise RunError(
            f"run {str(run.folder)!r} is stored without its data and models, and cannot continue "
            "without them; train a new run with --run-dir"
        )
    settings = overridden(run, overrides)
    rest = {name: value for name, value in given.items() if name not in overrides}
    refuse_others(run, rest, "leave it out")
    _train(run, settings, wish)


def device_of(name: str) -> torch.device | None:
    """The device with that name, None for "auto"; SettingsError if it cannot be used."""
    if name == "auto":
        return None
    # Each rank of a machine has its own.
    number = f":{os.environ['LOCAL_RANK']}" if name == "cuda" and "LOCAL_RANK" in os.environ else ""
    try:
        device = torch.device(name + number)
        torch.zeros(1, device=device).item()  # which the meta device refuses
    except (RuntimeError, AssertionError) as e:
        raise SettingsError(f"device {name!r} cannot be used; give auto, cpu or cuda") from e
    return device


def fastest_device(run: Run) -> torch.device:
    """A GPU, if its kernels support the run and the population is large; else the CPU.

    If there is a GPU, the choice is printed. Actions without a kernel run as torch operations on a
    GPU, which are slower than the CPU.
    """
    if not torch.cuda.is_available():
        return torch.device("cpu")
    gpu, population = torch.device("cuda"), run.settings.population
    actions = run.actions.actions
    known = all(a.native_kind and a.native_kind not in WITH_MEMORY for a in actions)
    known &= ranks.count() == 1
    name, why, other = "cpu", f"is as fast as a GPU for a population of {population}", "cuda"
    if not known or launcher_of(gpu) is None:
        why = "is faster, as a GPU has no kernels for this run"
    elif population >= WORTH_A_GPU:
        name, why, other = "cuda", f"is faster for a population of {population}", "cpu"
    if ranks.first():
        click.echo(f"device: {name}, which {why}; --device {other} selects the other one", err=True)
    return torch.device(name)


def _asked(run: Run, wish: Wish) -> tuple[str, Goal]:
    """The stage and goal that are asked for; by default those for which the run was begun."""
    before = goes_on_to(run)
    stage, goal = _stage(run, wish, before), wish.goal
    if wish.stage is None and isinstance(before.get("goal"), dict):
        given = {name: getattr(goal, name) for name in wish.goal_given}
        try:
            goal = Goal(**{**before["goal"], **given})
        except TypeError as e:
            raise SettingsError(f"the goal of run {str(run.folder)!r} is damaged ({e})") from e
    remember_goal(run, {"stage": stage, **({"goal": asdict(goal)} if stage == AUTO else {})})
    return stage, goal


def _stage(run: Run, wish: Wish, before: Mapping[str, Any]) -> str:
    """The stage to make, by default that of the run; SettingsError for a goal without auto."""
    stage = wish.stage
    if stage is None:
        stage = str(before.get("stage") or type(run.domain.settings).usual_stage)
    if stage != AUTO:
        if wish.goal_given:
            raise SettingsError(
                f"--target, --minutes and --rounds are for --stage {AUTO}; add that or leave them "
                "out"
            )
        stages_to_make(run, stage)
    return stage


def _train(run: Run, settings: RunSettings, wish: Wish) -> None:
    torch.set_num_threads(1)  # the tensors of a generation are too small to share
    native.use_threads(ranks.cores())
    stage, goal = _asked(run, wish)
    taken, auto = take_over(run, settings, stage), stage == AUTO
    run = taken.run
    plan = guidance.Plan(run, stage, goal)
    display = ProgressDisplay(quiet=wish.quiet or not ranks.first())
    with resumable(guidance.resuming(run)), display:
        if plan.new:
            for line in guidance.before(plan):
                display.say(line, style="bold" if line.startswith("New") else "")
        if native.to_be_compiled():
            with display.working("compiling the engine for this CPU (once)"):
                native.available()
        missing = [s for s in run.domain.stages if s not in run.stages]
        if not (plan.new or auto) and stage in missing[1:]:
            earlier = ", ".join(missing[: missing.index(stage)])
            made = "is made" if stage == missing[1] else "are made"
            display.say(f"{stage} builds on {earlier}, which {made} first")
        for line in _changes(taken):
            display.say(line)
        settled = run.all_settings() | (vars(goal) if auto else {})
        with listening(display.counted), _board(run, settled) as board:
            log = LogWatch(JsonLines(run.folder / LOG)) if ranks.first() else board

            def watch(event: Event) -> None:
                board(event)
                log(event)
                display(event)

            device = wish.device or fastest_device(run)
            purse = Purse(wish.budget)
            about = display.working, device, wish.checkpoint_seconds, purse
            training = Training(run, watch, *about)
            results = train_until(training, goal) if auto else train(training, stage)
        display.say(f"run {run.folder} {_outcome(run, goal, stage, results, purse)}")
        display.say(asked_of("robot" if run.domain.live else "world", purse))
    if ranks.first():
        Console().print(final_table(results, run.domain))
    with ProgressDisplay(quiet=wish.quiet or not ranks.first()) as display:
        for line in guidance.after(plan):
            display.say(line)


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


def _board(run: Run, settings: dict[str, Any]) -> AbstractContextManager[Watch]:
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
        draw_scenarios=run.domain.draw_scenarios,
    )


def _outcome(run: Run, goal: Goal, stage: str, results: list[dict[str, Any]], purse: Purse) -> str:
    """The end of the sentence about a run's outcome, after its folder's name."""
    if purse.exhausted:
        limits = " and ".join(f"{limit:g} {name}" for name, limit in purse.limits.items())
        last = f"the best skill is {results[-1]['stage']}" if results else "there is no skill yet"
        return f"has spent its budget of {limits}; {last}; continue with --resume and more --budget"
    if stage != AUTO:
        return f"is complete up to {stage}"
    rounds = results[len(results) - len(run.rounds) :]
    aim = run.domain.target_return if run.domain.rewarded else goal.target
    if reached(goal, rounds):
        return f"has reached its goal of {aim:.4g}"
    if not rounds:
        return "has made no round; raise --minutes"
    return f"has not reached its goal of {aim:.4g}; continue with --resume"
