"""Options that mean the same wherever a command has them, and what every command has."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import click

from cgtorch.commands import completion
from cgtorch.commands.command import import_from_here
from cgtorch.ground.errors import RunError

F = TypeVar("F", bound=Callable[..., Any])


def epilog(examples: str) -> str:
    """What ends the help of every command: its examples and what it exits with."""
    codes = "Exit codes: 0 done; 1 the task failed or was interrupted; 2 bad input."
    return f"{examples.rstrip()}\n\n{codes}"


def _print_script(context: click.Context, parameter: click.Parameter, shell: str | None) -> None:
    if shell is not None and not context.resilient_parsing:
        click.echo(completion.script(shell))
        context.exit()


def _importable(context: click.Context, parameter: click.Parameter, specs: Any) -> Any:
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
    """Decorator: the options that every command has, to stand last."""
    options = (
        click.option(
            "--actions",
            multiple=True,
            shell_complete=completion.declared_actions,
            callback=_importable,
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
    callback=_importable,
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
    """Decorator: which file or folder is written."""
    return click.option("--output", type=click.Path(path_type=Path), required=True, help=what)


def check_output(output: Path, force: bool) -> None:
    """RunError if there is a folder, or a file that may not be replaced."""
    if output.is_dir():
        raise RunError(f"{str(output)!r} is a folder; choose another --output")
    if output.exists() and not force:
        raise RunError(f"{str(output)!r} exists; choose another --output or add --force")


def scenario_options(scenarios: str, count: str, seed: str, most: int) -> Callable[[F], F]:
    """Decorator: which scenarios, how many up to so many, and their seed, each with its help."""
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
    """Decorator: a number within bounds."""
    return click.option(name, type=kind, default=default, show_default=True, help=what)


@contextmanager
def waiting(message: str, quiet: bool, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """On a terminal, show on one live line what is waited for, how long, and how much is done.

    What it yields is told how much more of the `total` has been done.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    console = Console(stderr=True)
    counted = (BarColumn(24), MofNCompleteColumn()) if total is not None else ()
    progress = Progress(
        SpinnerColumn(),
        TextColumn("{task.description} …", markup=False),
        *counted,
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )
    with progress:
        task = progress.add_task(message, total=total)
        yield lambda more: progress.advance(task, more)
