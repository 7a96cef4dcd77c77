"""What all commands share: options from a dataclass, and errors of one line."""

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from types import FrameType, MappingProxyType
from typing import Any, NoReturn, TypeVar

import click

from cgtorch.commands.completion import Completer, one_of
from cgtorch.ground.errors import CgtorchError

F = TypeVar("F", bound=Callable[..., Any])


def options_of(
    settings: type,
    skip: Sequence[str] = (),
    defaults: Mapping[str, Any] = MappingProxyType({}),
    complete: Mapping[str, Completer] = MappingProxyType({}),
) -> list[click.Option]:
    """One option per field of a dataclass of options (`cgtorch.domains.settings`) but some.

    `defaults` are in place of those of the fields, and shells `complete` those without choices.
    """
    choices = {f.name: f.metadata["choices"] for f in fields(settings)}
    completers = {**complete, **{name: one_of(words) for name, words in choices.items() if words}}
    return [
        click.Option(
            [f"--{f.name.replace('_', '-')}", f.name],
            type=type(f.default),
            default=defaults.get(f.name, f.default),
            show_default=f.default != "",
            help=f.metadata["help"],
            shell_complete=completers.get(f.name),
        )
        for f in fields(settings)
        if f.name not in skip
    ]


def import_from_here(specs: Sequence[str]) -> None:
    """Let "module:Class" name a module in the current folder, as `python -m` would."""
    if any(":" in spec for spec in specs) and "" not in sys.path:
        sys.path.insert(0, "")


@contextmanager
def importing() -> Iterator[None]:
    """For imports that take a second, a sixth of it collecting garbage that is none.

    What has been loaded stays, so it is not looked at afterwards either.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def run_command(command: click.Command) -> None:
    """Run a command and exit: 0 done, 1 it could not be achieved, 2 bad input.

    Bad input ends in one line on stderr that says what and what to do.
    """
    name = command.name or "cgtorch"
    # A thread that cannot write, such as TensorBoard's, stops the command, which says so once.
    previous, threading.excepthook = threading.excepthook, _report_thread
    terminates = signal.signal(signal.SIGTERM, _interrupt)
    try:
        command.main(prog_name=name, standalone_mode=False)
    except click.exceptions.Exit as e:
        sys.exit(e.exit_code)
    except click.ClickException as e:
        _end(name, f"{e.format_message().rstrip('.')}; see {name} --help", 2)
    except CgtorchError as e:
        _end(name, str(e), 1 if isinstance(e, RuntimeError) else 2)
    except (KeyboardInterrupt, click.Abort):
        resumes = any(parameter.name == "resume" for parameter in command.params)
        kept = "; what was done is kept, go on with --resume" if resumes else ""
        _end(name, f"interrupted{kept}", 1)
    except OSError as e:
        where = f" {str(e.filename)[:200]!r}" if e.filename else ""
        reason = e.strerror or type(e).__name__
        _end(name, f"cannot read or write{where} ({reason}); check the path and the disk", 2)
    finally:
        threading.excepthook = previous
        signal.signal(signal.SIGTERM, terminates)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Whoever asks a command to end is treated as who presses Ctrl-C."""
    raise KeyboardInterrupt


def _report_thread(thread: threading.ExceptHookArgs) -> None:
    if not issubclass(thread.exc_type, OSError):
        threading.__excepthook__(thread)


def _end(name: str, message: str, code: int) -> None:
    click.echo(f"{name}: {' '.join(message.split())}", err=True)
    sys.exit(code)
