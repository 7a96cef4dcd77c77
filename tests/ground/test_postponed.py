"""Signals wait for the end of what runs."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from cgtorch.ground.postponed import postponed


@pytest.fixture(autouse=True)
def heard() -> Iterator[list[int]]:
    """The signals that were heard, in their order."""
    found, numbers = list[int](), (signal.SIGTERM, signal.SIGALRM)
    before = [signal.signal(each, lambda number, frame: found.append(number)) for each in numbers]
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield found
    for each, handler in zip((*numbers, signal.SIGINT), (*before, interrupt), strict=True):
        signal.signal(each, handler)


def test_the_first_signal_is_heard_at_the_end(heard: list[int]) -> None:
    handlers = [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)]
    with postponed():
        os.kill(os.getpid(), signal.SIGALRM)
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        assert heard == []
    assert heard == [signal.SIGALRM]
    assert [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)] == handlers


def test_an_interrupt_is_raised_at_the_end() -> None:
    ended = list[bool]()

    def work() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        ended.append(True)

    with pytest.raises(KeyboardInterrupt), postponed():
        work()
    assert ended


def test_an_error_is_told_in_place_of_a_signal(heard: list[int]) -> None:
    def work() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        raise ValueError("first")

    with pytest.raises(ValueError, match="first"), postponed():
        work()
    assert heard == []
    signal.raise_signal(signal.SIGTERM)
    assert heard == [signal.SIGTERM]


def test_other_threads_have_no_signals() -> None:
    done = list[bool]()

    def work() -> None:
        with postponed():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]
