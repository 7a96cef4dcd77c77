"""Options that several commands share."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from ctypes.util import find_library
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import click

from cgtorch.commands import completion
from cgtorch.commands.command import import_from_here
from cgtorch.ground.errors import RunError

F = TypeVar("F", bound=Callable[..., Any])


def epilog(examples: str) -> str:
    """The end of a command's help: its examples and exit codes."""
    codes = "Exit codes: 0 done; 1 the task failed or was interrupted; 2 bad input."
    return f"{examples.rstrip()}\n\n{codes}"


def _print_script(context: click.Context, parameter: click.Parameter, shell: str | None) -> None:
    if shell is not None and not context.resilient_parsing:
        click.echo(completion.script(shell))
        context.exit()


def importable(context: click.Context, parameter: click.Parameter, specs: Any) -> Any:
    """Let code of the user's be imported from the current folder."""
    import_from_here(specs if isinstance(specs, tuple) else [specs or ""])
    return specs


completion_option = click.option(
    "--completion",
    type=click.Choice(completion.SHELLS),
    expose_value=False,
    is_eager=True,
    callback=_print_script,
    help="Print the script that completes all commands in this shell, then exit.",
)


def common_options(function: F) -> F:
    """Decorator: the options of every command; use it last."""
    options = (
        click.option(
            "--actions",
            multiple=True,
            shell_complete=completion.declared_actions,
            callback=importable,
            help="Additional action for skills: a name or package.module:Class. Repeat the option "
            "for several actions.",
        ),
        click.option("--quiet", is_flag=True, help="Print the result only, without progress."),
        click.version_option(package_name="cgtorch"),
        completion_option,
    )
    return _with_options(function, options)


def _with_options(function: F, options: Sequence[Callable[[F], F]]) -> F:
    return reduce(lambda f, option: option(f), reversed(options), function)


run_or_skill = click.argument(
    "path",
    metavar="RUN_OR_SKILL",
    type=click.Path(path_type=Path),
    shell_complete=completion.runs_or_skills,
)

skill_option = click.option(
    "--skill",
    "name",
    shell_complete=completion.ledger_names,
    help="Use this skill of the run's ledger in place of the last one.",
)

domain_option = click.option(
    "--domain",
    shell_complete=completion.domains,
    callback=importable,
    help="The domain as package.module:Class, if the run's domain is your own code. For a skill "
    "file: the domain of the skill.  [tabletop]",
)

world_option = click.option(
    "--world",
    help="The world to try the skill in. The tabletop has kinematic and mujoco (physics)."
    "  [that of the run]",
)

force_option = click.option("--force", is_flag=True, help="Replace the file if it exists.")


def output_option(what: str) -> Callable[[F], F]:
    """Decorator: the option for the file or folder to write."""
    return click.option("--output", type=click.Path(path_type=Path), required=True, help=what)


def check_output(output: Path, force: bool) -> None:
    """RunError if the output is a folder, or a file that must not be replaced."""
    if output.is_dir():
        raise RunError(f"{str(output)!r} is a folder; choose another --output")
    if output.exists() and not force:
        raise RunError(f"{str(output)!r} exists; choose another --output or add --force")


def scenario_options(scenarios: str, count: str, seed: str, most: int) -> Callable[[F], F]:
    """Decorator: the kind of scenarios, their number (at most `most`) and seed, with their help."""
    kind = completion.one_of(completion.SCENARIOS)
    options = (
        click.option("--scenarios", shell_complete=kind, help=scenarios),
        number_option("--count", click.IntRange(1, most), 40, count),
        number_option("--seed", click.IntRange(0, 2**31 - 1), 0, seed),
    )
    return lambda function: _with_options(function, options)


def number_option(
    name: str, kind: click.IntRange | click.FloatRange, default: float, what: str
) -> Callable[[F], F]:
    """Decorator: an option for a number within bounds."""
    return click.option(name, type=kind, default=default, show_default=True, help=what)


@contextmanager
def waiting(message: str, quiet: bool, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """Show on a terminal a live line with a message, the elapsed time, and the work done.

    Yields a function to call with the amount of further work done, of `total`. Long work that is
    counted within has a line of its own until it is done (`cgtorch.ground.processes`).
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from cgtorch.ground.processes import listening

    console = Console(stderr=True)
    counted = (BarColumn(24), MofNCompleteColumn()) if total is not None else ()
    left = (TextColumn("left"), TimeRemainingColumn()) if total is not None else ()
    progress = Progress(
        SpinnerColumn(),
        TextColumn("{task.description} …", markup=False),
        *counted,
        TimeElapsedColumn(),
        *left,
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )
    within: dict[str, Any] = {}

    def show(what: str, done: int, of: int) -> None:
        if what not in within:
            within[what] = progress.add_task(what, total=of)
        progress.update(within[what], completed=done, total=of)
        if done == of:
            progress.remove_task(within.pop(what))

    with progress, listening(show):
        task = progress.add_task(message, total=total)
        yield lambda more: progress.advance(task, more)


def draw_without_display() -> None:
    """Have MuJoCo draw by EGL, else by OSMesa, where there is no display and one is installed.

    Call it before anything of a domain is imported, as MuJoCo reads the variable when imported.
    """
    if "DISPLAY" not in os.environ:
        for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
            if find_library(library):
                os.environ.setdefault("MUJOCO_GL", name)
