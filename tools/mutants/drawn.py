"""Which lines of a folder of the package change, and how."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mutants.c_edits import c_edits
from mutants.edits import Edit
from mutants.python_edits import python_edits

EDITS = {".py": python_edits, ".c": c_edits, ".h": c_edits}
"""By the end of a file's name. What is compiled for GPUs alone needs one, and is left out."""


@dataclass(frozen=True)
class Mutant:
    """A change of one file.

    Attributes:
        file: Path below the repository.
        line: Number of the first line that changes, from 1.
        old: The lines that change, without line breaks.
        new: What they become.
        edit: The change itself.
    """

    file: str
    line: int
    old: str
    new: str
    edit: Edit


def rooms(package: Path) -> list[str]:
    """The folders of the package, the largest parts of which it consists."""
    return sorted(path.name for path in package.iterdir() if (path / "__init__.py").exists())


def drawn(root: Path, room: str, seed: int) -> Iterator[Mutant]:
    """Changes of different lines of a folder of `cgtorch`, in an order that depends on the seed."""
    lines: dict[tuple[str, int], list[Mutant]] = {}
    for path in sorted((root / "cgtorch" / room).rglob("*")):
        if path.suffix in EDITS and "cuda" not in path.parts:
            source, file = path.read_bytes(), str(path.relative_to(root))
            for edit in EDITS[path.suffix](source):
                found = Mutant(file, edit.line(source), *edit.shown(source), edit)
                lines.setdefault((file, found.line), []).append(found)
    draw = random.Random(f"{room} {seed}")  # noqa: S311  nothing secret
    places = sorted(lines)
    draw.shuffle(places)
    for place in places:
        yield draw.choice(lines[place])
