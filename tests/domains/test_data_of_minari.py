"""Minari datasets on disk, as they are and broken."""

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from cart_data import CONTROL, PERCEPT, refused, same_bits

from cgtorch import read_data


def episode(steps: int = 3, number: int = 0) -> dict[str, Any]:
    """The parts of an episode by their names in the file."""
    seen = np.arange(2.0 * steps + 2).reshape(-1, 2) + 100 * number
    return {
        "observations": seen,
        "actions": np.arange(float(steps)).reshape(-1, 1) + number,
        "rewards": np.zeros(steps),
        "infos/success": np.arange(steps) % 2 == 1,
    }


def minari(
    folder: Path, episodes: dict[str, dict[str, Any]] | None = None, data: str = "data"
) -> Path:
    """The folder of a dataset; a part that is None is left out."""
    (folder / data).mkdir(parents=True)
    with h5py.File(folder / data / "main_data.hdf5", "w") as file:
        for name, parts in ({"episode_0": episode()} if episodes is None else episodes).items():
            group = file.create_group(name)
            for place, value in parts.items():
                if value is not None:
                    group[place] = value
    return folder


@pytest.mark.parametrize("data", ["data", ""])
def test_a_minari_dataset(tmp_path: Path, data: str) -> None:
    episodes = {f"episode_{i}": episode(2 + i % 2, i) for i in (0, 2, 10, 1)}
    episodes["notes"] = {}
    found = read_data(minari(tmp_path / "set", episodes, data), PERCEPT, CONTROL)
    assert found.whole(2)
    assert found.control[:, 0].tolist() == [0, 1, 1, 2, 3, 2, 3, 10, 11]
    assert found.percept[:3, 0].tolist() == [0, 2, 100]
    assert torch.equal(found.next_percept, found.tested)
    assert found.next_percept[0].tolist() == [2, 3]
    assert found.succeeded.tolist() == [False, True, False, True, False, False, True, False, True]


def changed(**parts: Any) -> dict[str, dict[str, Any]]:
    """An episode with other parts; __ stands for a slash."""
    other = {name.replace("__", "/"): value for name, value in parts.items()}
    return {"episode_0": {**episode(), **other}}


SAME: list[dict[str, Any]] = [
    {"infos__success": np.array([1, 0, 1, 0])},  # the first one is of the beginning
    {"infos__success": np.array([[0.0], [1.0], [0.0]])},
    {"infos__success": None, "infos__is_success": np.array([False, True, False])},
    {"actions": np.arange(3)},
    {"actions": np.arange(3, dtype=">f4").reshape(3, 1)},
    {"observations": np.arange(8, dtype=np.float32).reshape(4, 1, 2)},
    {
        "observations": None,
        "observations/b": np.arange(1.0, 8, 2),
        "observations/a/deep": np.arange(0.0, 8, 2).reshape(4, 1),
    },
    {"observations": None, "observations/a/b/c/d/e/f/g/h": np.arange(8.0).reshape(4, 2)},
]


@pytest.mark.parametrize("parts", SAME)
def test_the_same_dataset_in_other_ways(tmp_path: Path, parts: dict[str, Any]) -> None:
    first = read_data(minari(tmp_path / "one"), PERCEPT, CONTROL)
    again = read_data(minari(tmp_path / "two", changed(**parts)), PERCEPT, CONTROL)
    assert same_bits(first, again)


def test_an_episode_without_steps(tmp_path: Path) -> None:
    parts = {**episode(0), "observations": np.zeros((1, 2)), "actions": np.zeros((0, 1))}
    found = read_data(minari(tmp_path / "set", {"episode_0": parts}), PERCEPT, CONTROL)
    assert len(found.percept) == len(found.tested) == 0


@pytest.mark.parametrize(
    ("episodes", "says"),
    [
        ({}, "main_data.hdf5' has no episode; give a Minari dataset with some"),
        (changed(infos__success=None), "cannot teach C; add it"),
        (changed(infos__success=None), "no success of each step (infos/success or infos/is_succe"),
        (changed(infos__success=np.zeros(2)), "success of episode_0 of 'set' is of shape (2, 1); "),
        (changed(infos__success=np.full(3, 2)), "success of episode_0 of 'set' has 2; give 0 or 1"),
        (changed(infos__success=np.full(3, np.nan)), "has nan; give 0 or 1 for each of 3 steps"),
        (changed(infos__success=np.array([b"a"] * 3)), "are (3,) of |S1; give rows of numbers"),
        (changed(observations=None), "episode_0 of 'set' has no 'observations'; give a whole"),
        (changed(actions=None), "episode_0 of 'set' has no 'actions'; give a whole"),
        (changed(observations=np.zeros((4, 3))), "have 3 numbers each, and a percept of the d"),
        (changed(actions=np.zeros((3, 2))), "actions of episode_0 of 'set' have 2 numbers each"),
        (changed(observations=np.zeros((3, 2))), "has 3 observations and 3 actions; one obser"),
        (
            changed(observations=np.array([[0, 1], [2, np.nan], [4, 5], [6, 7]])),
            "'wind' in observations 1 of episode_0 of 'set' is nan; leave the episode out",
        ),
        (changed(actions=np.full((3, 1), 1e39)), "'push' in actions 0 of episode_0 of 'set' is "),
        (changed(actions=np.float64(3)), "are () of float64; give rows of numbers"),
        ({"episode_0": {**episode(), "observations": None, "observations/a/b/c/d/e/f/g/h/i": 1}},
         "the observations of episode_0 of 'set' are empty or too deep"),
        (
            {"episode_0": {**episode(), "observations": None, "observations/a": np.zeros((4, 1)),
                           "observations/b": np.zeros((3, 1))}},
            "cannot read 'set/data/main_data.hdf5'",
        ),
    ],
)  # fmt: skip
def test_a_broken_minari_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, episodes: dict[str, Any], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused(minari(Path("set"), episodes))


def test_an_episode_that_is_no_group(tmp_path: Path) -> None:
    folder = minari(tmp_path / "set", {})
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        file["episode_0"] = np.zeros(3)
    assert "cannot read" in refused(folder) or "has no 'observations'" in refused(folder)


def test_an_array_that_fits_no_memory(tmp_path: Path) -> None:
    folder = minari(tmp_path / "set", changed(observations=None))
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        file["episode_0"].create_dataset("observations", (2**40, 2), "f4", chunks=(1024, 2))
    assert "are (1099511627776, 2) of float32; give rows of numbers" in refused(folder)


def test_what_is_no_hdf5(tmp_path: Path) -> None:
    path = minari(tmp_path / "set") / "data" / "main_data.hdf5"
    whole = path.read_bytes()
    for content in (b"", b"text", whole[:100], whole[: len(whole) // 2]):
        path.write_bytes(content)
        assert "is it a whole Minari dataset?" in refused(tmp_path / "set")


def test_a_ring_of_links(tmp_path: Path) -> None:
    folder = minari(tmp_path / "set", changed(observations=None))
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        ring = file["episode_0"].create_group("observations")
        ring["again"] = ring
    assert "are empty or too deep; give a whole Minari dataset" in refused(folder)


def test_without_h5py(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = minari(tmp_path / "set")
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "needs package 'h5py'; pip install 'cgtorch[data]'" in refused(folder)
