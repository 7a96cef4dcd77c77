"""Ranks that a process starts itself, on this machine: forks of it, which do its work together.

The first rank is the process that starts the others, and the only one that writes and speaks. The
others end with it, whatever becomes of it, and so do processes that code of the user's has started
in them. They do not hear Ctrl-C, which is for the first.
"""

import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NoReturn

from torch._C._distributed_c10d import FileStore

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.native.processes import follow

LOCAL = "LOCAL_WORLD_SIZE"  # the variable of torchrun that `ranks.cores` reads
PATIENCE = 10.0  # s in which a rank says why it has ended, or ends after all others
LOOK = 0.1  # s after which it is looked whether one has ended


@dataclass(frozen=True)
class Other:
    """Another rank: its process, and the line on which it says why it has failed."""

    process: ForkProcess
    line: Connection


_others = list[Other]()


def in_ranks(work: Callable[[], None], count: int) -> None:
    """Do work in `count` processes, which share its rows (`cgtorch.ground.distributed`).

    The work is called in all of them, and has to do the same. An error of any of them is raised
    here, RunError if one was killed. Where there are ranks already, and on a system that cannot
    fork, the work is called in this process only.
    """
    forks = "fork" in multiprocessing.get_all_start_methods()
    if count < 2 or ranks.count() > 1 or not forks:
        work()
        return
    before = os.environ.get(LOCAL)
    os.environ[LOCAL] = str(count)
    with TemporaryDirectory() as folder:
        meet = str(Path(folder) / "ranks")
        try:
            _start(work, meet, count)
            with ranks.joined(FileStore(meet, count), 0, count):
                _first(work)
            _say_why_not()
        except ranks.RankLostError as e:
            _say_why_not(e)
            raise
        finally:
            end_others()
            os.environ.pop(LOCAL)
            if before is not None:
                os.environ[LOCAL] = before


def end_others() -> None:
    """End the other ranks if this process has started any, and go on alone."""
    if not _others:
        return
    os.environ[LOCAL] = "1"
    for other in _others:
        with suppress(ProcessLookupError, PermissionError):  # where it has no group (yet, or more)
            os.killpg(other.process.pid or 0, signal.SIGKILL)
        other.process.kill()
    for other in _others:
        other.process.join()
        other.line.close()
    _others.clear()
    ranks.leave()


def others_started() -> bool:
    """Whether this process is the first of ranks that it has started."""
    return bool(_others)


def _first(work: Callable[[], None]) -> None:
    """Do the work as the first rank, which does not wait for others where it is broken off."""
    try:
        work()
    except ranks.RankLostError:
        raise
    except BaseException:
        end_others()
        raise


def _start(work: Callable[[], None], meet: str, count: int) -> None:
    context = multiprocessing.get_context("fork")
    gc.collect()  # a fork cannot free earlier ranks' groups, as it lacks their threads
    for rank in range(1, count):
        line, other_end = context.Pipe(duplex=False)
        about = work, meet, rank, count, os.getpid(), other_end
        # It is no daemon, as those may not start the processes that an environment may need.
        process = context.Process(target=_other, args=about, daemon=False)
        process.start()
        other_end.close()
        _others.append(Other(process, line))


def _other(
    work: Callable[[], None], meet: str, rank: int, count: int, parent: int, line: Connection
) -> NoReturn:
    """Do the work as another rank, and end the process."""
    os.setpgid(0, 0)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the first rank hears it, and ends this one
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=follow, args=(parent, True), daemon=True).start()
    sys.stdout = sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115  as long as the process
    for stream in (1, 2):  # of the system, as libraries write there
        os.dup2(sys.stdout.fileno(), stream)
    _others.clear()
    failed = True
    try:
        with ranks.joined(FileStore(meet, count), rank, count):
            work()
        failed = False
    except ranks.RankLostError:
        pass  # that one says why
    except BaseException as e:
        line.send_bytes(_pickled(e))
    finally:
        os._exit(failed)


def _pickled(error: BaseException) -> bytes:
    try:
        found = pickle.dumps(error)
        pickle.loads(found)  # noqa: S301  some cannot be read again
    except Exception:
        found = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return found


def _say_why_not(lost: ranks.RankLostError | None = None) -> None:
    """Raise the error of another rank, if one has failed; wait for those that have not ended.

    Processes that code of the user's has forked from a rank keep its sentinel and its line open.
    """
    running, until = list(_others), time.monotonic() + PATIENCE
    while running and time.monotonic() < until:
        wait([other.process.sentinel for other in running], LOOK)
        for other in [each for each in running if not each.process.is_alive()]:
            running.remove(other)
            until = time.monotonic() + PATIENCE
            with suppress(EOFError):  # it has said nothing
                if other.line.poll():
                    raise pickle.loads(other.line.recv_bytes()) from lost  # noqa: S301  of our own
            if (code := other.process.exitcode) and code < 0:
                place, count = _others.index(other) + 2, len(_others) + 1
                raise RunError(
                    f"process {place} of {count} of this run was killed by signal {-code}, "
                    f"{_perhaps(-code)}; finished work is kept; continue with --resume, with "
                    "fewer processes if it happens again (--processes)"
                ) from lost


def _perhaps(number: int) -> str:
    """Why a process may have been killed by a signal."""
    if number in (signal.SIGKILL, signal.SIGTERM):
        return "perhaps because memory ran out"
    name = signal.strsignal(number) or "no known one"
    return f"which compiled code raises, perhaps that of an environment ({name.lower()})"
