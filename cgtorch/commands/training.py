"""What `cgtorch-train` does once its options are understood."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from cgtorch import native, ranks
from cgtorch.errors import SettingsError
from cgtorch.experiments.auto import reached, train_until
from cgtorch.experiments.goal import AUTO, Goal
from cgtorch.experiments.journal import recalled_generations
from cgtorch.experiments.run import Run, create_run, open_run
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.stages import check_stages, stages_up_to
from cgtorch.experiments.takeover import TakenOver, overridden, refuse_others, take_over
from cgtorch.experiments.train import finished_generations, train
from cgtorch.improvement.events import Event, Watch
from cgtorch.report import ProgressDisplay, TensorBoardWatch, final_table


def begin(
    folder: Path,
    settings: RunSettings,
    urdf: Path | None,
    robot: Path | None,
    stage: str,
    goal: Goal,
    device: str,
    quiet: bool,
    checkpoint_seconds: float,
) -> None:
    """Begin a run, or go on with one that was begun with the same settings.

    Args:
        folder: of the run.
        settings: of the run.
        urdf: of the robot, or None for the one beside its description.
        robot: its name or description, or None for that beside the URDF or the PR2's.
        stage: the last stage to make, or "auto" to go on until the goal is met.
        goal: of "auto".
        device: where populations are evaluated.
        quiet: print the final table only.
        checkpoint_seconds: between two notes of where an evolution stands.
    """
    _check(stage, settings)
    where = device_of(device)
    run = None
    if not (folder / "run.json").is_file() and ranks.first():
        run = create_run(folder, settings, urdf, robot)
    ranks.wait()
    run = run or open_run(folder, settings.actions)
    refuse_others(run, vars(settings), "choose another --run-dir")
    _train(run, settings, stage, goal, where, quiet, checkpoint_seconds)


def carry_on(
    folder: Path,
    trusted: Sequence[str],
    given: Mapping[str, Any],
    overrides: Mapping[str, Any],
    stage: str,
    goal: Goal,
    device: str,
    quiet: bool,
    checkpoint_seconds: float,
) -> None:
    """Go on with a run under the settings it has, but for those that are taken over.

    Args:
        folder: of the run.
        trusted: actions of its own that may be imported.
        given: settings that must be the run's.
        overrides: settings to go on with in place of the run's.
        stage: this and the others as in `begin`.
        goal: of "auto".
        device: where populations are evaluated.
        quiet: print the final table only.
        checkpoint_seconds: between two notes of where an evolution stands.
    """
    run = open_run(folder, trusted)
    _check(stage, run.settings)
    where = device_of(device)
    settings = overridden(run, overrides)
    rest = {name: value for name, value in given.items() if name not in overrides}
    refuse_others(run, rest, "leave it out")
    _train(run, settings, stage, goal, where, quiet, checkpoint_seconds)


def _check(stage: str, settings: RunSettings) -> None:
    if stage != AUTO:
        stages_up_to(stage)
        check_stages(settings.scenarios)


def device_of(name: str) -> torch.device:
    """The device called `name`; "auto" is a GPU if there is one.

    Raises:
        SettingsError: it does not exist.
    """
    if name == "auto":
        gpu = f"cuda:{os.environ.get('LOCAL_RANK', 0)}"  # each rank of a machine has its own
        return torch.device(gpu if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()  # which the meta device refuses
    except (RuntimeError, AssertionError) as e:
        raise SettingsError(f"device {name!r} cannot be used; give auto, cpu or cuda") from e
    return device


def _train(
    run: Run,
    settings: RunSettings,
    stage: str,
    goal: Goal,
    device: torch.device,
    quiet: bool,
    checkpoint_seconds: float,
) -> None:
    torch.set_num_threads(1)  # the tensors of a generation are too small to share
    native.use_threads(ranks.cores())
    taken = take_over(run, settings, stage)
    run = taken.run
    with ProgressDisplay(quiet=quiet or not ranks.first()) as display:
        if native.to_be_compiled():
            with display.working("compiling for this CPU, once"):
                native.available()
        missing = [s for s in stages_up_to(stage) if s not in run.stages] if stage != AUTO else []
        if missing and missing != [stage]:
            earlier = ", ".join(missing[:-1])
            display.say(f"{stage} needs {earlier} first, which {run.folder} lacks; making all")
        for line in _changes(taken):
            display.say(line)
        shown = run.settings.to_dict() | (vars(goal) if stage == AUTO else {})
        with _board(run, shown) as board:

            def watch(event: Event) -> None:
                board(event)
                display(event)

            common = watch, display.working, device, checkpoint_seconds
            if stage == AUTO:
                results = train_until(run, goal, *common)
            else:
                results = train(run, stage, *common)
        display.say(f"run {run.folder} {_outcome(run, goal, stage, results)}")
    if ranks.first():
        Console().print(final_table(results))


def _changes(taken: TakenOver) -> Iterator[str]:
    """What a run goes on with that was otherwise before."""
    again = f"; {taken.before} begins again" if taken.set_aside else f" from {taken.before} on"
    versions = [name for name in ("cgtorch", "torch", "engine") if name in taken.changed]
    for name in (n for n in taken.changed if n not in versions):
        was, now = taken.changed[name]
        yield f"{name} is {now} in place of {was}{again}"
    if versions:
        was, now = (
            " and ".join(f"{name} {taken.changed[name][i]!s:.20}" for name in versions)
            for i in (0, 1)
        )
        yield (
            f"run {taken.run.folder} was made with {was} so far, this is {now}: what is finished "
            f"stays, what comes may differ from what {was} would make{again}"
        )
    if taken.set_aside:
        yield f"what {taken.before} had come to is in {taken.run.folder / taken.set_aside}"


@contextmanager
def _board(run: Run, settings: dict[str, Any]) -> Iterator[Watch]:
    """What writes the run's TensorBoard files: the first rank does."""
    if not ranks.first():
        yield lambda event: None
        return
    recalled = recalled_generations(run.folder)
    models = int((run.folder / "start").is_dir())
    with TensorBoardWatch(
        run.folder,
        settings,
        models + finished_generations(run) + len(run.stages) + recalled,
        recalled=recalled,
        actions=run.actions,
        footprint=run.robot.description.footprint,
    ) as board:
        yield board


def _outcome(run: Run, goal: Goal, stage: str, results: list[dict[str, Any]]) -> str:
    """What a run has come to, after its folder's name."""
    if stage != AUTO:
        return f"is complete up to {stage}"
    rounds = results[len(results) - len(run.rounds) :]
    if reached(goal, rounds):
        return f"has reached its goal of {goal.target:.4g}"
    if not rounds:
        return "has made no round; raise --minutes"
    return f"has not reached its goal of {goal.target:.4g}; go on with --resume"
