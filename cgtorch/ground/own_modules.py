"""Modules of the user's own, which may be programs or parts of packages."""

import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn, TypeVar

from cgtorch.ground.errors import DomainError

T = TypeVar("T")
ONLY = "let it do so only where it is the program (if __name__ == '__main__')"
INSIDE = (
    "it is a module of a package, so call the command in the folder above, with the package in its "
    "name (package.module)"
)
"""Advice on a relative import."""


def as_module(call: Callable[[], T]) -> T:
    """What user code returns that is imported or made; DomainError if it acts as a program.

    The words of the command line are those of cgtorch, which its own parser would refuse.
    """
    from cgtorch.ground.dry_run import failed_at, reason

    try:
        with _refusing_to_parse():
            return call()
    except SystemExit as e:
        raise DomainError(f"code of yours raised {reason(e)}{failed_at(e)}; {ONLY}") from e
    except _ParsedError as e:
        where = failed_at(e).removeprefix(" in ") or "code of yours"
        raise DomainError(
            f"{where} reads the command line, which is that of cgtorch; {ONLY}"
        ) from e


def is_relative(error: BaseException) -> bool:
    """Whether a module was imported without the package that its relative imports need."""
    return isinstance(error, ImportError) and "relative import with no known parent" in str(error)


class _ParsedError(Exception):
    """A parser of the user's does not know the words of the command line."""


@contextmanager
def _refusing_to_parse() -> Iterator[None]:
    """A context in which a parser raises what it would print under the name of this program."""
    before, own = ArgumentParser.error, sys.argv

    def error(self: ArgumentParser, message: str) -> NoReturn:
        if sys.argv is own:
            raise _ParsedError(message)
        before(self, message)

    ArgumentParser.error = error  # type: ignore[method-assign]
    try:
        yield
    finally:
        ArgumentParser.error = before  # type: ignore[method-assign]
