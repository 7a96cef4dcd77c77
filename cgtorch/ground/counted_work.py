"""How far long work has come, told where it is done and shown by whoever listens.

As a logger's records, what is told changes no result, and where nobody listens nothing happens. So
work that is deep below a command need not be handed a display.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeAlias

Listener: TypeAlias = Callable[[str, int, int], None]
"""Is told what is counted, how much of it is done, and how much there is in all."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """A context in which a listener is told, and no other."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def counted(what: str, total: int) -> Callable[[int], None]:
    """Tell that `total` of something will be done; what is returned is called with each more."""
    done = 0

    def more(count: int) -> None:
        nonlocal done
        done = min(done + count, total)
        listener = _listener.get()
        if listener is not None:
            listener(what, done, total)

    more(0)
    return more
