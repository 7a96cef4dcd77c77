"""What `cgtorch-train` does once its options are understood."""

from collections.abc import Sequence
from pathlib import Path

import torch

from cgtorch.errors import SettingsError
from cgtorch.experiments.run import Run, create_run, open_run
from cgtorch.experiments.settings import RunSettings
from cgtorch.experiments.stages import stages_up_to
from cgtorch.experiments.train import finished_generations, train
from cgtorch.improvement.events import Event
from cgtorch.report import ProgressDisplay, TensorBoardWatch, final_table


def begin(
    folder: Path,
    settings: RunSettings,
    urdf: Path | None,
    robot: Path | None,
    stage: str,
    device: str,
    quiet: bool,
) -> None:
    """Begin a run, or make further stages of one that was begun with the same settings."""
    stages_up_to(stage)
    where = device_of(device)
    if (folder / "run.json").is_file():
        run = open_run(folder, settings.actions)
        _same(run, settings)
    else:
        run = create_run(folder, settings, urdf, robot)
    _train(run, stage, where, quiet)


def carry_on(folder: Path, trusted: Sequence[str], stage: str, device: str, quiet: bool) -> None:
    """Go on with a run under the settings it has."""
    stages_up_to(stage)
    _train(open_run(folder, trusted), stage, device_of(device), quiet)


def device_of(name: str) -> torch.device:
    """The device called `name`; "auto" is a GPU if there is one.

    Raises:
        SettingsError: it does not exist.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()  # which the meta device refuses
    except (RuntimeError, AssertionError) as e:
        raise SettingsError(f"device {name!r} cannot be used; give auto, cpu or cuda") from e
    return device


def _same(run: Run, settings: RunSettings) -> None:
    was, now = run.settings.to_dict(), settings.to_dict()
    for name in was:
        if was[name] != now[name]:
            raise SettingsError(
                f"run {str(run.folder)!r} was begun with --{name.replace('_', '-')} {was[name]}, "
                f"not {now[name]}; choose another --run-dir"
            )


def _train(run: Run, stage: str, device: torch.device, quiet: bool) -> None:
    torch.set_num_threads(1)  # the tensors of a generation are too small to share
    with ProgressDisplay(quiet=quiet) as display:
        missing = [s for s in stages_up_to(stage) if s not in run.stages]
        if missing and missing != [stage]:
            earlier = ", ".join(missing[:-1])
            display.say(f"{stage} needs {earlier} first, which {run.folder} lacks; making all")
        board = TensorBoardWatch(
            run.folder,
            run.settings.to_dict(),
            finished_generations(run),
            actions=run.actions,
            footprint=run.robot.description.footprint,
        )

        def watch(event: Event) -> None:
            board(event)
            display(event)

        try:
            results = train(run, stage, watch, display.working, device)
        finally:
            board.close()
        display.say(f"run {run.folder} is complete up to {stage}")
    display.console.print(final_table(results))
