"""Minari datasets on disk, as data from which Γ and C are learned.

A dataset is the folder of a main_data.hdf5, or has that file in data/. Each of its groups episode_N
has `observations` (T + 1, …), `actions` (T, …), and in `infos` the `success` or `is_success` of
each step, (T,) or (T + 1,) with the beginning. Observations are percepts and actions are controls,
number by number. Dictionaries of observations are flattened in the alphabetical order of their
keys, as Gymnasium does it. Each step is a transition, and a test of success where it ends.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import Field

FILE = "main_data.hdf5"
SUCCESS = ("success", "is_success")
MOST_NUMBERS = 2**27  # of one part of an episode
DEEPEST = 8  # groups within one another
BROKEN = (OSError, LookupError, TypeError, ValueError, RuntimeError, MemoryError, AttributeError)
"""What h5py raises for damaged files, and for parts that are of another kind than they should."""


def read_minari(folder: Path, percept: Sequence[Field], control: Sequence[Field]) -> Dataset:
    """The steps of all episodes as transitions (N, D), (N, U), (N, D) and tests (N, D).

    Args:
        folder: The folder of the dataset.
        percept: The D fields of a percept.
        control: The U fields of a control.

    Raises:
        DataError: It cannot be read, has no success, or other numbers than the fields.
    """
    path = next((p for p in (folder / "data" / FILE, folder / FILE) if p.is_file()), None)
    if path is None:
        raise DataError(f"{str(folder)!r} has no {FILE}; give the folder of a Minari dataset")
    try:
        import h5py
    except ImportError as e:
        raise DataError(
            f"the Minari dataset {str(folder)!r} needs package 'h5py'; pip install 'cgtorch[data]'"
        ) from e
    parts = list[Dataset]()
    try:
        with h5py.File(path, "r") as file:
            numbers = (re.fullmatch(r"episode_(\d{1,15})", name) for name in file)
            for match in sorted(filter(None, numbers), key=lambda m: int(m[1])):
                where = f"{match[0]} of {str(folder)!r}"
                parts.append(_episode(file[match[0]], percept, control, where))
    except DataError:
        raise
    except BROKEN as e:
        raise DataError(f"cannot read {str(path)!r} ({e}); is it a whole Minari dataset?") from e
    if not parts:
        raise DataError(f"{str(path)!r} has no episode; give a Minari dataset with some")
    every = ([getattr(part, name) for part in parts] for name in vars(parts[0]))
    return Dataset(*map(torch.cat, every))


def _episode(group: Any, percept: Sequence[Field], control: Sequence[Field], where: str) -> Dataset:
    """The steps of an episode; DataError if its parts do not fit one another or the fields."""
    seen = _rows(group, "observations", percept, "percept", where)
    sent = _rows(group, "actions", control, "control", where)
    if len(seen) != len(sent) + 1:
        raise DataError(
            f"{where} has {len(seen)} observations and {len(sent)} actions; one observation more "
            "than actions is needed"
        )
    succeeded = _success(group, len(sent), where)
    return Dataset(seen[:-1], sent, seen[1:], seen[1:], succeeded)


def _rows(group: Any, name: str, fields: Sequence[Field], what: str, where: str) -> Tensor:
    """(n, F) float32 a part of an episode; DataError if its rows are not F finite numbers."""
    if name not in group:
        raise DataError(f"{where} has no {name!r}; give a whole Minari dataset")
    found = _flat(group[name], f"{name} of {where}")
    if found.shape[1] != len(fields):
        raise DataError(
            f"the {name} of {where} have {found.shape[1]} numbers each, and a {what} of the domain "
            f"has {len(fields)}; give the domain the same"
        )
    made = found.float()
    for row, column in (~made.isfinite()).nonzero()[:1].tolist():
        raise DataError(
            f"{fields[column].name!r} in {name} {row} of {where} is {found[row, column]:g}; leave "
            "the episode out"
        )
    return made


def _flat(node: Any, where: str, depth: int = 0) -> Tensor:
    """(n, F) float64 all numbers of an array or of a dictionary of arrays, by keys."""
    if hasattr(node, "keys"):
        if depth == DEEPEST or not len(node):
            raise DataError(f"the {where} are empty or too deep; give a whole Minari dataset")
        parts = [_flat(node[key], where, depth + 1) for key in sorted(node)]
        return torch.cat(parts, 1)
    if not node.shape or node.size > MOST_NUMBERS or node.dtype.kind not in "biuf":
        raise DataError(f"the {where} are {node.shape} of {node.dtype}; give rows of numbers")
    rows = torch.from_numpy(node[()].astype("float64"))
    return rows.view(node.shape[0], math.prod(node.shape[1:]))


def _success(group: Any, steps: int, where: str) -> Tensor:
    """(T,) bool, whether each step ended in success; DataError if that is not known."""
    infos = group.get("infos", ())
    name = next((name for name in SUCCESS if name in infos), None)
    if name is None:
        raise DataError(
            f"{where} has no success of each step (infos/{' or infos/'.join(SUCCESS)}), and a "
            "Minari dataset without success cannot teach C; add it"
        )
    found = _flat(infos[name], f"{name} of {where}")
    wrong = found[(found != 0) & (found != 1)].tolist()
    if found.shape not in ((steps, 1), (steps + 1, 1)) or wrong:
        said = f"has {wrong[0]:g}" if wrong else f"is of shape {tuple(found.shape)}"
        raise DataError(f"{name} of {where} {said}; give 0 or 1 for each of {steps} steps")
    return found[len(found) - steps :, 0] == 1
