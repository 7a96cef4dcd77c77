"""Files: whole or not at all, one error whatever they contain, and a log that survives a kill."""

import json
import os
import re
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import save

from cgtorch.ground.errors import GraphError, RunError
from cgtorch.ground.files import (
    JsonLines,
    notes_of,
    place_of,
    read_bytes,
    read_json,
    read_versioned,
    tensors_of,
    whole_folder,
    write_bytes,
    write_json,
    writing,
)

VALUE = st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.text() | st.floats(-9, 9)
ROW = st.dictionaries(st.text(max_size=5), VALUE | st.lists(VALUE, max_size=3), max_size=4)


def test_round_trip_replaces_the_old_content_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for data in ({"x": [1, 2.5, None, True, "ä"]}, [], {"y": -0.0}):
        write_json(path, data)
        assert read_json(path) == data
        assert list(tmp_path.iterdir()) == [path]


def test_all_bytes_are_with_the_system_when_a_file_is_made_durable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crash after a rename must not leave an empty file under the new name."""
    sizes = list[int]()
    monkeypatch.setattr(os, "fsync", lambda file: sizes.append(os.fstat(file).st_size))
    for data in (b"12345", b"1" * 10**6, b""):
        write_bytes(tmp_path / "a", data)
    assert sizes == [5, 10**6, 0]


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_keeps_the_old_content_and_no_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})

    def fails(_: int) -> None:
        raise fault

    monkeypatch.setattr("os.fsync", fails)
    error = RunError if isinstance(fault, OSError) else KeyboardInterrupt
    with pytest.raises(error, match=r"a\.json.*No space left on device|^$"):
        write_json(path, {"new": 2})
    assert read_json(path) == {"old": 1}
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("data", [float("nan"), [float("inf")], {"x": object()}, {1j: 2}, "loop"])
def test_what_is_not_plain_data_is_refused_before_anything_is_written(
    tmp_path: Path, data: object
) -> None:
    if data == "loop":
        data = loop = []  # type: ignore[var-annotated]
        loop.append(loop)
    with pytest.raises(GraphError, match=r"cannot write .*a\.json"):
        write_json(tmp_path / "a.json", data, GraphError)
    assert not list(tmp_path.iterdir())


def test_unwritable_paths(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "folder", tmp_path / "none" / "a", tmp_path / "nul\0"):
        with pytest.raises(RunError, match="cannot write"):
            write_json(path, {})
        with pytest.raises(RunError):
            JsonLines(path).append({"a": 1})
    assert list(tmp_path.rglob("*")) == [tmp_path / "folder"]


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        RunError, match=r"cannot write .*/file/run/a' .*; '/.*/file' is a file; choose another$"
    ):
        write_json(tmp_path / "file" / "run" / "a", {})
    with pytest.raises(RunError, match="/file' is a file"), writing(tmp_path / "file" / "run"):
        (tmp_path / "file" / "run").mkdir(parents=True)


def test_only_a_file_is_replaced_by_a_whole_new_one(tmp_path: Path) -> None:
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(RunError, match="which is a device or a pipe; give the path of a file"):
            write_bytes(path, b"new")
    for folder in (".", ""):
        with pytest.raises(RunError, match=r"cannot write '.', which is a folder; give the path"):
            write_bytes(folder, b"new")
    assert pipe.is_fifo()
    assert link.is_symlink()
    assert sorted(tmp_path.iterdir()) == [link, pipe]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not proper JSON"),
        (b"{", "not proper JSON"),
        (b"\xff\xfe", "not proper JSON"),
        (b"PK\x03\x04", "is a zip file; unpack it"),
        (b"\x1f\x8b\x08", "is compressed; unpack it"),
        (b'{\n<<<<<<< HEAD\n"a": 1}', "has marks of a conflict in git; resolve it"),
        (b"NaN", "NaN is not finite"),
        (b"[-Infinity]", "-Infinity is not finite"),
        (b"[1e999]", "1e999 is not finite"),
        (b'{"a": 1, "a": 2}', "'a' comes twice"),
        (b"9" * 5000, "not proper JSON"),
        (b"[" * 100_000, "not proper JSON"),
        (b'{"a":' * 100_000, "not proper JSON"),
        (b"[" * 100_000 + b"]" * 100_000, "not proper JSON"),
        (json.dumps("x" * 10**6).encode(), "larger than 500000 bytes"),
    ],
)
def test_bad_content_ends_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(RunError, match=message) as caught:
        read_json(path, max_bytes=500_000)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_key_that_comes_twice_is_found_at_once_among_very_many(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({str(i): 0 for i in range(50_000)})[:-1] + ', "49999": 1}')
    with pytest.raises(RunError, match="key '49999' comes twice"):
        read_json(path)


def test_what_is_no_file_is_not_read(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing", Path("/dev/zero"), tmp_path / "nul\0"):
        with pytest.raises(GraphError, match=r"not a file|cannot read"):
            read_json(path, error=GraphError)


def test_bytes_come_back_unless_they_are_too_many_and_take_no_more_memory(tmp_path: Path) -> None:
    path = tmp_path / "a"
    write_bytes(path, b"12345")
    tracemalloc.start()
    try:
        assert read_bytes(path, 2**30) == b"12345"
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(GraphError, match="larger than 4 bytes"):
        read_bytes(path, 4, GraphError)
    with path.open("wb") as file:
        file.truncate(2**40)  # a hole, of which nothing is read
    with pytest.raises(RunError, match="larger than"):
        read_bytes(path, 2**30)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "log.jsonl"


@given(st.lists(ROW, max_size=4), st.data())
def test_a_log_is_read_in_order_and_a_torn_last_line_is_cut(
    place: Path, rows: list[dict[str, Any]], data: Any
) -> None:
    """Wherever the process was killed, what was whole is there and what follows is, too."""
    place.unlink(missing_ok=True)
    log = JsonLines(place)
    assert not list(log.rows())
    assert not place.exists()
    for i, row in enumerate(rows):
        log.append(row)
        assert list(JsonLines(place).rows()) == rows[: i + 1]
        assert place.read_bytes().count(b"\n") == i + 1
    whole = place.read_bytes() if rows else b""
    left = data.draw(st.integers(0, len(whole)))
    place.write_bytes(whole[:left])
    again = JsonLines(place)
    count = whole[:left].count(b"\n")
    assert list(again.rows()) == rows[:count]
    assert place.read_bytes() == whole[:left]  # whoever reads changes nothing
    again.append({"next": 1})
    assert list(again.rows()) == [*rows[:count], {"next": 1}]


@pytest.mark.parametrize(
    "line", [b"nonsense", b"", b"[1]", b"3", b'{"a": 1', b"\xff\xfe", b'{"a": 1} {"b": 2}']
)
def test_garbage_in_a_log_is_one_error_that_says_where(tmp_path: Path, line: bytes) -> None:
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
    log, other = JsonLines(path), JsonLines(path)  # as of another process
    for i, one in enumerate((log, other, log)):
        one.append({"row": i})
        assert len(kept) == i + 1
        assert [json.loads(line)["row"] for line in kept[-1].splitlines()] == [*range(i + 1)]


def test_numbers_that_json_does_not_know_are_not_logged(tmp_path: Path) -> None:
    log = JsonLines(tmp_path / "log")
    log.append({"a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        log.append({"a": float("nan")})
    assert list(log.rows()) == [{"a": 1}]


def test_a_folder_can_appear_where_a_link_leads(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "disk" / "run")
    (tmp_path / "disk").mkdir()
    with whole_folder(tmp_path / "link") as folder:
        (folder / "a").write_text("1")
    assert (tmp_path / "disk" / "run" / "a").read_text() == "1"
    assert (tmp_path / "link").is_symlink()
    assert not list(tmp_path.rglob("*.tmp"))


def test_only_the_first_lines_of_a_log_cost_a_look_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log of a long run is large, and gets many lines."""
    path, looks, read = tmp_path / "log", list[Path](), Path.read_bytes
    path.write_bytes(b'{"a": 1}\n{"torn')
    log = JsonLines(path)
    assert list(log.rows()) == [{"a": 1}]
    monkeypatch.setattr(Path, "read_bytes", lambda path: looks.append(path) or read(path))
    log.append()  # nothing, which changes nothing
    assert looks == []
    log.append({"b": 2}, {"b": 3})
    log.append({"c": 4})
    assert looks == [path]
    assert read(path) == b'{"a": 1}\n{"b": 2}\n{"b": 3}\n{"c": 4}\n'


