"""What callers of the Python interface give, checked where it comes in.

Each function returns the value as what it should be, or raises a SettingsError that names it.
"""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from cgtorch.ground.errors import CgtorchError, SettingsError

T = TypeVar("T")
SEEDS = -(2**63), 2**64 - 1
"""The least and the largest seed that torch takes."""
LONGEST_NAME, LONGEST_PATH = 255, 4096  # bytes, as Linux takes them


def shown(value: object, most: int = 60) -> str:
    """A value in a message, of so many characters at most, even if it cannot be written."""
    try:
        return f"{value!r:.{most}}"
    except Exception:  # of an object of the user's, or a whole number of thousands of digits
        return f"a value of type {type(value).__name__}"


def given_path(
    value: object, what: str = "path", error: type[CgtorchError] = SettingsError
) -> Path:
    """A path that a file can have, as text or as an object such as a pathlib.Path, or `error`."""
    path = any_path(value, what, error)
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        encoded = b"\0"
    if b"\0" in encoded:
        raise error(f"{what} is {str(path)!r:.60}, which no file can be called; give another")
    longest = max(map(len, encoded.split(os.fsencode(os.sep))))
    if longest > LONGEST_NAME or len(encoded) >= LONGEST_PATH:
        raise error(
            f"{what} is {str(path)!r:.60} …, which is too long; give names of at most "
            f"{LONGEST_NAME} bytes and a path of fewer than {LONGEST_PATH}"
        )
    return path


def any_path(value: object, what: str = "path", error: type[CgtorchError] = SettingsError) -> Path:
    """A path that is given, of which the system will say whether a file can have it."""
    place = os.fspath(value) if isinstance(value, str | os.PathLike) else value
    if not isinstance(place, str):
        raise error(f"{what} is {shown(value)}; give a path as a text or a pathlib.Path")
    return Path(place)


def given_folder(value: object, what: str = "folder") -> Path:
    """The path of a folder, which stays the same if the program goes to another one."""
    path = given_path(value, what)
    try:
        return path.absolute()
    except FileNotFoundError as e:
        raise SettingsError(
            f"{what} is {str(path)!r:.60}, and the current folder is gone; give a path from /"
        ) from e


def whole_number(value: object, what: str, least: int, most: int, bounds: str = "") -> int:
    """A whole number of any type, such as one of numpy, within bounds.

    `bounds` says them in other words, such as "of at most 64 bits".
    """
    if isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) <= most:
        return int(value)
    bounds = bounds or f"from {least} to {most}"
    raise SettingsError(f"{what} is {shown(value, 40)}; give a whole number {bounds}")


def real_number(value: object, what: str, least: float = 0) -> float:
    """A number that is not below a bound; infinity is one, NaN is none."""
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):  # of whole numbers of hundreds of digits
            if (number := float(value)) >= least:
                return number
    raise SettingsError(f"{what} is {shown(value, 40)}; give a number of at least {least:g}")


def given_seed(value: object, what: str = "seed") -> int:
    """A seed of random numbers."""
    return whole_number(value, what, *SEEDS, bounds="of at most 64 bits")


def truth(value: object, what: str) -> bool:
    """True or False, also as a number or as an array or tensor of one."""
    try:
        found = value.item() if hasattr(value, "item") else value
    except (ValueError, RuntimeError):  # it holds several
        found = None
    if not isinstance(found, int) or found not in (0, 1):
        raise SettingsError(f"{what} is {shown(value, 40)}; give True or False")
    return bool(found)


def says_true(answer: object) -> bool:
    """Whether an answer is true, as `truth` takes it; anything else is not, and most are None."""
    with suppress(SettingsError):
        return answer is not None and truth(answer, "answer")
    return False


def of_kind(value: object, kind: type[T], what: str, advice: str) -> T:
    """An object of a class; `advice` says where one comes from."""
    if not isinstance(value, kind):
        raise SettingsError(f"{what} is {shown(value)}; give {advice}")
    return value


def a_function(value: T, what: str) -> T:
    """Something that can be called."""
    if not callable(value):
        raise SettingsError(f"{what} is {shown(value)}; give a function")
    return value


def known_options(kind: type, given: Mapping[str, Any], *others: type) -> dict[str, Any]:
    """The settings given by name, in plain types; SettingsError for a name that `kind` lacks.

    `others` are further kinds of settings that the name may have been meant for.
    """
    names = [f.name for each in (kind, *others) for f in fields(each)]
    for name in given:
        if name not in {f.name for f in fields(kind)}:
            close = get_close_matches(name, names, 1)
            meant = f"did you mean {close[0]!r}?" if close else f"use one of {', '.join(names)}"
            raise SettingsError(f"unknown setting {name!r}; {meant}")
    return {name: _plain(value) for name, value in given.items()}


def _plain(value: Any) -> Any:
    """Lists as tuples, and numbers of other types, such as those of numpy, as those of Python."""
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if getattr(value, "shape", None) == () and hasattr(value, "item"):
        with suppress(RuntimeError, ValueError):  # of a tensor without data
            return value.item()
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)
