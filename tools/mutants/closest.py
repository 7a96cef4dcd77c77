"""Which tests are closest to a changed line.

The tests of the folder that mirrors the file's come first, and then those elsewhere that name the
file's module. What runs is known from recordings. A C file is run by whoever calls a function that
is compiled with it, and its closest tests are those of the modules that call these functions.
"""

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from mutants.c_functions import callers, made_of
from mutants.recording import Recording

ELSEWHERE = 6
"""Test files of other folders that are tried."""
EMULATED = "emulated_gpu"
"""Tests that import it compile kernels anew, with the same change on both sides."""
Recorded = Callable[[str], list[Recording]]


def closest(root: Path, file: str, line: int, recorded: Recorded, budget: float) -> list[Recording]:
    """Tests that run a line, then those near that run its file, within a budget of seconds.

    Of each, the fastest come first.
    """
    places, modules = {(file, line)}, {file}
    if file.endswith(".py"):
        near, far = folders(root, modules), naming(root, modules)
    else:
        functions = made_of(root, file)
        modules = callers(root, functions)
        tests = [*of_modules(root, [file]), *(name for name in functions if name[:5] == "tests")]
        places = {*functions.values(), *((name, 1) for name in tests)}
        near, far = [*tests, *of_modules(root, modules)], naming(root, modules)
        near, far = ([p for p in ps if not emulates(root / p)] for ps in (near, far))
    far = [path for path in far if path not in near]
    run, read = _ordered([r for path in near for r in recorded(path)], places)
    elsewhere, _ = _ordered([r for path in far for r in recorded(path)], places)
    found, spent = list[Recording](), 0.0
    for recording in [*run, *elsewhere, *read]:
        if spent + recording.seconds <= budget or not found:
            found.append(recording)
            spent += recording.seconds
    return found


def emulates(path: Path) -> bool:
    """Whether a test file compiles the kernels of GPUs."""
    return EMULATED in path.read_text()


def _ordered(near: list[Recording], places: set[tuple[str, int]]) -> list[list[Recording]]:
    """Tests that run one of the places, and tests that run one of their files, by duration."""
    groups: list[list[Recording]] = [[], []]
    for recording in sorted({r.test: r for r in near}.values(), key=lambda r: r.seconds):
        touched = [(recording.lines[f], line) for f, line in places if f in recording.lines]
        itself = recording.test.partition("::")[0], 1
        # Of a file that has changed since the recording, no lines are known.
        if itself in places or any(line in lines or not lines for lines, line in touched):
            groups[0].append(recording)
        elif touched:
            groups[1].append(recording)
    return groups


def folders(root: Path, files: Iterable[str]) -> list[str]:
    """The test files of the folders that mirror those of some files."""
    mirrors = set()
    for file in files:
        mirror = root / "tests" / Path(file).relative_to("cgtorch").parent
        while not mirror.exists():
            mirror = mirror.parent
        mirrors.add(mirror)
    return [
        str(path.relative_to(root))
        for mirror in sorted(mirrors)
        for path in sorted(mirror.rglob("test_*.py"))
    ]


def of_modules(root: Path, files: Iterable[str]) -> list[str]:
    """The tests of some files' own names, or else those of their folders; of C files the former."""
    own, rest = set[str](), list[str]()
    for file in files:
        name = f"test_{Path(file).stem}.py"
        found = {p for p in folders(root, [file]) if p.endswith(f"/{name}")}
        own |= found
        rest += [file] if not found and file.endswith(".py") else []
    return sorted(own) + [path for path in folders(root, rest) if path not in own]


def naming(root: Path, files: set[str]) -> list[str]:
    """Test files anywhere that import one of the modules, the smallest first."""
    found = []
    for path in (root / "tests").rglob("test_*.py"):
        if not {"tools", "docs", "browser"} & set(path.parts):
            text = path.read_text()
            for file in files:
                package, name = str(Path(file).parent).replace("/", r"\."), Path(file).stem
                if re.search(rf"{package}\.{name}\b|from {package} import [^\n]*\b{name}\b", text):
                    found.append((len(text), str(path.relative_to(root))))
    return [name for _, name in sorted(set(found))[:ELSEWHERE]]
