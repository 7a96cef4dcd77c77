"""A copy of the repository, and processes that begin with all that tests import of others.

To import torch takes a second and more, so one process does so, and is forked for each trial.
"""

import importlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

COMMON = 5
"""Files that import a module of others, for it to be imported once for all trials."""
MEMORY = 8 * 2**30
"""Bytes that a trial may use."""


_IMPORT = re.compile(r"^\s*(?:import|from) ([a-zA-Z][\w.]*)", re.MULTILINE)


def common_modules(root: Path) -> list[str]:
    """Modules of others that several files of the package and its tests import."""
    count = Counter[str]()
    for folder in ("cgtorch", "tests"):
        for path in (root / folder).rglob("*.py"):
            count.update(set(_IMPORT.findall(path.read_text(encoding="utf-8"))))
    common = sorted(name for name, files in count.items() if files >= COMMON)
    return [name for name in common if name.partition(".")[0] != "cgtorch"]


class Workshop:
    """A copy of what git knows and does not ignore, in which files may be changed.

    Attributes:
        root: The copy.
        work: An empty folder for anything else.
        made: What tests share that takes long to make; each process gets a copy.
        log: What the latest process printed.
    """

    def __init__(self, source: Path, folder: Path) -> None:
        self.root, self.work, self._stamp = folder / "copy", folder / "work", time.time()
        self.made, self.log = self.work / "made", self.work / "log"
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        known = subprocess.run(listed, cwd=source, check=True, capture_output=True).stdout
        for name in filter(None, known.decode().split("\0")):
            if (source / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source / name, self.root / name)
        self.made.mkdir(parents=True)
        (self.work / "temporary").mkdir()
        for name in common_modules(self.root):
            with suppress(ImportError):
                importlib.import_module(name)

    def write(self, file: str, content: bytes) -> None:
        """Change a file, so that Python sees the change even within the same second."""
        self._stamp += 10
        (self.root / file).write_bytes(content)
        os.utime(self.root / file, (self._stamp, self._stamp))

    @contextmanager
    def changed(self, file: str, content: bytes) -> Iterator[None]:
        """A file is another one for a while."""
        before = (self.root / file).read_bytes()
        self.write(file, content)
        try:
            yield
        finally:
            self.write(file, before)

    def forked(self, job: Callable[[], int], seconds: float) -> int:
        """The exit code of a job in a process of its own, negative if a signal or time ended it."""
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            self._child(job)
        done, status = _waited(pid, seconds)
        shutil.rmtree(self.work / "temporary")
        (self.work / "temporary").mkdir()
        return os.waitstatus_to_exitcode(status) if done else -signal.SIGALRM

    def _child(self, job: Callable[[], int]) -> NoReturn:
        code = 70
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
            with Path(os.devnull).open("r+b") as nothing, self.log.open("wb") as log:
                os.dup2(nothing.fileno(), 0)
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), 2)
            os.chdir(self.root)
            temporary = self.work / "temporary"
            made = shutil.copytree(self.made, temporary / "made")
            os.environ.update(
                PYTHONPATH=str(self.root), TMPDIR=str(temporary), CGTORCH_MADE_ONCE=str(made)
            )
            os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
            sys.dont_write_bytecode = False
            sys.path.insert(0, str(self.root))
            code = job()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)


def _waited(pid: int, seconds: float) -> tuple[bool, int]:
    """Whether a process ends in time, and its status; it and what it has begun are then ended."""
    end, done, status = time.monotonic() + seconds, 0, 0
    try:
        while not done and time.monotonic() < end:
            done, status = os.waitpid(pid, os.WNOHANG)
            time.sleep(0.0 if done else 0.02)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
        if not done:
            os.waitpid(pid, 0)
    return bool(done), status
