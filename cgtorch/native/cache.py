"""The cache of compiled code: only what is this user's own, and whole, is taken from it."""

import atexit
import os
import shutil
import stat
import struct
import sys
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

ELF, HEADER = b"\x7fELF\x02\x01", 64
"""The begin of a library on Linux, or of a GPU's machine code, and the bytes of its header."""
MACH = b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe"
"""The begins of a library on macOS."""


def cache_folder() -> Path:
    """The folder of compiled code, for this user alone; OSError if it cannot be made.

    Where the usual one is another's, it has this user's number in its name.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    own = f"cgtorch-{os.geteuid()}" if hasattr(os, "geteuid") else "cgtorch"
    for name in ("cgtorch", own):
        (home / name).mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_own(home / name):
            return home / name
    raise PermissionError(f"the cache in {home} belongs to others")


def kept(file: str) -> Path | None:
    """The path of compiled code in the cache; None if it is not there and cannot be written."""
    try:
        path = cache_folder() / file
    except OSError:
        return None
    return path if is_whole(path) or os.access(path.parent, os.W_OK) else None


@cache
def folder_of_process() -> Path:
    """A folder for compiled code of this process and its forks alone, which goes with it.

    It takes the place of a cache that cannot be written, which is said. OSError without any folder
    for temporary files.
    """
    folder = Path(mkdtemp(prefix="cgtorch-"))
    atexit.register(_remove, folder, os.getpid())
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    print(  # noqa: T201
        f"cannot write the cache in {home!r}: compiling into a temporary folder, each time anew; "
        "set XDG_CACHE_HOME to a folder of yours",
        file=sys.stderr,
    )
    return folder


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # and not a fork of it
        shutil.rmtree(folder, ignore_errors=True)


def is_own(path: Path) -> bool:
    """Whether a file or folder, and no link, is this user's, and nobody else can write to it."""
    if not hasattr(os, "geteuid"):
        return True  # a system without users' numbers
    about = path.lstat()
    others = about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return about.st_uid == os.geteuid() and not others and not stat.S_ISLNK(about.st_mode)


def is_whole(path: Path) -> bool:
    """Whether compiled code is there, is this user's, and is not cut off or something else.

    To load a library that was cut would end the process. In ELF the table of sections comes last.
    """
    try:
        own, size = is_own(path), path.stat().st_size
        with path.open("rb") as file:
            head = file.read(HEADER)
    except OSError:
        return False
    if not (own and len(head) == HEADER):
        return False
    if not head.startswith(ELF):
        return head.startswith(MACH)
    (table,), (each, count) = (
        struct.unpack_from("<Q", head, 40),
        struct.unpack_from("<HH", head, 58),
    )
    return bool(table + each * count <= size)
