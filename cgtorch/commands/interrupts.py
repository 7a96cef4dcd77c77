"""Interrupts of a command, which come again where a library's own code has dropped them."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType

SOON = 0.5  # s between two looks at whether an interrupt is being followed
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class _Interrupts:
    """Those of the command that runs.

    Attributes:
        pending: Whether a signal has come that nothing has followed yet.
    """

    def __init__(self) -> None:
        self.pending, self._over = False, _Over()

    @contextmanager
    def heard(self) -> Iterator[None]:
        """A context in which a request to terminate, or a closed terminal, is like Ctrl-C.

        Each raises KeyboardInterrupt. What is ignored before, as by nohup, stays ignored.
        """
        self.pending, self._over = False, _Over()
        numbers = [getattr(signal, each) for each in NAMES if hasattr(signal, each)]
        before = {each: signal.getsignal(each) for each in numbers}
        for each, handler in before.items():
            if handler != signal.SIG_IGN:
                signal.signal(each, partial(self._raise, os.getpid()))
        try:
            yield
        finally:
            self._over.come()
            for each, handler in before.items():
                signal.signal(each, handler)

    @contextmanager
    def awaited(self) -> Iterator[None]:
        """A context that an interrupt leaves, as it has no other end."""
        try:
            yield
        except KeyboardInterrupt:
            self._over.come()
            self.pending, self._over = False, _Over()

    def _raise(self, process: int, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt if there is something to interrupt.

        A process that was forked from this one ends without a word.
        """
        if os.getpid() != process:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        if self._over.is_set():
            return
        if not self.pending:
            self.pending = True
            about = number, threading.main_thread().ident or 0, self._over
            threading.Thread(target=_insist, args=about, daemon=True).start()
        raise KeyboardInterrupt


class _Over(threading.Event):
    """Set when an interrupt has been followed: no signal is sent after that."""

    def __init__(self) -> None:
        super().__init__()
        self._sending = threading.Lock()

    def come(self) -> None:
        """Set this, between two signals; one that is just coming interrupts nothing."""
        while not self.is_set():
            with suppress(KeyboardInterrupt), self._sending:
                self.set()

    def unless(self, send: Callable[[], None]) -> None:
        """Send a signal unless this is set, which it is not before that was sent."""
        with self._sending:
            if not self.is_set():
                send()


def _insist(number: int, main: int, over: _Over) -> None:
    """Send a signal again as long as the main thread does not follow it, such as by clean-up.

    Whatever is called back drops exceptions: where objects end, in imports, and in compiled code.
    """
    while not over.wait(SOON):
        if not _interrupted(main):
            over.unless(partial(signal.pthread_kill, main, number))


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
