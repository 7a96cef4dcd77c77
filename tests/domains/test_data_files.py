"""Data in files: the same numbers come back in every bit, and each fault is named in one line."""

import csv
import io
import math
import subprocess
import sys
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from cart_data import CONTROL, GOOD, HEADER, PERCEPT, refused, same_bits, some_data, written
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from cgtorch import Field, read_data, write_data
from cgtorch.domains.data_files import check_enough, units_of
from cgtorch.domains.data_tables import as_csv
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError

NAMES = (
    "x",
    "next",
    "a, b",
    'quo"te',
    "Länge",
    "two\nlines",
    " wide ",
    "[v]",
    "q [raw]",
    "u.v",
    "π",
)
UNITS = ("", "m", "rad", "m/s²", "[s]", "a,b")


FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@st.composite
def datasets(draw: st.DrawFn) -> tuple[Dataset, tuple[Field, ...], tuple[Field, ...]]:
    """Data of a domain with odd names and units."""
    names = draw(st.lists(st.sampled_from(NAMES), min_size=2, max_size=5, unique=True))
    fields = [Field(name, draw(st.sampled_from(UNITS))) for name in names]
    d = draw(st.integers(1, len(fields) - 1))
    percept, control = tuple(fields[:d]), tuple(fields[d:])

    def rows(count: int, size: int) -> Tensor:
        numbers = draw(st.lists(FLOATS, min_size=count * size, max_size=count * size))
        return torch.tensor(numbers, dtype=torch.float32).view(count, size)

    n, m = draw(st.integers(0, 5)), draw(st.integers(0, 5))
    succeeded = draw(st.lists(st.booleans(), min_size=m, max_size=m))
    moved = rows(n, d), rows(n, len(control)), rows(n, d)
    data = Dataset(*moved, rows(m, d), torch.tensor(succeeded, dtype=torch.bool))
    return data, percept, control


@pytest.mark.parametrize("name", ["data.csv", "data.PARQUET"])
@given(made=datasets())
def test_what_was_written_is_read_in_every_bit(
    tmp_path_factory: pytest.TempPathFactory, name: str, made: tuple[Dataset, Any, Any]
) -> None:
    data, percept, control = made
    path = tmp_path_factory.mktemp("data") / name
    try:
        units_of(percept, control)
    except DataError:  # such as "q [raw]" without a unit beside a q in raw
        return
    write_data(path, data, percept, control)
    assert same_bits(read_data(path, percept, control), data)


@given(st.integers(0, 2**32 - 1))
@example(0x00000001)
@example(0x80000000)
@example(0x7F7FFFFF)
def test_every_number_survives_as_text(bits: int) -> None:
    number = np.uint32(bits).view(np.float32)
    if not np.isfinite(number):
        return
    text = as_csv(["x"], torch.tensor([[float(number)]])).decode().splitlines()[1]
    again = torch.tensor([float(text)], dtype=torch.float64).float()
    assert again.numpy().view(np.uint32)[0] == bits


def test_a_file_is_as_one_would_write_it(tmp_path: Path) -> None:
    data = read_data(written(tmp_path / "a.csv", GOOD), PERCEPT, CONTROL)
    assert torch.equal(data.percept, torch.tensor([[1.5, 0.1]]))
    assert torch.equal(data.control, torch.tensor([[-1.0]]))
    assert torch.equal(data.next_percept, torch.tensor([[0.6, 0.1]]))
    assert torch.equal(data.tested, torch.tensor([[0.6, 0.1]]))
    assert data.succeeded.tolist() == [False]
    write_data(tmp_path / "b.csv", data, PERCEPT, CONTROL)
    assert (tmp_path / "b.csv").read_text() == GOOD


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff" + GOOD,  # as spreadsheets write it
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\n\n"),
        GOOD.replace(" [m]", ""),
        GOOD.replace(",", " , "),
        GOOD.replace("place [m]", '"place [m]"', 1),
        GOOD.replace(",0\n", ",False\n").replace(",0.1,-1", ",1e-1,-1"),
        GOOD.replace(",0\n", ",0.0\n"),
        "note," + HEADER + ",note\nx,1.5,0.1,-1,0.6,0.1,,\ny,0.6,0.1,,,,0,z\n",
        "succeeded,next wind,next place,push,wind,place\n,0.1,0.6,-1,0.1,1.5\n0,,,,0.1,0.6\n",
    ],
)
def test_the_same_in_other_ways(tmp_path: Path, content: str) -> None:
    first = read_data(written(tmp_path / "a.csv", GOOD), PERCEPT, CONTROL)
    again = read_data(written(tmp_path / "b.csv", content), PERCEPT, CONTROL)
    assert same_bits(first, again)


