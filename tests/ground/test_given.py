"""What callers give is what it should be, or one error that names it."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.given import (
    a_function,
    given_folder,
    given_path,
    given_seed,
    known_options,
    of_kind,
    real_number,
    says_true,
    truth,
    whole_number,
)
from cgtorch.runs.settings import Goal


class Place:
    """An object that stands for a path."""

    def __init__(self, path: Any):
        self.path = path

    def __fspath__(self) -> Any:
        return self.path


def test_a_path_is_a_text_or_an_object_that_stands_for_one() -> None:
    for path in ("a/b", Path("a/b"), Place("a/b")):
        assert given_path(path) == Path("a/b")
    for wrong in (None, 5, b"a", Place(b"a"), ["a"]):
        with pytest.raises(SettingsError, match=r"folder is .*; give a path as a text"):
            given_path(wrong, "folder")
    assert os.fspath(given_path("")) == "."


def test_a_path_is_one_that_a_file_can_have() -> None:
    for name in ("é" * 127, "x" * 255, os.fsdecode(b"\xff" * 255)):
        assert not given_path(name).exists()
    assert given_path("a/" * 2048) == Path("a/" * 2048)
    for name in ("é" * 128, f"a/{'x' * 256}/b", "a/" * 2049):
        with pytest.raises(SettingsError, match="too long; give names of at most 255 bytes"):
            given_path(name)
    for name in ("a\0b", "\ud800"):
        with pytest.raises(SettingsError, match=r"path is .*, which no file can be called"):
            given_path(name)


def test_a_folder_stays_the_same_when_the_program_goes_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    assert given_folder("a") == gone / "a"
    gone.rmdir()
    assert given_folder("/a") == Path("/a")
    with pytest.raises(SettingsError, match="the current folder is gone; give a path from /"):
        given_folder("a")


def test_whole_numbers_are_those_of_any_type() -> None:
    for number in (3, np.int64(3), np.uint8(3)):
        found = whole_number(number, "count", 0, 9)
        assert (found, type(found)) == (3, int)
    for wrong in (True, 3.0, np.float64(3), "3", None, -1, 10, [3]):
        with pytest.raises(SettingsError, match=r"count is .*; give a whole number from 0 to 9"):
            whole_number(wrong, "count", 0, 9)


def test_seeds_are_those_that_torch_takes() -> None:
    for seed in (-(2**63), -1, 0, 2**64 - 1):
        torch.Generator().manual_seed(given_seed(seed))
    for wrong in (-(2**63) - 1, 2**64):
        with pytest.raises(SettingsError, match="seed is"):
            given_seed(wrong)


def test_numbers_may_be_infinite_but_not_less_than_the_least() -> None:
    assert [real_number(x, "time") for x in (0, 2, np.float32(0.5))] == [0.0, 2.0, 0.5]
    assert real_number(float("inf"), "time") == float("inf")
    for wrong in (float("nan"), -1, "1", True, None, 1j, -(10**400), 10**400):
        with pytest.raises(SettingsError, match=r"time is .*; give a number of at least 0"):
            real_number(wrong, "time")


def test_truth_may_be_in_an_array_but_no_text() -> None:
    for yes in (True, 1, np.bool_(True), torch.tensor(True), torch.tensor([True])):
        assert truth(yes, "done") is True
    for no in (False, 0, np.bool_(False), torch.tensor(0)):
        assert truth(no, "done") is False
    for wrong in ("no", None, 2, [], 1.0, np.array([True, False]), torch.ones(2).bool()):
        with pytest.raises(SettingsError, match=r"done is .*; give True or False"):
            truth(wrong, "done")


def test_an_answer_is_true_or_of_no_meaning() -> None:
    for yes in (True, 1, np.bool_(True), torch.tensor(True)):
        assert says_true(yes)
    for no in (None, False, 0, 2, "yes", [1], np.ones(2), torch.ones(2)):
        assert not says_true(no)


def test_settings_are_plain_whatever_their_type() -> None:
    given = {"target": np.float32(18), "rounds": torch.tensor(3), "minutes": np.array(2.5)}
    found = known_options(Goal, given)
    assert found == {"target": 18.0, "rounds": 3, "minutes": 2.5}
    assert [type(each) for each in found.values()] == [float, int, float]
    env = known_options(GymnasiumSettings, {"env": {"gain": np.float64(1)}})["env"]
    assert type(env["gain"]) is float


def test_objects_and_functions_are_those_that_are_wanted() -> None:
    assert of_kind("a", str, "name", "a text") == "a"
    with pytest.raises(SettingsError, match="name is 5; give a text"):
        of_kind(5, str, "name", "a text")
    assert a_function(len, "watch") is len
    with pytest.raises(SettingsError, match="watch is 3; give a function"):
        a_function(3, "watch")


class Unspeakable:
    """An object that cannot be written."""

    def __repr__(self) -> str:
        raise RuntimeError("unfinished")


def test_a_value_that_cannot_be_written_is_told_by_its_type() -> None:
    with pytest.raises(SettingsError, match="name is a value of type Unspeakable; give a text"):
        of_kind(Unspeakable(), str, "name", "a text")
    with pytest.raises(SettingsError, match="count is a value of type int; give a whole number"):
        whole_number(10**5000, "count", 0, 9)