def test_what_a_full_disk_tore_is_cut_off_before_the_next_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, write = tmp_path / "log", os.write
    log = JsonLines(path)
    log.append({"a": 1})

    def full(file: int, data: bytes) -> int:
        write(file, data[:4])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(RunError, match="No space left on device"):
            log.append({"b": 2})
    assert list(log.rows()) == [{"a": 1}]
    log.append({"c": 3})
    assert list(log.rows()) == [{"a": 1}, {"c": 3}]
    slowly = lambda file, data: write(file, data[:3])  # noqa: E731  as a system may
    monkeypatch.setattr(os, "write", slowly)
    log.append({"d": 4}, {"e": "ä"})
    assert list(log.rows())[2:] == [{"d": 4}, {"e": "ä"}]


def test_rows_of_a_log_that_begin_with_a_text(tmp_path: Path) -> None:
    log = JsonLines(tmp_path / "log")
    log.append({"a": 1}, {"b": 2}, {"a": 3}, {"c": 4})
    assert list(log.rows('{"a"')) == [{"a": 1}, {"a": 3}]
    assert list(log.rows('{"c"', '{"a": 1')) == [{"a": 1}, {"c": 4}]
    with log.path.open("ab") as file:
        file.write(b"nonsense\n")
    assert list(log.rows('{"b"')) == [{"b": 2}]  # the others are not looked at


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", "is not of a thing; restore the file or give another"),
        ('{"version": 3}', "is not of a thing; restore"),
        ('{"format": "other", "version": 3}', "is not of a thing; restore"),
        ('{"format": "thing"}', "is of version None, this cgtorch reads 3; use the version that"),
        ('{"format": "thing", "version": 2}', "is of version 2, this cgtorch reads 3"),
        ('{"format": "thing", "version": "%s"}' % ("9" * 500), "is of version '9{19}, this"),
    ],
)
def test_what_has_another_format_or_version_is_not_read(
    tmp_path: Path, content: str, message: str
) -> None:
    path = tmp_path / "a.json"
    data = {"format": "thing", "version": 3, "more": [1]}
    write_json(path, data)
    assert read_versioned(path, "thing", 3, "a thing") == data
    path.write_text(content)
    with pytest.raises(RunError, match=message) as caught:
        read_versioned(path, "thing", 3, "a thing")
    assert repr(str(path)) in str(caught.value)


