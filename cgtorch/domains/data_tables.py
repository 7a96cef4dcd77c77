"""Tables in CSV and Parquet files: the columns that are needed, with the place of each number."""

import csv
import io
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.ground.files import read_bytes

SUCCEEDED = "succeeded"
MOST_BYTES = 2**30
RESULTS = {"0": 0.0, "1": 1.0, "false": 0.0, "true": 1.0}
"""Words for a cell of `succeeded`, in any case, besides numbers of these values."""
GIVE, GIVE_RESULT = "give a finite number, or leave the row out", "give 0 or 1"


@dataclass(frozen=True)
class Table:
    """The columns of a file that are needed.

    Attributes:
        where: The file, for messages.
        word: The name of its rows in messages.
        rows: The number of each row.
        names: The names of the K columns.
        values: (R, K) float64, NaN where a cell is empty.
    """

    where: str
    word: str
    rows: Sequence[int]
    names: Sequence[str]
    values: Tensor

    def place(self, row: int) -> str:
        """A row, for messages."""
        return f"{self.word} {self.rows[row]} of {self.where}"

    def refuse(self, wrong: Tensor, advice: str) -> None:
        """DataError for the first cell that is `wrong` (R, K) bool, if any is."""
        for row, column in wrong.nonzero()[:1].tolist():
            value = float(self.values[row, column])
            raise DataError(f"{self.names[column]!r} in {self.place(row)} is {value:g}; {advice}")


def title_of(name: str, unit: str) -> str:
    """The title of a column."""
    return f"{name} [{unit}]" if unit else name


def read_csv(path: Path, units: Mapping[str, str]) -> Table:
    """The columns with the names in `units`, in this order; DataError for anything else."""
    where, names = repr(str(path)), [*units]
    raw = read_bytes(path, MOST_BYTES, DataError)
    lines, values = list[int](), list[list[float]]()
    try:
        rows = csv.reader(io.StringIO(raw.decode("utf-8-sig"), newline=""), strict=True)
        header = next(rows, [])
        if not header:
            raise DataError(f"{where} is empty; give a header, and a row for each record")
        if len(header) == 1 and (other := next((c for c in ";\t" if c in header[0]), "")):
            raise DataError(f"the columns of {where} are separated by {other!r}; use commas")
        columns = _positions(header, units, where)
        for row in filter(None, rows):
            place = f"line {rows.line_num} of {where}"
            if len(row) != len(header):
                raise DataError(
                    f"{place} has {len(row)} cells, and the header has {len(header)}; is it whole?"
                )
            cells = zip(names, (row[i].strip() for i in columns), strict=True)
            values.append([_number(cell, name, place) for name, cell in cells])
            lines.append(rows.line_num)
    except (csv.Error, UnicodeDecodeError) as e:
        if str(e).startswith("field larger than"):
            raise DataError(
                f"{where} has a cell of more than {csv.field_size_limit()} characters; shorten it, "
                "or leave its column out"
            ) from e
        raise DataError(f"{where} is no CSV in UTF-8 ({e}); give another file") from e
    table = torch.tensor(values, dtype=torch.float64).view(-1, len(names))
    return Table(where, "line", lines, names, table)


def read_parquet(path: Path, units: Mapping[str, str]) -> Table:
    """The same of a Parquet file."""
    pyarrow, parquet = _pyarrow(path)
    where, names = repr(str(path)), [*units]
    raw = read_bytes(path, MOST_BYTES, DataError)
    try:
        file = parquet.ParquetFile(pyarrow.BufferReader(raw))
        titles, count = file.schema_arrow.names, file.metadata.num_rows
        chosen = [titles[i] for i in _positions(titles, units, where)]
        if count * len(names) * 8 > MOST_BYTES:
            raise DataError(f"{where} has {count} rows, which are too many; give fewer")
        table = file.read(columns=chosen)
        pairs = zip(chosen, names, strict=True)
        columns = [_column(table.column(title), name, where) for title, name in pairs]
    except DataError:
        raise
    except (pyarrow.ArrowException, OSError, ValueError, LookupError, MemoryError) as e:
        raise DataError(f"{where} is no Parquet file ({e}); give another file") from e
    return Table(where, "row", range(1, table.num_rows + 1), names, torch.stack(columns, 1))


