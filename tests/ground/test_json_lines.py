"""A log of JSON objects: every line is on disk at once, and what is torn or no JSON is found."""

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.ground.errors import RunError
from cgtorch.ground.files import JsonLines

VALUE = st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.text() | st.floats(-9, 9)
ROW = st.dictionaries(st.text(max_size=5), VALUE | st.lists(VALUE, max_size=3), max_size=4)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "log.jsonl"


@given(st.lists(ROW, max_size=6))
def test_what_is_written_is_read_in_order(place: Path, rows: list[dict[str, Any]]) -> None:
    place.unlink(missing_ok=True)
    log = JsonLines(place)
    assert place.exists() is False
    for i, row in enumerate(rows):
        log.append(row)
        assert list(JsonLines(place).rows()) == rows[: i + 1]
        assert place.read_bytes().count(b"\n") == i + 1
    assert list(log.rows()) == rows


@given(st.lists(ROW, min_size=1, max_size=4), st.data())
def test_a_torn_last_line_is_cut(place: Path, rows: list[dict[str, Any]], data: Any) -> None:
    """Wherever the process was killed, what was whole is there and what follows is, too."""
    place.unlink(missing_ok=True)
    log = JsonLines(place)
    for row in rows:
        log.append(row)
    whole = place.read_bytes()
    left = data.draw(st.integers(0, len(whole)))
    place.write_bytes(whole[:left])
    again = JsonLines(place)
    count = whole[:left].count(b"\n")
    assert list(again.rows()) == rows[:count]
    assert place.read_bytes() == whole[:left]  # whoever reads changes nothing
    again.append({"next": 1})
    assert list(again.rows()) == [*rows[:count], {"next": 1}]


def test_a_log_that_is_not_there_is_empty_and_made_with_its_first_line(tmp_path: Path) -> None:
    log = JsonLines(tmp_path / "log")
    assert not list(log.rows())
    assert not (tmp_path / "log").exists()
    log.append({})
    assert (tmp_path / "log").read_bytes() == b"{}\n"


@pytest.mark.parametrize(
    "line", [b"nonsense", b"", b"[1]", b"3", b'{"a": 1', b"\xff\xfe", b'{"a": 1} {"b": 2}']
)
def test_garbage_is_one_error_that_says_where(tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(b'{"a": 1}\n' + line + b'\n{"b": 2}\n')
    rows = JsonLines(path).rows()
    assert next(rows) == {"a": 1}
    with pytest.raises(RunError, match=f"line 2 of {re.escape(repr(str(path)))} is .*restore the"):
        next(rows)


def test_every_line_is_on_disk_before_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a crash of the machine would leave it: what was not synchronised is gone."""
    path, kept = tmp_path / "log", list[bytes]()
    fsync = os.fsync

    def synchronised(file: int) -> None:
        fsync(file)
        kept.append(path.read_bytes())

    monkeypatch.setattr(os, "fsync", synchronised)
    log = JsonLines(path)
    for i in range(4):
        log.append({"row": i})
        assert len(kept) == i + 1
        assert [json.loads(line)["row"] for line in kept[-1].splitlines()] == [*range(i + 1)]


def test_numbers_that_json_does_not_know_are_not_written(tmp_path: Path) -> None:
    log = JsonLines(tmp_path / "log")
    log.append({"a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        log.append({"a": float("nan")})
    assert list(log.rows()) == [{"a": 1}]


def test_where_nothing_can_be_written_is_one_error(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(RunError):
        JsonLines(tmp_path / "folder").append({"a": 1})
    with pytest.raises(RunError):
        JsonLines(tmp_path / "none" / "log").append({"a": 1})


def test_a_log_goes_on_in_another_process(tmp_path: Path) -> None:
    first = JsonLines(tmp_path / "log")
    first.append({"row": 0})
    second = JsonLines(tmp_path / "log")
    second.append({"row": 1})
    first.append({"row": 2})
    assert [row["row"] for row in second.rows()] == [0, 1, 2]
