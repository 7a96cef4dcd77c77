"""The functions of C that Python calls: who calls them, and of which files they are made."""

import re
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

_EXPORTED = re.compile(r"^int (\w+)\([^;{]*\{", re.MULTILINE)
_INCLUDED = re.compile(r'^\s*#\s*include "([^"]+)"', re.MULTILINE)
_CALLS = re.compile(r"\b(?:function\(|functions\[)")
NATIVE, TESTS = Path("cgtorch", "native"), Path("tests", "native")
POOL = str(NATIVE / "thread_pool.c")
"""It is run by whoever includes library.h."""

Place = tuple[str, int]
"""A file and a line."""


def exported(root: Path) -> dict[str, Place]:
    """Where each function begins that Python can call."""
    found = {}
    for path in sorted((root / NATIVE).rglob("*.[ch]")):
        text = path.read_text()
        for match in _EXPORTED.finditer(text):
            found[match[1]] = str(path.relative_to(root)), text.count("\n", 0, match.start()) + 1
    return found


def made_of(root: Path, file: str) -> dict[str, Place]:
    """Those functions that are compiled with a file, and test files that compile it themselves."""
    reached = _including(root, file if file != POOL else str(NATIVE / "library.h"))
    functions = {name: at for name, at in exported(root).items() if at[0] in reached}
    tests = {name: (name, 1) for name in reached if name.endswith(".py")}
    return functions | tests


def callers(root: Path, names: Iterable[str]) -> set[str]:
    """The modules that call one of some functions, perhaps with a prefix of its name made up."""
    ends = "|".join(rf"{name}|{name.partition('_')[2] or name}" for name in names)
    quoted = re.compile(rf'"(?:[^"\n]*_)?(?:{ends})"')
    return {
        str(path.relative_to(root))
        for path in (root / "cgtorch").rglob("*.py")
        if _CALLS.search(text := path.read_text()) and quoted.search(text)
    }


def listen(library: ModuleType, told: Callable[[str], None]) -> None:
    """Let `told` hear the name of each function that is called from now on."""
    plain = library.interface_of

    def heard(*given: Any) -> Any:
        interface = plain(*given)
        for name, function in interface.functions.items():
            function.errcheck = partial(_passed_on, told, name)
        return interface

    library.interface_of = heard  # type: ignore[attr-defined]


def _passed_on(told: Callable[[str], None], name: str, result: int, *_: Any) -> int:
    told(name)
    return result


def _including(root: Path, file: str) -> set[str]:
    """A file and those that include it, over any number of others."""
    paths = [*(root / NATIVE).rglob("*.[ch]"), *(root / TESTS).rglob("test_*.py")]
    included = {
        path: {folder / name for name in _INCLUDED.findall(path.read_text())
               for folder in (path.parent, root / NATIVE)}
        for path in paths
    }  # fmt: skip
    reached, more = set[Path](), {root / file}
    while more:
        reached |= more
        more = {p for p, names in included.items() if names & reached} - reached
    return {str(path.relative_to(root)) for path in reached}