@pytest.mark.parametrize(
    ("given", "place"),
    [("/a/b/run", "run"), ("runs/one", "runs/one"), ("../one", "../one"), ("one", "one")],
)
def test_a_place_in_a_text_says_nothing_of_the_machine(given: str, place: str) -> None:
    assert place_of(Path(given)) == Path(place)


def test_the_folder_that_one_is_in_is_called_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert place_of(Path()) == Path(tmp_path.name)


def test_a_folder_that_fails_does_not_appear(tmp_path: Path) -> None:
    def write(folder: Path) -> None:
        (folder / "a").write_text("1")
        raise KeyError

    with pytest.raises(KeyError), whole_folder(tmp_path / "run") as folder:
        write(folder)
    assert not list(tmp_path.iterdir())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "kept").touch()
    with pytest.raises(RunError, match=r"cannot write .*run"), whole_folder(tmp_path / "run"):
        pass
    with pytest.raises(RunError, match=r"cannot write .*/none/run"):
        whole_folder(tmp_path / "none" / "run").__enter__()
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "run", tmp_path / "run" / "kept"]


def test_tensors_and_notes_come_back_from_bytes_and_damage_is_one_error() -> None:
    tensors = {"x": torch.arange(3.0), "y": torch.tensor([[True]])}
    whole = save(tensors, {"about": "1"})
    assert notes_of(whole) == {"about": "1"}
    assert notes_of(save(tensors)) == {}
    found = tensors_of(whole)
    assert found.keys() == tensors.keys()
    assert all(torch.equal(found[name], tensors[name]) for name in tensors)
    for damaged in (b"", whole[:-1], whole + b"1", b"9" * 100, whole[:20]):
        with pytest.raises(ValueError, match=r"^.{1,200}$"):
            tensors_of(damaged)
