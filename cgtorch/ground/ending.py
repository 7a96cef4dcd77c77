"""The end of a process, for which code of the user's may have something to do, but not for ever."""

import atexit
import os
import sys
import threading
from collections.abc import Callable

PATIENCE = 10.0  # s for which a process that has done its work waits for code of the user's

at_end: Callable[[Callable[[], object]], object] = getattr(
    threading, "_register_atexit", atexit.register
)
"""Has a function called at the end, before threads that an environment has started are joined."""


def end_in_time(name: str, code: int, patience: float = PATIENCE) -> threading.Event:
    """Have this process end with that code when it ends, also if code of the user's goes on.

    Python waits for threads and child processes that are no daemons, and for what has been
    registered for its end, perhaps for ever. Until the process ends, nothing happens, or until the
    returned event is set, where it is sure that it ends.
    """
    ending = threading.Event()

    def watch() -> None:
        ending.wait()
        threading.Event().wait(patience)
        sys.stderr.write(
            f"{name}: a thread, a process or a close() of code that this command has called does "
            "not end; the command, whose work is done, ends without it\n"
        )
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)

    # It begins now, as no thread can begin when the interpreter has begun to end.
    threading.Thread(target=watch, daemon=True).start()
    at_end(ending.set)
    return ending
