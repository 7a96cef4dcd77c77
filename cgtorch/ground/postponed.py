"""Signals that are heard after what runs, such as a robot's action, which has to be logged."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

BREAKING = ("SIGINT", "SIGTERM", "SIGHUP", "SIGALRM")  # Ctrl-C, requests to end, and the alarm


@contextmanager
def postponed() -> Iterator[None]:
    """A context that no signal breaks off: the first one is heard when the context ends.

    If an error ends the context, that is told, and the signal is not. Only the main thread hears
    signals, so in others the context does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = list[int]()
    numbers = [getattr(signal, name) for name in BREAKING if hasattr(signal, name)]
    before = {each: signal.getsignal(each) for each in numbers}
    own = {each: handler for each, handler in before.items() if callable(handler)}
    for each in own:
        signal.signal(each, lambda number, frame: heard.append(number))
    try:
        yield
    finally:
        for each, handler in own.items():
            signal.signal(each, handler)
    for number in heard[:1]:
        signal.raise_signal(number)
