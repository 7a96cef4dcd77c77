"""The end of the time of a training, also in the midst of a long step."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from types import FrameType

from cgtorch.domains.surroundings import surroundings
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import LATE, BudgetSpentError, Purse
from cgtorch.native.rank_processes import end_others, others_started

GRACE = 2.0  # s, in which a step ends by itself
LONG = 10.0  # s, more than calls of the user's code take as a rule
SOON = 0.2  # s after which it rings again, where something was being told


@contextmanager
def deadline(purse: Purse) -> Iterator[None]:
    """A context that is left by a BudgetSpentError soon after the time of a purse is over.

    It is not left once the purse is settled, as what is only to be told would be lost, nor in the
    midst of telling, which may import something for its pictures.

    Steps look at the clock between generations, and one may take minutes. Only the main thread has
    this alarm, where the system has one, of a single process or of one that has started the other
    ranks itself. These end then, as they cannot all be broken off at the same place.
    """
    main = threading.current_thread() is threading.main_thread()
    alone = ranks.count() == 1 or others_started()
    if purse.until == inf or not main or not alone or not hasattr(signal, "setitimer"):
        yield
        return

    purse.settled = False

    def ring(number: int, frame: FrameType | None) -> None:
        if purse.settled:
            return
        if purse.telling:
            signal.setitimer(signal.ITIMER_REAL, SOON)
            return
        end_others()
        purse.unreturned = surroundings.unreturned(LONG)
        raise BudgetSpentError(LATE)

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, max(GRACE, purse.until + GRACE - time.monotonic()))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
