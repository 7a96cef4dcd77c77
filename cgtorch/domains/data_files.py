"""Logged transitions and tests in files, from which Γ and C are learned.

A file is one table: a header, and a row for each record. The columns are

    NAME         each number of the percept p, by the name of its field
    NAME         each number of the control u
    next NAME    each number of the next percept p′
    succeeded    0 or 1, false or true

in any order; others are ignored. A title may have the field's unit, such as "place [m]". A row is
either a transition (p, u and p′; `succeeded` is empty) or a test of success at p (`succeeded`; u
and p′ are empty):

    place [m],wind [m],push [m],next place [m],next wind [m],succeeded
    1.5,0.1,-1,0.6,0.1,
    0.6,0.1,,,,0

A file is CSV (.csv) or Parquet (.parquet, where an empty cell is null). The folder of a Minari
dataset is read, too.
"""

import math
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.data_tables import (
    GIVE,
    GIVE_RESULT,
    SUCCEEDED,
    Table,
    as_csv,
    as_parquet,
    read_csv,
    read_parquet,
    title_of,
)
from cgtorch.domains.exploration import FEWEST, LEAST
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import write_bytes
from cgtorch.ground.given import given_path, shown

NEXT = "next "
FORMATS = (".csv", ".parquet")


def read_data(
    paths: str | Path | Iterable[str | Path], percept: Sequence[Field], control: Sequence[Field]
) -> Dataset:
    """The transitions (N, D), (N, U), (N, D) and tests (L, D) of files, one file after the other.

    Args:
        paths: CSV or Parquet files, or folders of Minari datasets.
        percept: The D fields of a percept.
        control: The U fields of a control.

    Raises:
        DataError: A file cannot be read, or holds something else than the fields' finite numbers.
    """
    several = isinstance(paths, Iterable) and not isinstance(paths, str | bytes | os.PathLike)
    given: Any = paths if several else [paths]
    every = [given_path(path, error=DataError) for path in given]
    d, u = len(_fields(percept, "percept")), len(_fields(control, "control"))
    moved = torch.empty(0, d), torch.empty(0, u), torch.empty(0, d)
    found = Dataset(*moved, torch.empty(0, d), torch.empty(0, dtype=torch.bool))
    for path in every:
        if path.is_dir():
            found = found.extended(read_minari(path, percept, control))
        else:
            read = read_csv if _form_of(path) == ".csv" else read_parquet
            found = found.extended(_records(read(path, units_of(percept, control)), d))
    return found


def write_data(
    path: str | Path, dataset: Dataset, percept: Sequence[Field], control: Sequence[Field]
) -> None:
    """Write N transitions (N, D), (N, U), (N, D), then L tests (L, D), into a CSV or Parquet file.

    When they are read again, every number is the same in every bit. DataError if the file cannot
    be written, or if the data do not fit the D fields of a percept and the U fields of a control.
    """
    path = given_path(path, error=DataError)
    d, u = len(_fields(percept, "percept")), len(_fields(control, "control"))
    units, form = units_of(percept, control), _form_of(path)
    if not isinstance(dataset, Dataset):
        raise DataError(f"dataset is {shown(dataset)}; give a Dataset, as read_data returns")
    if not dataset.whole(d) or dataset.control.shape[1] != u:
        raise DataError(f"the data to write have no {d} and {u} finite numbers a row; give such")
    moved = torch.cat([dataset.percept, dataset.control, dataset.next_percept], 1)
    values = torch.full((len(moved) + len(dataset.tested), len(units)), math.nan)
    values[: len(moved), :-1] = moved
    values[len(moved) :, :d] = dataset.tested
    values[len(moved) :, -1] = dataset.succeeded.float()
    titles = [title_of(name, unit) for name, unit in units.items()]
    table = as_csv(titles, values) if form == ".csv" else as_parquet(path, titles, values)
    write_bytes(path, table, DataError)


