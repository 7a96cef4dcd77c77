"""Errors that Python reports beside the work of a command, in threads and where objects end."""

import sys
import threading
from collections.abc import Callable

import click

from cgtorch.ground.errors import printable


def foreign_reason(error: BaseException) -> str:
    """What an error says and where, if it comes from code of the user's own; else ""."""
    if "torch" not in sys.modules:  # without it, nothing of the user's has been called
        return ""
    from cgtorch.ground.dry_run import failed_at, reason

    place = failed_at(error)
    return f"{reason(error)}{place}" if place else ""


def tell_in_lines(name: str) -> Callable[[], None]:
    """Say each such error of the user's own code once, in a line; returns what ends this.

    Other errors have their traceback, but for a thread that cannot write, such as TensorBoard's:
    it stops the command, which says so once.
    """
    before, told = (threading.excepthook, sys.unraisablehook), set[str]()

    def is_told(what: str, error: BaseException | None) -> bool:
        said = foreign_reason(error) if error else ""
        if said and said not in told:
            told.add(said)
            click.echo(printable(f"{name}: {what} raised {said}; it goes on without"), err=True)
        return bool(said)

    def in_thread(found: threading.ExceptHookArgs) -> None:
        ours = not is_told("a thread", found.exc_value)
        if ours and not issubclass(found.exc_type, OSError):
            threading.__excepthook__(found)

    def unraisable(found: "sys.UnraisableHookArgs") -> None:
        if isinstance(found.exc_value, KeyboardInterrupt):  # which comes again
            return
        if not is_told("what ends an object or the program", found.exc_value):
            sys.__unraisablehook__(found)

    def end() -> None:
        threading.excepthook, sys.unraisablehook = before

    threading.excepthook, sys.unraisablehook = in_thread, unraisable
    return end
