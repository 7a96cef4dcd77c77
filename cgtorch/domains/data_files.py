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
dataset is read, too (`cgtorch.domains.minari`).
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch

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
from cgtorch.domains.minari import read_minari
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import Field
from cgtorch.ground.files import write_bytes

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
    every = [paths] if isinstance(paths, str | Path) else [*paths]
    d, u = len(percept), len(control)
    moved = torch.zeros(0, d), torch.zeros(0, u), torch.zeros(0, d)
    found = Dataset(*moved, torch.zeros(0, d), torch.zeros(0, dtype=torch.bool))
    for path in map(Path, every):
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
    units, form = units_of(percept, control), _form_of(Path(path))
    d, u = len(percept), len(control)
    if not dataset.whole(d) or dataset.control.shape[1] != u:
        raise DataError(f"the data to write have no {d} and {u} finite numbers a row; give such")
    moved = torch.cat([dataset.percept, dataset.control, dataset.next_percept], 1)
    values = torch.full((len(moved) + len(dataset.tested), len(units)), math.nan)
    values[: len(moved), :-1] = moved
    values[len(moved) :, :d] = dataset.tested
    values[len(moved) :, -1] = dataset.succeeded.float()
    titles = [title_of(name, unit) for name, unit in units.items()]
    table = as_csv(titles, values) if form == ".csv" else as_parquet(Path(path), titles, values)
    write_bytes(path, table, DataError)


def check_enough(data: Dataset) -> None:
    """DataError if the data (N, D), (L, D) are too few to learn Γ or C from them alone."""
    met = int(data.succeeded.sum())
    missed = len(data.succeeded) - met
    if len(data.percept) < LEAST or min(met, missed) < FEWEST:
        raise DataError(
            f"the data have {len(data.percept)} transitions, {met} tests that succeeded and "
            f"{missed} that failed, and at least {LEAST} transitions and {FEWEST} tests of either "
            "result are needed; give more data, or explore further with --transitions"
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
    """What is wrong with a row, and what to do."""
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
