"""Data in Parquet files that others wrote, and broken ones."""

import math
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cart_data import CONTROL, GOOD, PERCEPT, refused, same_bits, some_data, written

from cgtorch import read_data, write_data
from cgtorch.ground.errors import DataError

COLUMNS: dict[str, list[Any]] = {
    "place": [1.5, 0.6],
    "wind": [0.1, 0.1],
    "push": [-1, None],
    "next place [m]": [0.6, None],
    "next wind [m]": [0.1, None],
    "succeeded": [None, 0],
}


def parquet(path: Path, **other: Any) -> Path:
    pq.write_table(pa.table({**COLUMNS, **other}), path)
    return path


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"succeeded": [None, False]},
        {"succeeded": [None, "FALSE"]},
        {"succeeded": [None, "0"]},
        {"succeeded": pa.array([None, "false"]).dictionary_encode()},
        {"succeeded": pa.array([None, "false"], pa.large_string())},
        {"succeeded": [None, 0.0]},
        {"place": pa.array([1.5, 0.6], pa.float32())},
        {"push": pa.array([-1, None], pa.int8())},
        {"note": ["a", "b"], "picture": [[1], [2]]},
    ],
)
def test_parquet_of_others(tmp_path: Path, other: dict[str, Any]) -> None:
    first = read_data(written(tmp_path / "a.csv", GOOD), PERCEPT, CONTROL)
    assert same_bits(read_data(parquet(tmp_path / "a.parquet", **other), PERCEPT, CONTROL), first)


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ({"place": ["1.5", "x"]}, "column 'place' of 'a.parquet' is of type string; give numbers"),
        ({"place": [[1.5], [0.6]]}, "column 'place' of 'a.parquet' is of type list"),
        ({"place": [{"a": 1.5}, {"a": 0.6}]}, "column 'place' of 'a.parquet' is of type struct"),
        ({"place [m]": [1.5, 0.6]}, "'a.parquet' has two columns 'place'; keep one of them"),
        ({"place": [1.5, math.nan]}, "'place' in row 2 of 'a.parquet' is nan; give a finite"),
        ({"place": [math.inf, 0.6]}, "'place' in row 1 of 'a.parquet' is inf; give a finite"),
        ({"place": [1e300, 0.6]}, "'place' in row 1 of 'a.parquet' is 1e+300; give a finite"),
        ({"place": [1.5, None]}, "row 2 of 'a.parquet' has an empty 'place'"),
        ({"succeeded": [None, 2]}, "'succeeded' in row 2 of 'a.parquet' is 2; give 0 or 1"),
        ({"succeeded": [None, "no"]}, "'succeeded' in row 2 of 'a.parquet' is 'no'; give 0 or 1"),
        ({"succeeded": [1, 0]}, "row 1 of 'a.parquet' is a transition and a test"),
        ({"succeeded": [None, None]}, "row 2 of 'a.parquet' is no transition and no test"),
    ],
)
def test_a_broken_table_in_parquet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: dict[str, Any], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused(parquet(Path("a.parquet"), **other))


def test_a_broken_parquet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("a.parquet")
    for content in (b"", b"PAR1", GOOD.encode(), bytes(range(256)) * 9, b"PAR1" + b"\xff" * 90):
        assert "'a.parquet' is no Parquet file" in refused(path, content)
    whole = parquet(path).read_bytes()
    for end in range(0, len(whole) - 1, 97):
        assert "'a.parquet' is no Parquet file" in refused(path, whole[:end])
    monkeypatch.setattr("cgtorch.domains.data_tables.MOST_BYTES", len(whole))
    many = {name: [values[0]] * 4000 for name, values in COLUMNS.items()}
    parquet(path, **many)
    assert len(path.read_bytes()) <= len(whole), "else it is refused for its own size"
    assert "has 4000 rows, which are too many; give fewer" in refused(path)


def test_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = parquet(tmp_path / "a.parquet")
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    assert "needs package 'pyarrow'; pip install 'cgtorch[data]', or use CSV" in refused(path)
    with pytest.raises(DataError, match="needs package 'pyarrow'"):
        write_data(tmp_path / "b.parquet", some_data(), PERCEPT, CONTROL)
    assert len(read_data(written(tmp_path / "a.csv", GOOD), PERCEPT, CONTROL).percept) == 1
