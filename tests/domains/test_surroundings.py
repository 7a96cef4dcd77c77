"""What environments change of the process, and what stays."""

import io
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from cgtorch.domains.surroundings import check_defaults, surroundings
from cgtorch.ground.errors import DomainError


def streams() -> tuple[Any, ...]:
    return sys.stdout, sys.stderr


def replace_streams() -> None:
    sys.stdout, sys.stderr = io.StringIO(), io.StringIO()


@pytest.fixture(autouse=True)
def _as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(sys, "path", list(sys.path))
    mask, depth = os.umask(0o22), sys.getrecursionlimit()
    yield
    os.umask(mask)
    sys.setrecursionlimit(depth)


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (replace_streams, streams),
        (lambda: sys.path.clear(), lambda: len(sys.path)),
        (lambda: sys.setrecursionlimit(200), sys.getrecursionlimit),
        (lambda: torch.set_grad_enabled(False), torch.is_grad_enabled),
    ],
)
def test_what_belongs_to_the_process_stays(
    change: Callable[[], Any], seen: Callable[[], Any]
) -> None:
    before = seen()
    surroundings.begin()
    surroundings.call(change, lambda: "a call")
    assert seen() == before


def test_a_folder_that_is_removed_again_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own"

    def enter() -> None:
        own.mkdir()
        os.chdir(own)

    surroundings.call(lambda: (enter(), own.rmdir()), lambda: "a call")
    assert Path.cwd() == tmp_path
    surroundings.call(enter, lambda: "a call")
    own.rmdir()  # between two calls
    assert surroundings.call(Path.cwd, lambda: "a call") == Path.cwd() == tmp_path


def test_files_can_be_read_after_another_mask(tmp_path: Path) -> None:
    surroundings.begin()
    surroundings.call(lambda: os.umask(0o777), lambda: "a call")
    (tmp_path / "run.json").write_text("{}")
    assert stat.S_IMODE((tmp_path / "run.json").stat().st_mode) == 0o644


def test_a_closed_stream_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    surroundings.call(lambda: sys.stdout.close(), lambda: "a call")
    assert not sys.stdout.closed


def test_folders_of_modules_and_a_higher_limit_of_its_own_stay() -> None:
    surroundings.begin()
    depth = sys.getrecursionlimit() + 50
    surroundings.call(
        lambda: (sys.path.append("own"), sys.setrecursionlimit(depth)), lambda: "a call"
    )
    assert (sys.path[-1], sys.getrecursionlimit()) == ("own", depth)


def test_another_device_of_torch_is_told() -> None:
    torch.set_default_device("meta")
    try:
        with pytest.raises(
            DomainError, match=r"^Own sets torch's default device to meta, .*device="
        ):
            check_defaults("Own")
    finally:
        torch.set_default_device(None)
    check_defaults("Own")


def test_a_call_that_does_not_return_is_named_until_it_does() -> None:
    said = list[str]()

    def hang() -> None:
        said.append(surroundings.unreturned(60))
        time.sleep(0.02)
        said.append(surroundings.unreturned(0.01))
        raise ValueError("late")

    with pytest.raises(ValueError, match="late"):
        surroundings.call(hang, lambda: "step 3")
    assert said == ["", "step 3 has not returned for 0 s"]
    assert surroundings.unreturned(0) == ""
