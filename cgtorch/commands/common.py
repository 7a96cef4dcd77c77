"""Shared by all commands: quick imports, errors in one line, options, and signs of progress."""

import ctypes
import gc
import itertools
import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from functools import reduce
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from cgtorch.commands import completion
from cgtorch.commands.aside import foreign_reason, tell_in_lines
from cgtorch.commands.interrupts import interrupts
from cgtorch.commands.standard_modules import import_from_here
from cgtorch.ground.ending import end_in_time
from cgtorch.ground.errors import CgtorchError, WorldError, printable

F = TypeVar("F", bound=Callable[..., Any])


@contextmanager
def importing() -> Iterator[None]:
    """A context for slow imports, without garbage collection, which saves a sixth of the time."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def resumable(command: str) -> Iterator[None]:
    """A context for work that another command continues, which an interrupt then says."""
    try:
        yield
    except BaseException as e:
        e.add_note(f"finished work is kept; continue with {command}")
        raise


def run_command(command: click.Command) -> None:
    """Run a command and exit: 0 done, 1 not achieved, 2 bad input, with one line on stderr."""
    name = command.name or "cgtorch"
    tell_no_more = tell_in_lines(name)
    with interrupts.heard():
        try:
            _call(command, name)
        except click.exceptions.Exit as e:
            sys.exit(e.exit_code)
        except click.ClickException as e:
            context = e.ctx if isinstance(e, click.UsageError) else None
            called = name if context is None else context.command_path
            _end(called, f"{e.format_message().rstrip('.')}; see {called} --help", 2)
        except CgtorchError as e:
            notes = getattr(e, "__notes__", ()) if isinstance(e, WorldError) else ()
            _end(name, "; ".join([str(e), *notes]), 1 if isinstance(e, RuntimeError) else 2)
        except (KeyboardInterrupt, click.Abort, ctypes.ArgumentError) as e:
            # ctypes raises an error of its own for a Ctrl-C in its midst.
            if isinstance(e, ctypes.ArgumentError) and KeyboardInterrupt.__name__ not in str(e):
                raise
            # click wraps errors, so notes may be those of the cause.
            notes = (getattr(each, "__notes__", ()) for each in (e, e.__cause__))
            _end(name, "; ".join(["interrupted", *itertools.chain(*notes)]), 1)
        except OSError as e:
            if e.errno is None:  # code has raised it, and not the system
                _end_if_known(name, e)
            name_of = os.fsdecode(e.filename) if isinstance(e.filename, bytes) else e.filename
            where = repr(str(name_of)[:200]) if name_of else "its output or a file"
            reason = e.strerror or type(e).__name__
            said = f"cannot read or write {where} ({reason}); check the path and the disk"
            _end(name, "; ".join([said, *getattr(e, "__notes__", ())]), 2)
        except (Exception, SystemExit) as e:
            _end_if_known(name, e)
            raise
        finally:
            tell_no_more()


def run_program(command: click.Command) -> None:
    """Run a command as the whole work of this process, which then ends, whatever is left in it.

    `run_command` does the same where the process goes on.
    """
    name = command.name or "cgtorch"
    tell_in_lines(name)
    try:
        run_command(command)
    except BaseException as e:
        code: Any = e.code if isinstance(e, SystemExit) else 1
        end_in_time(name, code).set()  # with the error, objects of the user's end, perhaps never
        raise
    end_in_time(name, 0)


def _call(command: click.Command, name: str) -> None:
    """Run a command; what fails after an interrupt was interrupted, whatever it says.

    In the midst of a library's own code, an interrupt can come out as another error.
    """
    try:
        command.main(prog_name=name, standalone_mode=False)
    except (click.exceptions.Exit, click.Abort):
        raise
    except Exception as e:
        if interrupts.pending:
            raise KeyboardInterrupt from e
        raise
    if interrupts.pending:
        raise KeyboardInterrupt


def _end_if_known(name: str, error: BaseException) -> None:
    """End the command if the error is of memory or of code of the user's own; else return."""
    if isinstance(error, MemoryError) or re.search("llocate memory|ut of memory", str(error)):
        said = "memory ran out; use a smaller population, fewer percepts or fewer processes"
        _end(name, "; ".join([said, *getattr(error, "__notes__", ())]), 1)
    if said := foreign_reason(error):
        _end(name, "; ".join([said, *getattr(error, "__notes__", ())]), 1)


