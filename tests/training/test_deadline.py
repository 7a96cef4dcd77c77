"""The end of the time reaches into a long step."""

import signal
import threading
import time

import pytest

from cgtorch.domains.surroundings import surroundings
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import BudgetSpentError, Purse
from cgtorch.native.rank_processes import in_ranks, others_started
from cgtorch.training import deadline as module
from cgtorch.training.deadline import GRACE, deadline


@pytest.mark.parametrize(("long", "says"), [(1.0, "step 7 has not returned for 2 s"), (9.0, "")])
def test_a_long_step_ends_soon_after_the_time_is_over(
    long: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LONG", long)
    before, began = signal.getsignal(signal.SIGALRM), time.monotonic()
    purse = Purse(until=began - 1.0)
    with pytest.raises(BudgetSpentError, match="the time is over"), deadline(purse):
        surroundings.call(lambda: time.sleep(60), lambda: "step 7")
    assert purse.unreturned == says
    assert GRACE - 0.1 < time.monotonic() - began < GRACE + 40
    assert signal.getsignal(signal.SIGALRM) is before


def test_what_is_settled_is_told_to_its_end() -> None:
    purse, slept = Purse(until=time.monotonic() - 1.0, settled=True), False
    with deadline(purse):
        assert not purse.settled  # as a search begins
        purse.settled = True
        time.sleep(GRACE + 0.5)
        slept = True
    assert slept


def test_what_is_being_told_is_told_to_its_end_before_the_time_is_over() -> None:
    began, purse = time.monotonic(), Purse(until=time.monotonic() - 1.0, telling=True)
    threading.Timer(GRACE + 0.5, lambda: setattr(purse, "telling", False)).start()
    with pytest.raises(BudgetSpentError, match="the time is over"), deadline(purse):
        time.sleep(60)
    assert GRACE + 0.4 < time.monotonic() - began < GRACE + 40


def test_nothing_rings_after_the_context_or_without_a_limit() -> None:
    with deadline(Purse(until=time.monotonic())):
        pass
    with deadline(Purse()):
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_the_alarm_rings_a_while_after_the_end_of_the_time() -> None:
    with deadline(Purse(until=time.monotonic() + 100.0)):
        left = signal.getitimer(signal.ITIMER_REAL)[0]
    assert 90 + GRACE < left <= 100 + GRACE


def test_other_threads_have_no_alarm() -> None:
    found: list[float] = []

    def work() -> None:
        with deadline(Purse(until=time.monotonic())):
            found.append(signal.getitimer(signal.ITIMER_REAL)[0])

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [0]


def test_what_is_asked_after_the_time_is_refused() -> None:
    purse = Purse(until=time.monotonic())
    assert purse.late()
    assert not purse.late(grace=60)
    assert not Purse().late()
    with pytest.raises(BudgetSpentError, match="give more"):
        purse.pay("trials", purse.total)
    assert purse.exhausted


def test_ranks_of_its_own_end_then_and_the_first_goes_on_alone() -> None:
    """Also while it waits for the others."""
    found, began = list[object](), time.monotonic()

    def work() -> None:
        try:
            with deadline(Purse(until=began - 1.0)):
                if not ranks.first():
                    time.sleep(60)
                ranks.all_reduce(1)
        except BudgetSpentError:
            found.extend([ranks.count(), others_started()])

    in_ranks(work, 2)
    assert found == [1, False]
    assert GRACE - 0.1 < time.monotonic() - began < GRACE + 40
