"""Python's own modules are found before files of the same names in the current folder."""

import os
import re
import sys
from collections.abc import Iterable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

TESTS = "test"
"""Python's tests, which no library imports, but many folders have a file of that name."""


class _StandardFirst:
    """A finder that passes over the current folder for Python's modules, but for those named."""

    def __init__(self) -> None:
        self.named = {TESTS}

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder.find_spec`."""
        if path is not None or name in self.named or name not in sys.stdlib_module_names:
            return None
        here = "", os.path.realpath(os.curdir)
        return PathFinder.find_spec(name, [each for each in sys.path if each not in here], target)


_finder = _StandardFirst()


def import_from_here(specs: Iterable[str]) -> None:
    """Let "module:Class" name a module in the current folder, as `python -m` does.

    A file logging.py there is not taken for Python's module, as it would be with `python -m`,
    unless a name begins with it.
    """
    if not (modules := [part for spec in specs for part in re.split("[:+=]", spec)[:-1]]):
        return
    _finder.named.update(module.partition(".")[0] for module in modules)
    if "" not in sys.path:
        sys.path.insert(0, "")
        sys.meta_path.insert(0, _finder)