def test_several_files_follow_one_another(tmp_path: Path) -> None:
    one, two = some_data(3, 2), some_data(5, 4)
    paths = [tmp_path / "a.csv", str(tmp_path / "b.parquet")]
    for path, data in zip(paths, (one, two), strict=True):
        write_data(path, data, PERCEPT, CONTROL)
    assert same_bits(read_data(paths, PERCEPT, CONTROL), one.extended(two))
    nothing = read_data([], PERCEPT, CONTROL)
    assert [t.shape for t in astuple(nothing)] == [(0, 2), (0, 1), (0, 2), (0, 2), (0,)]


def row(text: str) -> str:
    """A file with a good line and this one, which is line 3."""
    return f"{HEADER}\n0.6,0.1,,,,1\n{text}\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "is empty; give a header"),
        ("\n", "is empty; give a header"),
        (HEADER.replace("wind [m],", "", 1), "lacks column 'wind'; give a column for each"),
        ("place,push\n", "lacks columns 'wind', 'next place', 'next wind', 'succeeded'; give"),
        (f"{HEADER},place\n", "has two columns 'place'; keep one of them"),
        (HEADER.replace("place [m]", "place [cm]", 1), "'place [cm]' of 'a.csv' is in 'cm', and"),
        (
            HEADER.replace("push [m]", "push []"),
            "is in '', and 'push' of the domain is in 'm'; con",
        ),
        (HEADER.replace("succeeded", "succeeded [%]"), "'succeeded' of the domain is without a un"),
        (GOOD.replace(",", ";"), "the columns of 'a.csv' are separated by ';'; use commas"),
        (GOOD.replace(",", "\t"), "are separated by '\\t'; use commas"),
        (row("1,2,3,4,5"), "line 3 of 'a.csv' has 5 cells, and the header has 6; is it whole?"),
        (row("1,2,3,4,5,,"), "line 3 of 'a.csv' has 7 cells"),
        (row("1,2,3,4,5,1"), "line 3 of 'a.csv' is a transition and a test; give the test a row"),
        (row("1,2,,,,"), "line 3 of 'a.csv' is no transition and no test; give a control and"),
        (row(",,,,,"), "line 3 of 'a.csv' is no transition and no test"),
        (row("1,2,3,,,"), "line 3 of 'a.csv' has a control but no next percept ('next place' is e"),
        (row("1,2,3,,,"), "as where an episode was cut short; leave the row out"),
        (row("1,2,,4,5,"), "has a next percept but no control ('push' is empty); leave the row"),
        (row("1,2,3,4,,"), "line 3 of 'a.csv' has an empty 'next wind'; fill it in, or leave the"),
        (row("1,,3,4,5,"), "line 3 of 'a.csv' has an empty 'wind'; fill it in"),
        (row("1,,3,,,"), "line 3 of 'a.csv' has an empty 'wind'; fill it in"),
        (row(",2,,,,1"), "line 3 of 'a.csv' has an empty 'place'; fill it in"),
        (row("1,2,x,4,5,"), "'push' in line 3 of 'a.csv' is 'x'; give a finite number, or leave"),
        (row("1,2,nan,4,5,"), "'push' in line 3 of 'a.csv' is 'nan'; give a finite number"),
        (row("1,2,3,-inf,5,"), "'next place' in line 3 of 'a.csv' is -inf; give a finite number"),
        (row("1e39,2,3,4,5,"), "'place' in line 3 of 'a.csv' is 1e+39; give a finite number"),
        (row("1_0,2,3,4,5,"), "'place' in line 3 of 'a.csv' is '1_0'; give a finite number"),
        (row('"1,5",2,3,4,5,'), "'place' in line 3 of 'a.csv' is '1,5'; give a finite number"),
        (row("1,2,,,,yes"), "'succeeded' in line 3 of 'a.csv' is 'yes'; give 0 or 1"),
        (row("1,2,,,,0.5"), "'succeeded' in line 3 of 'a.csv' is 0.5; give 0 or 1"),
        (row("1,2,,,,nan"), "'succeeded' in line 3 of 'a.csv' is 'nan'; give 0 or 1"),
        (row('1,2,"3'), "'a.csv' is no CSV in UTF-8 (unexpected end of data); give another"),
        (
            row("1,2,3,4,5," + "9" * 200_000),
            "has a cell of more than 131072 characters; short",
        ),
        (GOOD.encode("utf-16"), "'a.csv' is no CSV in UTF-8 ('utf-8' codec can't decode byte"),
        (bytes(range(256)), "is no CSV in UTF-8"),
        (b"\0" * 50, "lacks columns"),
    ],
)
def test_a_broken_csv(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | bytes, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused(Path("a.csv"), content)


def test_the_line_is_that_of_the_file(tmp_path: Path) -> None:
    """Empty lines count, and so do those within quotes."""
    content = f'"note\nof two lines",{HEADER}\n\n"a\nb",0.6,0.1,,,,1\nc,x,1,,,,1\n'
    assert "'place' in line 6 of" in refused(tmp_path / "a.csv", content)


def test_what_is_no_file_of_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    assert "'none.csv', which is not a file; check the path" in refused(Path("none.csv"))
    assert "'none.parquet', which is not a file" in refused(Path("none.parquet"))
    for name in ("a.txt", "none", "a.csv.gz", "main_data.hdf5"):
        assert f"'{name}' is of no known format; give a file that ends in" in refused(Path(name))
    assert "'folder' has no main_data.hdf5; give the folder of a Minari" in refused(Path("folder"))
    (tmp_path / "folder.csv").mkdir()
    assert "has no main_data.hdf5" in refused(Path("folder.csv"))
    monkeypatch.setattr("cgtorch.domains.data_tables.MOST_BYTES", 90)
    assert "is larger than 90 bytes" in refused(Path("a.csv"), GOOD)


@given(st.binary(max_size=300))
@example(HEADER.encode() + b"\n\0,\0,\0,\0,\0,\0")
@example(HEADER.encode() + b"\n" + b"1" * 400 + b",1,,,,1")
def test_any_bytes_are_data_or_refused(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes
) -> None:
    path = tmp_path_factory.mktemp("any")
    for content in (raw, HEADER.encode() + b"\n" + raw):
        try:
            data = read_data(written(path / "a.csv", content), PERCEPT, CONTROL)
        except DataError as e:
            said = str(e)
        else:
            said = "" if data.whole(2) else "nothing"
        assert "\n" not in said
        assert len(said) < 700
        assert said != "nothing"


CELLS = st.sampled_from(
    ["", "0", "1", "-2.5", "true", "nan", "inf", "1e99", "x", '"', "\r", "\n", ",", "٣", "0x1", " "]
)


@given(st.lists(st.lists(CELLS, min_size=4, max_size=7), max_size=4))
@settings(max_examples=80)
def test_any_cells_are_data_or_refused(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[str]]
) -> None:
    content = "\n".join([HEADER, *map(",".join, rows)])
    path = written(tmp_path_factory.mktemp("cells") / "a.csv", content)
    try:
        data = read_data(path, PERCEPT, CONTROL)
    except DataError:
        return
    assert data.whole(2)
    assert len(data.percept) + len(data.tested) == len(
        [line for line in csv.reader(io.StringIO(content, newline="")) if line][1:]
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"paths": None}, "path is None; give a path as a text or a pathlib.Path"),
        ({"paths": [3]}, "path is 3; give a path"),
        ({"paths": b"a.csv"}, "path is .*; give a path"),
        ({"paths": "a\0.csv"}, "which no file can be called"),
        ({"paths": ["x" * 300 + ".csv"]}, "is too long; give names of at most 255 bytes"),
        ({"percept": None}, "percept is None; give a list of Field, as domain.percept is"),
        ({"percept": ["place"]}, r"percept is \['place'\]; give a list of Field"),
        ({"control": 3}, "control is 3; give a list of Field, as domain.control is"),
        ({"control": "push"}, "control is 'push'; give a list of Field"),
    ],
)
def test_what_names_no_data_is_said(given: dict[str, Any], message: str, tmp_path: Path) -> None:
    about: dict[str, Any] = {"percept": PERCEPT, "control": CONTROL, **given}
    place: Any = about.pop("paths", tmp_path / "a.csv")
    with pytest.raises(DataError, match=message):
        read_data(place, **about)
    one = place[0] if isinstance(place, list) else place
    with pytest.raises(DataError, match=message):
        write_data(one, some_data(), **about)


