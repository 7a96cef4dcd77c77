"""Which lines of the package each test runs, and how long it takes."""

import hashlib
import importlib
import json
import os
import resource
import signal
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import FrameType

import coverage
import pytest

from mutants.c_functions import NATIVE, exported, listen
from mutants.workshop import Workshop

LONGEST = 10.0
"""Seconds of a CPU after which a test is ended, and is not among the closest."""
MADE = {"trained": "make_run", "told_stage": "make_stage"}
"""Modules of tests and functions that make what is shared, which has the module's name."""
WAITING = 10
"""Seconds that a test may wait for each second that it may calculate."""


@dataclass(frozen=True)
class Recording:
    """A test that passes.

    Attributes:
        test: Its name for pytest.
        seconds: Time of a CPU, with all processes that it waited for.
        lines: For each file of the package that it or the fixtures of its file run, which lines; of
            C files, where the functions begin that are called.
    """

    test: str
    seconds: float
    lines: dict[str, list[int]]


def recorded(shop: Workshop, file: str, cache: Path) -> list[Recording]:
    """The tests of a file, from the cache if the tests are still the same.

    A file of the package that has changed since they were recorded has no lines.
    """
    helpers = [p for p in sorted((shop.root / "tests").rglob("*.py")) if p.name[:5] != "test_"]
    texts = [file.encode(), *(path.read_bytes() for path in [*helpers, shop.root / file])]
    kept = cache / f"{LONGEST}-c-{hashlib.sha256(b''.join(texts)).hexdigest()[:32]}.json"
    if not kept.exists():
        cache.mkdir(parents=True, exist_ok=True)
        made = shop.work / "recording.json"
        made.unlink(missing_ok=True)
        shop.forked(lambda: _record(shop, file, made), 3600)
        kept.write_bytes(made.read_bytes() if made.exists() else b"{}")
    found = json.loads(kept.read_text())
    same = {f: h for f, h in found.get("hashes", {}).items() if h == _hash(shop.root / f)}
    return [
        Recording(
            r["test"], r["seconds"], {f: r["lines"][f] if f in same else [] for f in r["lines"]}
        )
        for r in found.get("tests", [])
    ]


def make_once(shop: Workshop) -> None:
    """Make what many tests share and none of them could make in time."""
    for module in MADE:
        if (shop.root / "tests" / f"{module}.py").exists():
            code = shop.forked(partial(_made, shop, module), 3600)
            if code != 0:
                raise RuntimeError(f"{module} cannot be made: {shop.log.read_text()[-2000:]}")


def _made(shop: Workshop, module: str) -> int:
    sys.path.insert(0, str(shop.root / "tests"))
    from made_once import made_once

    made_once(shop.made / module, getattr(importlib.import_module(module), MADE[module]))
    return 0


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else ""


def _record(shop: Workshop, file: str, made: Path) -> int:
    watch = _Watch(shop.root)
    watch.coverage.start()
    if (shop.root / NATIVE).exists():
        from cgtorch.native import library

        listen(library, watch.call)
    pytest.main(["-q", "-p", "no:cacheprovider", file], plugins=[watch])
    watch.coverage.stop()
    tests = watch.recordings(file)
    hashes = {name: _hash(shop.root / name) for test in tests for name in test.lines}
    made.write_text(json.dumps({"hashes": hashes, "tests": [asdict(test) for test in tests]}))
    return 0


class TooLong(BaseException):
    """A test takes too long; what tests call must not catch this."""


def used() -> float:
    """Seconds of CPU of this process and those that it waited for."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in both)


class _Watch:
    """A plugin of pytest that records."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.coverage = coverage.Coverage(
            data_file=None, config_file=False, source=[str(root / "cgtorch")]
        )
        self.seconds: dict[str, float] = {}
        self.passed: set[str] = set()
        self.functions, self.context = exported(root), ""
        self.lines: dict[str, dict[str, set[int]]] = {}

    def call(self, function: str) -> None:
        """A C function is called."""
        if function in self.functions:
            file, line = self.functions[function]
            self.lines.setdefault(self.context, {}).setdefault(file, set()).add(line)

    def _change(self, context: str) -> None:
        self.context = context
        self.coverage.switch_context(context)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        def end(number: int, frame: FrameType | None) -> None:
            raise TooLong

        for kind in (signal.SIGPROF, signal.SIGALRM):
            signal.signal(kind, end)
        before = used()
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        signal.setitimer(signal.ITIMER_REAL, LONGEST * WAITING)
        try:
            return (yield)
        except TooLong:
            return True
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
            self.seconds[item.nodeid] = used() - before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        self._change(item.nodeid.partition("::")[0])  # fixtures may be shared
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        self._change(item.nodeid)
        try:
            return (yield)
        finally:
            self._change("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self.passed.add(report.nodeid)
        elif report.failed:
            self.passed.discard(report.nodeid)

    def recordings(self, file: str) -> list[Recording]:
        lines, data = self.lines, self.coverage.get_data()
        for path in data.measured_files():
            name = os.path.relpath(path, self.root)
            for line, contexts in data.contexts_by_lineno(path).items():
                for context in contexts:
                    lines.setdefault(context, {}).setdefault(name, set()).add(line)
        shared = lines.get(file, {})
        found = []
        for test in sorted(self.passed):
            own = lines.get(test, {})
            both = {
                name: sorted(own.get(name, set()) | shared.get(name, set()))
                for name in own.keys() | shared.keys()
            }
            if self.seconds[test] <= LONGEST:
                found.append(Recording(test, self.seconds[test], both))
        return found
