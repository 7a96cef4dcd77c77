"""Trials of mutants: does one of the closest tests notice the change?"""

import hashlib
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from mutants.drawn import Mutant
from mutants.recording import WAITING, Recording
from mutants.workshop import Workshop

FACTOR, START = 4, 5.0
"""A test takes too long if it takes this many times its usual time, and seconds more."""
SLOWER = 3
"""By how much C is slower that is hardly optimised."""
NOT_COMPILED, SAME_CODE = 77, 78
"""Exit codes, instead of those of tests."""
SAME = "the same code"
"""What becomes of a change that the compiler does not notice, or does not see on this CPU."""


@dataclass(frozen=True)
class Trial:
    """What became of a mutant.

    Attributes:
        mutant: The change.
        killed: Whether a test noticed it; None if it does not compile, or to the same machine code.
        by: The test, or what else happened.
        tests: Number of tests that were chosen.
    """

    mutant: Mutant
    killed: bool | None
    by: str
    tests: int


def tried(shop: Workshop, mutant: Mutant, tests: list[Recording]) -> Trial:
    """Run tests on a mutant until one fails."""
    source = (shop.root / mutant.file).read_bytes()
    verdict = shop.work / "verdict"
    verdict.write_text("")
    compiled, before = not mutant.file.endswith(".py"), b""
    if compiled:
        tests = [replace(test, seconds=SLOWER * test.seconds) for test in tests]
        before = _unchanged(shop)
    wall = 60 + WAITING * FACTOR * sum(test.seconds for test in tests) + 300 * compiled
    with shop.changed(mutant.file, mutant.edit.applied(source)):
        code = shop.forked(lambda: _run(shop, tests, before, verdict), wall)
    by = verdict.read_text()
    if code in (-signal.SIGPROF, -signal.SIGALRM):
        by = f"time, in {by}"
    elif code not in (0, 1):
        by = f"exit code {code}, in {by or 'imports'}"
    if code in (NOT_COMPILED, SAME_CODE):
        return Trial(mutant, None, SAME if code == SAME_CODE else "no code", len(tests))
    return Trial(mutant, code != 0, by, len(tests))


def _unchanged(shop: Workshop) -> bytes:
    """The digest of the libraries of the sources as they are, which are compiled once."""
    kept = shop.work / "unchanged"
    if not kept.exists() and shop.forked(lambda: kept.write_bytes(_compiled(shop)) and 0, 3600):
        raise RuntimeError(f"the C sources cannot be compiled: {shop.log.read_text()[-2000:]}")
    return kept.read_bytes()


def _compiled(shop: Workshop) -> bytes:
    """The digest of the libraries of the present sources; empty if they cannot be compiled."""
    cache = shop.work / "cache"
    cache.mkdir(exist_ok=True)
    os.environ.update(
        CC=str(Path(__file__).with_name("cc.sh")), MUTANTS_OBJECTS=str(shop.work / "objects"),
        XDG_CACHE_HOME=str(cache),
    )  # fmt: skip
    import torch

    from cgtorch.native import compiler, library
    from cgtorch.native.cache import cache_folder

    if not all(library.built(dtype) for dtype in (torch.float32, torch.float64)):
        return b""
    name = compiler.found_compiler() or ""
    target = compiler.own_target(name)
    files = [cache_folder() / compiler.file_name(real, name, target) for real in compiler.REALS]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()


def _run(shop: Workshop, tests: list[Recording], before: bytes, verdict: Path) -> int:
    """The tests' exit code, given the digest of the unchanged libraries where C has changed."""
    if before:
        found = _compiled(shop)
        if found in (b"", before):
            return SAME_CODE if found else NOT_COMPILED
    files = sorted({test.test.partition("::")[0] for test in tests})
    chosen = _Chosen(tests, verdict)
    return int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *files], plugins=[chosen]))


class _Chosen:
    """A plugin of pytest that runs the chosen tests in their order, and says which one failed."""

    def __init__(self, tests: list[Recording], verdict: Path) -> None:
        self.place = {test.test: number for number, test in enumerate(tests)}
        self.seconds = {test.test: test.seconds for test in tests}
        self.verdict = verdict

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid in self.place]
        items.sort(key=lambda item: self.place[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.verdict.write_text(item.nodeid)
        most = START + FACTOR * self.seconds[item.nodeid]
        for kind, timer, seconds in (
            (signal.SIGPROF, signal.ITIMER_PROF, most),
            (signal.SIGALRM, signal.ITIMER_REAL, WAITING * most),
        ):
            signal.signal(kind, signal.SIG_DFL)  # which ends the process
            signal.setitimer(timer, seconds)
        return (yield)