def test_what_is_no_dataset_is_said(tmp_path: Path) -> None:
    nothing: Any = None
    with pytest.raises(DataError, match="dataset is None; give a Dataset, as read_data returns"):
        write_data(tmp_path / "a.csv", nothing, PERCEPT, CONTROL)


def test_data_that_cannot_be_written(tmp_path: Path) -> None:
    data = some_data()
    for percept, control in ((PERCEPT[:1], CONTROL), (PERCEPT, CONTROL * 0)):
        with pytest.raises(DataError, match="finite numbers a row"):
            write_data(tmp_path / "a.csv", data, percept, control)
    data.percept[0, 0] = math.nan
    with pytest.raises(DataError, match="2 and 1 finite numbers a row"):
        write_data(tmp_path / "a.csv", data, PERCEPT, CONTROL)
    with pytest.raises(DataError, match=r"'a.txt' is of no known format"):
        write_data("a.txt", some_data(), PERCEPT, CONTROL)
    with pytest.raises(DataError, match="cannot write"):
        write_data(tmp_path / "no" / "a.csv", some_data(), PERCEPT, CONTROL)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("percept", "control", "twice"),
    [
        (("x", "x"), ("u",), "x"),
        (("x",), ("x",), "x"),
        (("x", "next x"), ("u",), "next x"),
        (("x",), ("succeeded",), "succeeded"),
    ],
)
def test_two_columns_of_one_name(
    tmp_path: Path, percept: tuple[str, ...], control: tuple[str, ...], twice: str
) -> None:
    with pytest.raises(DataError, match=f"two columns '{twice}'; give its percepts and controls d"):
        read_data(
            written(tmp_path / "a.csv", GOOD),
            tuple(map(Field, percept)),
            tuple(map(Field, control)),
        )


def test_too_few_data(tmp_path: Path) -> None:
    check_enough(some_data(10, 6))
    for moves, tests, says in (
        (9, 6, "have 9 transitions, 3 tests that succeeded and 3 that failed, and at least 10 tra"),
        (10, 5, "have 10 transitions, 3 tests that succeeded and 2 that failed"),
        (0, 0, "have 0 transitions, 0 tests that succeeded and 0 that failed"),
    ):
        with pytest.raises(DataError, match=says):
            check_enough(some_data(moves, tests))


@pytest.mark.parametrize("package", ["pyarrow", "h5py"])
def test_packages_are_imported_only_if_needed(package: str) -> None:
    code = f"import sys, cgtorch.domains.data_files; print({package!r} in sys.modules)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "False\n"
