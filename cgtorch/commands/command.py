"""Common behaviour of all commands: quick imports, and errors in one line."""

import ctypes
import gc
import itertools
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

import click

from cgtorch.ground.errors import CgtorchError


def import_from_here(specs: Sequence[str]) -> None:
    """Let "module:Class" name a module in the current folder, as `python -m` does."""
    if any(":" in spec for spec in specs) and "" not in sys.path:
        sys.path.insert(0, "")


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
    # A thread that cannot write, such as TensorBoard's, stops the command, which says so once.
    previous, threading.excepthook = threading.excepthook, _report_thread
    terminates = signal.signal(signal.SIGTERM, _interrupt)
    try:
        command.main(prog_name=name, standalone_mode=False)
    except click.exceptions.Exit as e:
        sys.exit(e.exit_code)
    except click.ClickException as e:
        context = e.ctx if isinstance(e, click.UsageError) else None
        called = name if context is None else context.command_path
        _end(called, f"{e.format_message().rstrip('.')}; see {called} --help", 2)
    except CgtorchError as e:
        _end(name, str(e), 1 if isinstance(e, RuntimeError) else 2)
    except (KeyboardInterrupt, click.Abort) as e:
        _end_interrupted(name, e)
    except ctypes.ArgumentError as e:
        if KeyboardInterrupt.__name__ not in str(e):
            raise
        _end_interrupted(name, e)  # ctypes raises this for a Ctrl-C in its midst
    except OSError as e:
        where = f" {str(e.filename)[:200]!r}" if e.filename else ""
        reason = e.strerror or type(e).__name__
        _end(name, f"cannot read or write{where} ({reason}); check the path and the disk", 2)
    except Exception as e:
        _end_in_foreign_code(name, e)
        raise
    finally:
        threading.excepthook = previous
        signal.signal(signal.SIGTERM, terminates)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Treat a request to terminate like Ctrl-C."""
    raise KeyboardInterrupt


def _report_thread(thread: threading.ExceptHookArgs) -> None:
    if not issubclass(thread.exc_type, OSError):
        threading.__excepthook__(thread)


def _end_interrupted(name: str, error: BaseException) -> NoReturn:
    notes = (getattr(e, "__notes__", ()) for e in (error, error.__cause__))  # click wraps errors
    _end(name, "; ".join(["interrupted", *itertools.chain(*notes)]), 1)


def _end_in_foreign_code(name: str, error: Exception) -> None:
    """End the command if the error comes from code of the user's own; else return."""
    if "torch" in sys.modules:  # without it, nothing of the user's has been called
        from cgtorch.ground.dry_run import failed_at, reason

        if place := failed_at(error):
            notes = itertools.chain([f"{reason(error)}{place}"], getattr(error, "__notes__", ()))
            _end(name, "; ".join(notes), 1)


def _end(name: str, message: str, code: int) -> NoReturn:
    click.echo(f"{name}: {' '.join(message.split())}", err=True)
    sys.exit(code)
