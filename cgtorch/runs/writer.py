"""One writer to a run: a lock on a file that is kept open, which ends with its process.

The lock cannot outlive its process or a reboot, and it stays with a folder that is renamed. What
the file says is only for the one who comes second. The file is removed at the end.
"""

import errno
import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RunError
from cgtorch.ground.files import check_name_of, strict_json, writing

try:
    import fcntl
except ImportError:  # on Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]

WRITER = "writer.lock"
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""The errors of file systems without locks, on which a run is written without one."""
_held = dict[int, tuple[Path, os.stat_result]]()
"""By each open file that is locked, its folder and which one that was."""


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """A context in which no other process, and nobody else in this one, writes to a run.

    The first rank holds the lock for all. RunError if another has it, it or the log cannot be
    written, or the folder has a name that cannot be written, or goes away meanwhile.
    """
    check_name_of(folder)
    _check_log(folder / "log.jsonl")
    failure, file = "", -1
    if ranks.first():
        failure, file = _locked(folder)
    try:
        if said := ranks.broadcast(failure):
            raise RunError(said)
        yield
    except (OSError, RunError) as e:
        if file in _held and (place := place_now(folder)) != folder:
            now = f" but at {str(place)!r}" if place else ""
            raise RunError(
                f"run {str(folder)!r} was moved or removed while this command wrote to it, and is "
                f"no longer there{now}; continue it at its new place (Run.resume, --resume), or "
                "bring it back"
            ) from e
        raise
    finally:
        _release(folder, file)


def _check_log(path: Path) -> None:
    """RunError if a log is there that cannot be written, while the run is still as it was."""
    with writing(path), suppress(FileNotFoundError):
        os.close(os.open(path, os.O_WRONLY | os.O_APPEND))


def check_unwritten(folder: Path) -> None:
    """RunError if another process writes to a run; each rank may ask by itself."""
    failure, file = _locked(folder)
    _release(folder, file)
    if failure:
        raise RunError(failure)


def _locked(folder: Path) -> tuple[str, int]:
    """A message if another has the lock, and the open file, which is the one in the folder.

    An earlier writer may remove the file after it was opened here, and before it was locked.
    """
    while True:
        with writing(folder):
            file = os.open(folder / WRITER, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            failure = _refused(folder, file)
        except BaseException:  # such as of a full disk
            _release(folder, file)
            raise
        if failure:
            return failure, file
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), os.stat(folder / WRITER)):
                return "", file
        _held.pop(file, None)
        os.close(file)


def _release(folder: Path, file: int) -> None:
    """Remove the file and the lock, if they are held, and close an open file."""
    if file in _held:
        with suppress(OSError):
            if place := place_now(folder):
                os.unlink(place / WRITER)
        fcntl.flock(file, fcntl.LOCK_UN)  # also for forked processes that have the file
    _held.pop(file, None)
    if file >= 0:
        os.close(file)


def _refused(folder: Path, file: int) -> str:
    """Lock an open file, and write into it who has it; a message if another has."""
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _held[file] = folder, os.stat(folder)
    except BlockingIOError:
        return (
            f"run {str(folder)!r} is written by {_about(os.pread(file, 4096, 0))}; wait for its "
            "end, stop it, or train in another folder (folder, --run-dir)"
        )
    except OSError as e:
        if e.errno not in NO_LOCKS:
            raise
    about = {"process": os.getpid(), "machine": platform.node(), "since": int(time.time())}
    with writing(folder):
        os.ftruncate(file, 0)
        os.pwrite(file, json.dumps(about).encode(), 0)
    return ""


def _about(said: bytes) -> str:
    """Who writes, and since when, as far as the file tells."""
    try:
        about = strict_json(said.decode())
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(int(about["since"])))
        return f"process {int(about['process'])} on {about['machine']!s:.40} since {since}"
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError, OSError):
        return "another process"


def place_now(folder: Path) -> Path | None:
    """Where the run is to which this process writes: in its folder, or where that was moved.

    None if it was removed, or the system does not tell where it is.
    """
    held = [(file, which) for file, (place, which) in _held.items() if place == folder]
    if not held:
        return folder
    file, which = held[-1]
    for link in (folder, Path(f"/proc/self/fd/{file}")):
        with suppress(OSError):
            place = folder if link is folder else Path(os.readlink(link)).parent
            if os.path.samestat(which, os.stat(place)):
                return place
    return None


def _let_go() -> None:
    """Close the files in a forked process, which would hold the locks beyond its parent's end."""
    for file in _held:
        with suppress(OSError):
            os.close(file)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)
