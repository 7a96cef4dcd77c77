"""Interrupts of a command, which come again where a library's own code has dropped them."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import NoReturn

SOON = 0.5  # s between two looks at whether an interrupt is being followed
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class _Interrupts:
    """Those of the command that runs.

    Attributes:
        pending: Whether a signal has come that nothing has followed yet.
    """

    def __init__(self) -> None:
        self.pending, self._over = False, threading.Event()

    @contextmanager
    def heard(self) -> Iterator[None]:
        """A context in which a request to terminate, or a closed terminal, is like Ctrl-C.

        Each raises KeyboardInterrupt. What is ignored before, as by nohup, stays ignored.
        """
        self.pending, self._over = False, threading.Event()
        numbers = [getattr(signal, each) for each in NAMES if hasattr(signal, each)]
        before = {each: signal.getsignal(each) for each in numbers}
        for each, handler in before.items():
            if handler != signal.SIG_IGN:
                signal.signal(each, partial(self._raise, os.getpid()))
        try:
            yield
        finally:
            self._over.set()
            for each, handler in before.items():
                signal.signal(each, handler)

    @contextmanager
    def awaited(self) -> Iterator[None]:
        """A context that an interrupt leaves, as it has no other end."""
        try:
            yield
        except KeyboardInterrupt:
            self.pending = False
            self._over.set()

    def _raise(self, process: int, number: int, frame: FrameType | None) -> NoReturn:
        """Raise KeyboardInterrupt; end a process without a word that was forked from this one."""
        if os.getpid() != process:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        if not self.pending:
            self.pending = True
            about = number, threading.main_thread().ident or 0, self._over
            threading.Thread(target=_insist, args=about, daemon=True).start()
        raise KeyboardInterrupt


def _insist(number: int, main: int, over: threading.Event) -> None:
    """Send a signal again as long as the main thread does not follow it, such as by clean-up.

    Whatever is called back drops exceptions: where objects end, in imports, and in compiled code.
    """
    while not over.wait(SOON):
        if not _interrupted(main):
            signal.pthread_kill(main, number)


def _interrupted(thread: int) -> bool:
    """Whether a thread is handling a KeyboardInterrupt, or an error that has come of one."""
    found = sys._current_exceptions().get(thread)
    error: BaseException | None = found[1] if isinstance(found, tuple) else found
    seen = set[int]()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


interrupts = _Interrupts()