def check_enough(data: Dataset) -> None:
    """DataError if the data (N, D), (L, D) are too few to learn Γ or C from them alone."""
    met = int(data.succeeded.sum())
    missed = len(data.succeeded) - met
    if len(data.percept) < LEAST or min(met, missed) < FEWEST:
        raise DataError(
            f"the data have {len(data.percept)} transitions, {met} tests that succeeded and "
            f"{missed} that failed, and at least {LEAST} transitions and {FEWEST} tests of either "
            "result are needed; give more data, or explore further (transitions)"
        )


def units_of(percept: Sequence[Field], control: Sequence[Field]) -> dict[str, str]:
    """The names of all columns in their usual order, with units; DataError if two are the same."""
    pairs = [(f.name, f.unit) for f in (*percept, *control)]
    pairs += [*((NEXT + f.name, f.unit) for f in percept), (SUCCEEDED, "")]
    known = set[str]()
    for name, unit in pairs:
        if not known.isdisjoint(titles := {name, title_of(name, unit)}):
            raise DataError(
                f"data of this domain would have two columns {name!r}; give its percepts and "
                "controls different names"
            )
        known |= titles
    return dict(pairs)


def _fields(fields: Sequence[Field], what: str) -> Sequence[Field]:
    """The fields of a percept or control; DataError for what are none."""
    if isinstance(fields, Sequence) and all(isinstance(each, Field) for each in fields):
        return fields
    raise DataError(f"{what} is {shown(fields)}; give a list of Field, as domain.{what} is")


def _form_of(path: Path) -> str:
    form = path.suffix.lower()
    if form not in FORMATS:
        raise DataError(
            f"{str(path)!r} is of no known format; give a file that ends in .csv or .parquet, or "
            "the folder of a Minari dataset"
        )
    return form


def _records(table: Table, d: int) -> Dataset:
    """The transitions and tests in a table; DataError for a row that is neither, or not whole."""
    values, filled = table.values.float(), ~table.values.isnan()
    table.refuse(values.isinf(), GIVE)
    results = torch.zeros_like(filled)
    results[:, -1] = filled[:, -1] & (table.values[:, -1] != 0) & (table.values[:, -1] != 1)
    table.refuse(results, GIVE_RESULT)
    tests, moves = filled[:, -1], filled[:, d:-1].any(1)
    needed = moves[:, None].repeat(1, filled.shape[1])
    needed[:, :d], needed[:, -1] = True, False
    lacks = needed & ~filled
    wrong = ((tests == moves) | lacks.any(1)).nonzero()[:, 0]
    if len(wrong):
        row = int(wrong[0])
        fault = _fault(table.names, filled[row].tolist(), lacks[row].tolist(), d)
        raise DataError(f"{table.place(row)} {fault}")
    p, u, q = values[moves, :-1].split([d, values.shape[1] - 2 * d - 1, d], 1)
    rows = p.contiguous(), u.contiguous(), q.contiguous(), values[tests, :d].contiguous()
    return Dataset(*rows, values[tests, -1] == 1)


def _fault(names: Sequence[str], filled: Sequence[bool], lacks: Sequence[bool], d: int) -> str:
    """The fault of a row, and how to repair it."""
    tests, moves = filled[-1], any(filled[d:-1])
    if tests and moves:
        return "is a transition and a test; give the test a row of its own, with its percept"
    if not tests and not moves:
        return "is no transition and no test; give a control and a next percept, or 'succeeded'"
    first = names[lacks.index(True)]
    if moves and not any(filled[-1 - d : -1]) and all(filled[: -1 - d]):
        return (
            f"has a control but no next percept ({first!r} is empty), as where an episode was cut "
            "short; leave the row out"
        )
    if moves and not any(filled[d : -1 - d]):
        return f"has a next percept but no control ({first!r} is empty); leave the row out"
    return f"has an empty {first!r}; fill it in, or leave the row out"


FILE = "main_data.hdf5"
SUCCESS = ("success", "is_success")
MOST_NUMBERS = 2**27  # of one part of an episode
DEEPEST = 8  # groups within one another
BROKEN = (OSError, LookupError, TypeError, ValueError, RuntimeError, MemoryError, AttributeError)
"""Errors of h5py for damaged files and for parts of a wrong kind."""


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
