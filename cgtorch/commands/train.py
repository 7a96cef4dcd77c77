"""`cgtorch-train`: evolve a skill, stage by stage, from a robot description to a tested skill."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from cgtorch.commands.command import import_from_here, importing, options_of, run_command
from cgtorch.commands.completion import DEVICES, STAGES, one_of, runs
from cgtorch.commands.options import actions_option, common_options, epilog, quiet_option
from cgtorch.errors import RunError, SettingsError
from cgtorch.experiments.goal import AUTO, Goal
from cgtorch.experiments.settings import CHOICES, RunSettings

EXAMPLES = """\b
Examples:
  cgtorch-train --stage S2
  cgtorch-train --stage S3 --seed 1 --run-dir runs/one
  cgtorch-train --resume runs/one --stage S3
  cgtorch-train --resume runs/one --stage S3 --override population=600
  cgtorch-train --stage auto --target 0.99 --minutes 5 --run-dir runs/auto
  cgtorch-train --stage auto --scenarios general --run-dir runs/general
  cgtorch-train --stage auto --robot fetch --run-dir runs/fetch
  cgtorch-train --stage S1 --actions my_package.actions:Wait
  torchrun --nproc-per-node 4 -m cgtorch.commands.train --stage S3
"""


@click.command("cgtorch-train", epilog=epilog(EXAMPLES))
@click.option(
    "--stage",
    default="S2",
    show_default=True,
    shell_complete=one_of(STAGES),
    help="Last stage to make, S0 to S3, or auto: go on until a goal is met.",
)
@click.option(
    "--run-dir", type=click.Path(path_type=Path), help="Folder of the run.  [runs/seed-N]"
)
@click.option(
    "--resume",
    type=click.Path(path_type=Path),
    shell_complete=runs,
    help="Go on with this run.",
)
@click.option(
    "--override",
    multiple=True,
    metavar="NAME=VALUE",
    help="With --resume, go on with another value of a setting; may be given more than once.",
)
@click.option(
    "--robot",
    type=click.Path(path_type=Path),
    help="Another robot than the PR2: fetch, a folder with a URDF and a robot.json, or a "
    "robot description.",
)
@click.option(
    "--urdf", type=click.Path(path_type=Path), help="Its URDF.  [the one beside the description]"
)
@click.option(
    "--device",
    default="auto",
    show_default=True,
    shell_complete=one_of(DEVICES),
    help="auto, cpu, cuda or cuda:N.",
)
@actions_option
@click.option(
    "--checkpoint-seconds",
    type=click.FloatRange(min=0),
    default=20.0,
    show_default=True,
    help="Keep this often where an evolution stands, s; what is finished is kept at once.",
)
@quiet_option
@options_of(Goal)
@options_of(RunSettings, skip=("actions",), choices=CHOICES)
@common_options
@click.pass_context
def command(context: click.Context, /, **options: Any) -> None:
    """Evolve a robot skill: collect data, fit Γ and C, evolve, and test it in the world.

    A stage needs the ones before it; those the run lacks are made first. S0 reaches objects along
    the near edge of the table, S1 the left, S2 the right, S3 the far edge. With --stage auto
    nobody sets stages: the robot tries its skill all around the table and improves it on what it
    missed, round by round, until the target holds on fresh placements.
    """
    # Torch takes a second to import, so that help and usage errors come without it.
    with importing():
        from cgtorch.commands.training import begin, carry_on
        from cgtorch.ranks import together

    of_goal = {f.name for f in fields(Goal)}
    of_run = {f.name for f in fields(RunSettings)} - {"actions"}
    every = options["checkpoint_seconds"]
    given = {
        name
        for name in options
        if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT
    }
    stage, quiet, device = options["stage"], options["quiet"], options["device"]
    goal = Goal(**{name: options[name] for name in of_goal})
    if stage != AUTO and (odd := sorted(given & of_goal)):
        raise SettingsError(f"--{odd[0]} is for --stage {AUTO}; add that or leave it out")
    import_from_here(options["actions"])
    overrides = _overrides(context, options["override"])
    if options["resume"]:
        if odd := sorted(given & {"run_dir", "urdf", "robot"}):
            raise SettingsError(
                f"--{odd[0].replace('_', '-')} cannot change in a run that has begun; leave it out"
            )
        wanted = {name: options[name] for name in given & of_run}
        about = options["resume"], options["actions"], wanted, overrides
        with together():
            carry_on(*about, stage, goal, device, quiet, every)
        return
    if overrides:
        raise SettingsError("--override is for a run that has begun; add --resume RUN")
    values = {name: options[name] for name in of_run}
    settings = RunSettings(**values, actions=tuple(options["actions"]))
    folder = options["run_dir"] or Path("runs") / f"seed-{settings.seed}"
    if (folder / "run.json").is_file() and (options["urdf"] or options["robot"]):
        raise RunError(f"run {str(folder)!r} has its robot already; choose another --run-dir")
    robot = options["urdf"], options["robot"]
    with together():
        begin(folder, settings, *robot, stage, goal, device, quiet, every)


def _overrides(context: click.Context, words: Sequence[str]) -> dict[str, Any]:
    """Settings by name from NAME=VALUE, read as their own options read them."""
    options = {option.name: option for option in context.command.params}
    found = {}
    for word in words:
        name, _, text = word.partition("=")
        name = name.removeprefix("--").replace("-", "_")
        if "=" not in word or name not in {f.name for f in fields(RunSettings)}:
            raise SettingsError(
                f"--override {word!r:.40} names no setting; give NAME=VALUE, such as population=600"
            )
        value = options[name].type.convert(text, options[name], context)
        found[name] = (value,) if options[name].multiple else value
    return found


def main() -> None:
    """Entry point of `cgtorch-train`."""
    run_command(command)


if __name__ == "__main__":
    main()