def say(line: str) -> None:
    """Print a line of a result, as text: what is foreign in it cannot control a terminal."""
    click.echo(printable(line))


def _end(name: str, message: str, code: int) -> NoReturn:
    click.echo(printable(f"{name}: {' '.join(message.split())}"), err=True)
    sys.exit(code)


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
COMMON = (
    click.option(
        "--actions",
        multiple=True,
        shell_complete=completion.declared_actions,
        callback=importable,
        help="Additional action for skills: a name or package.module:Class. Repeat the option for "
        "several actions.",
    ),
    click.option("--quiet", is_flag=True, help="Print the result only, without progress."),
    click.version_option(package_name="cgtorch"),
    completion_option,
)


def command(name: str, examples: str, **how: Any) -> Callable[[Callable[..., None]], click.Command]:
    """Decorator: a command whose help has examples, and which has the options of every command."""

    def made(function: Callable[..., None]) -> click.Command:
        decorate: Any = click.command(name, epilog=epilog(examples), **how)
        found: click.Command = decorate(function)
        for option in COMMON:
            option(found)
        return found

    return made


A_PATH = click.Path(path_type=Path)
run_or_skill = click.argument(
    "path", metavar="RUN_OR_SKILL", type=A_PATH, shell_complete=completion.runs_or_skills
)
skill_option = click.option(
    "--skill",
    "name",
    shell_complete=completion.skill_names,
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


def a_number(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
    """Refuse nan, which no bound of a number does."""
    if isinstance(value, float) and math.isnan(value):
        raise click.BadParameter("nan is no number")
    return value


def number_option(
    name: str, kind: click.IntRange | click.FloatRange, default: float, what: str
) -> Callable[[F], F]:
    """Decorator: an option for a number within bounds."""
    about: Any = {"default": default, "show_default": True, "help": what}
    return click.option(name, type=kind, callback=a_number, **about)


def scenario_options(scenarios: str, count: str, seed: str, most: int) -> Callable[[F], F]:
    """Decorator: the kind of scenarios, their number (at most `most`) and seed, with their help."""
    kind = completion.one_of(completion.SCENARIOS)
    options = (
        click.option("--scenarios", shell_complete=kind, help=scenarios),
        number_option("--count", click.IntRange(1, most), 40, count),
        number_option("--seed", click.IntRange(0, 2**31 - 1), 0, seed),
    )
    return lambda function: reduce(lambda f, option: option(f), reversed(options), function)


@contextmanager
def waiting(message: str, quiet: bool, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """Show on a terminal a live line with a message, the elapsed time, and the work done.

    Yields a function to call with the amount of further work done, of `total`. Long work that is
    counted within has a line of its own until it is done (`cgtorch.native.processes`). Without a
    terminal, lines tell now and then of work that takes long.
    """
    from rich import progress as rich
    from rich.console import Console

    from cgtorch.native.processes import counted, listening

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        from cgtorch.report.progress import ProgressDisplay

        with ProgressDisplay(console, quiet):
            yield counted(printable(message), total or 1)
        return
    columns = [rich.SpinnerColumn(), rich.TextColumn("{task.description} …", markup=False)]
    columns += [rich.BarColumn(24), rich.MofNCompleteColumn()] if total is not None else []
    columns += [rich.TimeElapsedColumn()]
    columns += [rich.TextColumn("left"), rich.TimeRemainingColumn()] if total is not None else []
    progress = rich.Progress(*columns, console=console, transient=True)
    within: dict[str, Any] = {}

    def show(what: str, done: int, of: int) -> None:
        if what not in within:
            within[what] = progress.add_task(what, total=of)
        progress.update(within[what], completed=done, total=of)
        if done == of:
            progress.remove_task(within.pop(what))

    with progress, listening(show):
        task = progress.add_task(printable(message), total=total)
        yield lambda more: progress.advance(task, more)


def draw_without_display() -> None:
    """Have MuJoCo draw by EGL, else by OSMesa, where there is no display and one is installed.

    Call it before anything of a domain is imported, as MuJoCo reads the variable when imported.
    """
    if "DISPLAY" not in os.environ:
        for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
            if find_library(library):
                os.environ.setdefault("MUJOCO_GL", name)