def as_csv(titles: Sequence[str], values: Tensor) -> bytes:
    """The content of a CSV file with float32 values (R, K), empty where they are NaN.

    Each number has as few digits as make the same number again.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(titles)
    for row, exact in zip(values.numpy(), values.tolist(), strict=True):
        writer.writerow(map(_shortest, row, exact))
    return text.getvalue().encode()


def as_parquet(path: Path, titles: Sequence[str], values: Tensor) -> bytes:
    """The content of a Parquet file with float32 values (R, K), null where they are NaN."""
    pyarrow, parquet = _pyarrow(path)
    columns = [pyarrow.array(column, mask=column != column) for column in values.T.numpy()]
    output = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns, names=[*titles]), output)
    return bytes(output.getvalue())


def _shortest(value: Any, exact: float) -> str:
    """A float32 number as text."""
    if math.isnan(exact):
        return ""
    short = str(value).removesuffix(".0")
    # A number between two of float32 may be rounded twice.
    return short if type(value)(float(short)) == value else repr(exact)


def _positions(header: Sequence[str], units: Mapping[str, str], where: str) -> list[int]:
    """Where the columns are; DataError if one lacks, comes twice or has another unit."""
    known = {**{title_of(*pair): pair[0] for pair in units.items()}, **{n: n for n in units}}
    found = dict[str, int]()
    for i, title in enumerate(header):
        words = title.strip()
        name = known.get(title) or known.get(words)
        if name is None and words.endswith("]"):
            name, unit = (part.strip() for part in words[:-1].rpartition("[")[::2])
            if name in units and unit != units[name]:
                right = f"in {units[name]!r}" if units[name] else "without a unit"
                raise DataError(
                    f"column {title!r} of {where} is in {unit!r}, and {name!r} of the domain is "
                    f"{right}; convert its numbers and its title"
                )
        if name in found:
            raise DataError(f"{where} has two columns {name!r}; keep one of them")
        if name in units:
            found[str(name)] = i
    if missing := [name for name in units if name not in found]:
        several = "columns" if len(missing) > 1 else "column"
        raise DataError(
            f"{where} lacks {several} {', '.join(map(repr, missing))}; give a column for each "
            f"percept, control and next percept, and {SUCCEEDED!r}"
        )
    return [found[name] for name in units]


def _number(text: str, name: str, place: str) -> float:
    """The number in a cell, NaN if it is empty; DataError for anything else."""
    if not text:
        return math.nan
    if name == SUCCEEDED and text.lower() in RESULTS:
        return RESULTS[text.lower()]
    try:
        value = math.nan if "_" in text else float(text)  # Python allows 1_000
    except ValueError:
        value = math.nan
    if math.isnan(value):
        advice = GIVE_RESULT if name == SUCCEEDED else GIVE
        raise DataError(f"{name!r} in {place} is {text!r:.40}; {advice}")
    return value


def _column(column: Any, name: str, where: str) -> Tensor:
    """(R,) float64 a column of a Parquet file, NaN where it is null; DataError for other types."""
    import pyarrow

    types, kind = pyarrow.types, column.type
    if types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    places = (f"row {i} of {where}" for i in itertools.count(1))
    if name == SUCCEEDED and (types.is_string(kind) or types.is_large_string(kind)):
        pairs = zip(column.to_pylist(), places, strict=False)
        made = [_number((text or "").strip(), name, place) for text, place in pairs]
        return torch.tensor(made, dtype=torch.float64)
    numeric: tuple[Callable[[Any], bool], ...] = (
        types.is_boolean, types.is_integer, types.is_floating, types.is_decimal, types.is_null
    )  # fmt: skip
    if not any(holds(kind) for holds in numeric):
        raise DataError(f"column {name!r} of {where} is of type {kind}; give numbers")
    empty = torch.tensor(column.is_null().to_numpy())
    values = torch.tensor(column.cast(pyarrow.float64(), safe=False).to_numpy())
    for row in (values.isnan() & ~empty).nonzero()[:1, 0].tolist():
        raise DataError(f"{name!r} in row {row + 1} of {where} is nan; {GIVE}")
    return values


def _pyarrow(path: Path) -> tuple[Any, Any]:
    """The packages for Parquet files; DataError if they are not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as e:
        raise DataError(
            f"{str(path)!r} needs package 'pyarrow'; pip install 'cgtorch[data]', or use CSV"
        ) from e
    return pyarrow, pyarrow.parquet
