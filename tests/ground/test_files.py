import json
import tracemalloc
from pathlib import Path

import pytest

from cgtorch.ground.errors import GraphError, RunError
from cgtorch.ground.files import read_bytes, read_json, write_bytes, write_json


def test_round_trip_replaces_the_old_content_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for data in ({"x": [1, 2.5, None, True, "ä"]}, [], {"y": -0.0}):
        write_json(path, data)
        assert read_json(path) == data
        assert list(tmp_path.iterdir()) == [path]


def test_a_failed_write_keeps_the_old_content_and_no_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(RunError, match=r"a\.json.*No space left on device"):
        write_json(path, {"new": 2})
    assert read_json(path) == {"old": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_write_leaves_no_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(tmp_path / "a", b"x")
    assert not list(tmp_path.iterdir())


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
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]
    assert not list((tmp_path / "folder").iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not proper JSON"),
        (b"{", "not proper JSON"),
        (b"\xff\xfe", "not proper JSON"),
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


def test_what_is_no_file_is_not_read(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing", Path("/dev/zero"), tmp_path / "nul\0"):
        with pytest.raises(GraphError, match=r"not a file|cannot read"):
            read_json(path, error=GraphError)


def test_bytes_come_back_unless_they_are_too_many(tmp_path: Path) -> None:
    path = tmp_path / "a"
    write_bytes(path, b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(GraphError, match="larger than 4 bytes"):
        read_bytes(path, 4, GraphError)
    with path.open("wb") as file:
        file.truncate(2**40)  # a hole, of which nothing is read
    with pytest.raises(RunError, match="larger than"):
        read_bytes(path, 2**30)


def test_a_key_that_comes_twice_is_found_at_once_among_very_many(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({str(i): 0 for i in range(300_000)})[:-1] + ', "299999": 1}')
    with pytest.raises(RunError, match="key '299999' comes twice"):
        read_json(path)


def test_reading_takes_no_more_memory_than_there_is_to_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    write_bytes(path, b"12345")
    tracemalloc.start()
    try:
        read_bytes(path, 2**30)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
