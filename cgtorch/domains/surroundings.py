"""What belongs to the whole process, and stays as it is when code of the user's changes it."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from time import perf_counter
from typing import Any, TextIO

import torch

from cgtorch.ground.dry_run import check_default_type
from cgtorch.ground.errors import DomainError


class _Surroundings:
    """Those of environments, which have a working folder of their own, and no more than that."""

    folder = ""
    mask = -1  # of new files, which can be read only by setting it
    depth = 0  # of calls, at most
    modules: tuple[str, ...] = ()  # the folders in which they are found
    _called: tuple[Callable[[], str], float] | None = None  # what is under way, and since when

    def begin(self) -> None:
        """Read what has to stay, before an environment is made."""
        self.mask = os.umask(0o77)
        os.umask(self.mask)
        self.depth, self.modules = sys.getrecursionlimit(), tuple(sys.path)

    def call(self, code: Callable[[], Any], name: Callable[[], str]) -> Any:
        """The result of foreign code, called in the folder where it last was, if that is there.

        `name` says what it is, if it does not return.
        """
        here = _folder()
        if here and self.folder:
            with suppress(FileNotFoundError):
                os.chdir(self.folder)
        streams, learns = (sys.stdout, sys.stderr), torch.is_grad_enabled()
        self._called = name, perf_counter()
        try:
            return code()
        finally:
            self._called = None
            self._restore(streams, learns)
            if here:
                self.folder = _folder()
                if self.folder == here:
                    self.folder = ""
                else:
                    os.chdir(here)

    def unreturned(self, after: float) -> str:
        """Which call has not returned after so many seconds; "" if none."""
        if (called := self._called) is None or perf_counter() - called[1] < after:
            return ""
        name, began = called
        return f"{name()} has not returned for {perf_counter() - began:.0f} s"

    def _restore(self, streams: tuple[TextIO, TextIO], learns: bool) -> None:
        """Restore all that is not the working folder; it may take no time, as steps are many."""
        sys.stdout, sys.stderr = _open(streams[0], 1), _open(streams[1], 2)
        if torch.is_grad_enabled() != learns:
            torch.set_grad_enabled(learns)
        if self.mask >= 0:
            os.umask(self.mask)
        if sys.getrecursionlimit() < self.depth:
            sys.setrecursionlimit(self.depth)
        if len(sys.path) < len(self.modules):
            sys.path += [each for each in self.modules if each not in sys.path]


def _folder() -> str:
    """The working folder; "" if it was deleted."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return ""


def _open(stream: TextIO, number: int) -> TextIO:
    """A standard stream, opened again if it was closed."""
    closed = getattr(stream, "closed", False)
    return open(number, "w", closefd=False) if closed else stream


surroundings = _Surroundings()


def check_defaults(who: str) -> None:
    """DomainError if an environment has changed what torch makes new tensors of, and where."""
    check_default_type(who)
    if (place := torch.get_default_device()).type != "cpu":
        raise DomainError(
            f"{who} sets torch's default device to {place}, where skills cannot be computed; leave "
            "it at cpu, and give tensors of yours their device (device=...)"
        )
