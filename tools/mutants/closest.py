"""Which tests are closest to a changed line.

The tests of the folder that mirrors the file's come first, and then those elsewhere that name the
file's module. What runs is known from recordings. A C file is run by whoever runs a line of Python
that names one of its functions.
"""

import re
from collections.abc import Callable
from pathlib import Path

from mutants.recording import Recording

ELSEWHERE = 6
"""Test files of other folders that are tried."""
_EXPORTED = re.compile(r"^int (\w+)\(", re.MULTILINE)
_INCLUDED = re.compile(r'^\s*#\s*include "([^"]+)"', re.MULTILINE)
Recorded = Callable[[str], list[Recording]]


def closest(root: Path, file: str, line: int, recorded: Recorded, budget: float) -> list[Recording]:
    """Tests that run a line, then those near that run its file, within a budget of seconds.

    Of each, the fastest come first.
    """
    places = {(file, line)} if file.endswith(".py") else set(callers(root, file))
    near = [path for folder in folders(root, places) for path in folder]
    far = [path for path in naming(root, {f for f, _ in places}) if path not in near]
    run, read = _ordered([r for path in near for r in recorded(path)], places)
    elsewhere, _ = _ordered([r for path in far for r in recorded(path)], places)
    found, spent = list[Recording](), 0.0
    for recording in [*run, *elsewhere, *read]:
        if spent + recording.seconds <= budget or not found:
            found.append(recording)
            spent += recording.seconds
    return found


def _ordered(near: list[Recording], places: set[tuple[str, int]]) -> list[list[Recording]]:
    """Tests that run one of the places, and tests that run one of their files, by duration."""
    groups: list[list[Recording]] = [[], []]
    for recording in sorted({r.test: r for r in near}.values(), key=lambda r: r.seconds):
        touched = [(recording.lines[f], line) for f, line in places if f in recording.lines]
        # Of a file that has changed since the recording, no lines are known.
        if any(line in lines or not lines for lines, line in touched):
            groups[0].append(recording)
        elif touched:
            groups[1].append(recording)
    return groups


def folders(root: Path, places: set[tuple[str, int]]) -> list[list[str]]:
    """The test files of the folders that mirror those of the places."""
    mirrors = set()
    for file, _ in places:
        mirror = root / "tests" / Path(file).relative_to("cgtorch").parent
        while not mirror.exists():
            mirror = mirror.parent
        mirrors.add(mirror)
    return [
        [str(path.relative_to(root)) for path in sorted(mirror.rglob("test_*.py"))]
        for mirror in sorted(mirrors)
    ]


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


def callers(root: Path, file: str) -> list[tuple[str, int]]:
    """The lines of Python that name a function that a C file, or one that includes it, exports."""
    sources = {p: p.read_text() for p in (root / "cgtorch" / "native").rglob("*.[ch]")}
    reached, more = set[Path](), {root / file}
    while more:
        reached |= more
        more = {
            path
            for path, text in sources.items()
            for name in _INCLUDED.findall(text)
            if {(path.parent / name).resolve(), (root / "cgtorch/native" / name).resolve()}
            & {each.resolve() for each in reached}
        } - reached
    names = {name for path in reached for name in _EXPORTED.findall(sources[path])}
    return [
        (str(path.relative_to(root)), number)
        for path in sorted((root / "cgtorch").rglob("*.py"))
        for number, text in enumerate(path.read_text().splitlines(), 1)
        if any(f'"{name}"' in text for name in names)
    ]
