"""Damaged and foreign files of a run: a typed error of one line, or a run that still works."""

import json
import random
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import torch
from support import seeded, world
from trained import Trained, copied

from cgtorch.evolution import EvolutionSettings, evolve
from cgtorch.graphs import load_skill
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.runs.storage import (
    load_population,
    load_progress,
    load_tensors,
    save_tensors,
)
from cgtorch.runs.stored_run import StoredRun, read_run

FILES = [
    "run.json",
    "S0/skill.json",
    "S0/scenarios.json",
    "S0/seen.safetensors",
    "S0/data.safetensors",
    "S0/gamma.safetensors",
    "S0/classifier.safetensors",
    "S0/specialists.safetensors",
]
TRIES = 100


@pytest.fixture(scope="module")
def folder(trained: Trained, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run up to S0 that may be damaged, one file at a time."""
    return copied(trained, tmp_path_factory.mktemp("damaged") / "run", ("S0",))


def used(folder: Path, file: str) -> None:
    """Do with a file of the run what the commands do with it."""
    if file == "run.json":
        read_run(folder)
        return
    run = opened(folder)
    if file.endswith("skill.json"):
        load_skill(folder / file, run.actions)
    elif file.endswith("specialists.safetensors"):
        seeds = load_population(folder / file, run.actions)
        settings = EvolutionSettings(population=8)
        search = evolve(world(0, 2), run.actions, settings, seeded(0), seeds=seeds)
        next(search), next(search)
    else:
        progress = load_progress(run, folder / "S0")
        run.domain.world(progress.solved).start(torch.arange(len(progress.solved)))


@cache
def opened(folder: Path) -> StoredRun:
    return read_run(folder)


def attempt(read: Callable[[], object]) -> str:
    """What the error says, "" if there is none; any error of another kind fails the test."""
    message = ""
    try:
        read()
    except CgtorchError as e:
        message = str(e)
    assert "\n" not in message
    assert len(message) < 700
    return message


def damaged(raw: bytes, choice: random.Random) -> bytes:
    """Bytes with a few of them flipped, taken out, put in or cut off."""
    found = bytearray(raw)
    # The beginning of a safetensors file says what the rest is: it is hit as often as the rest.
    length = len(raw) if choice.random() < 0.5 else min(len(raw), 1500)
    for _ in range(choice.randint(1, 4)):
        at = choice.randrange(length)
        match choice.randrange(5):
            case 0 | 1:
                found[at : at + 1] = bytes([choice.randrange(256)])
            case 2:
                del found[at : at + choice.randint(1, 20)]
            case 3:
                found[at:at] = choice.choice([b"0", b"9" * 30, b"-", b"e999", b'"', b"[", b"{}"])
            case 4 if choice.random() < 0.3:
                del found[at:]
    return bytes(found)


@pytest.mark.parametrize("file", FILES)
def test_damaged_files_end_in_a_typed_error(folder: Path, file: str) -> None:
    path, choice = folder / file, random.Random(file)
    raw = path.read_bytes()
    used(folder, file)
    messages = []
    try:
        for _ in range(TRIES):
            path.write_bytes(damaged(raw, choice))
            messages.append(attempt(lambda: used(folder, file)))
    finally:
        path.write_bytes(raw)
    assert sum(bool(m) for m in messages) > TRIES // 4
    used(folder, file)


@pytest.mark.parametrize("file", FILES)
def test_foreign_files(folder: Path, file: str, tmp_path: Path) -> None:
    path = folder / file
    raw = path.read_bytes()
    foreign = [
        b"",
        b"\0" * 100,
        b"null",
        b"[]",
        b"{}",
        b"3",
        b'"text"',
        b"[" * 100_000,
        struct.pack("<Q", 2**60) + b"{}",
        *((folder / other).read_bytes() for other in FILES if other != file),
    ]
    try:
        for content in foreign:
            path.write_bytes(content)
            assert attempt(lambda: used(folder, file)), content[:40]
        path.unlink()
        assert attempt(lambda: used(folder, file))
        path.mkdir()
        assert attempt(lambda: used(folder, file))
        path.rmdir()
    finally:
        path.write_bytes(raw)


@pytest.mark.parametrize(
    "change",
    [
        lambda seen: seen[:-1],
        lambda seen: torch.cat([seen, seen]),
        lambda seen: seen[:, :-1],
        lambda seen: seen[:0],
        lambda seen: seen.flatten(),
        lambda seen: seen.double(),
        lambda seen: seen.long(),
        lambda seen: seen * float("nan"),
        lambda seen: seen + float("inf"),
    ],
)
def test_percepts_that_are_not_those_of_w_and_m(
    folder: Path, change: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    run, path = read_run(folder), folder / "S0" / "seen.safetensors"
    raw = path.read_bytes()
    try:
        save_tensors(path, {"percepts": change(load_tensors(path, {"percepts"})["percepts"])}, {})
        with pytest.raises(
            RunError,
            match=r"in .*seen.safetensors' are .* of shape .*, and those of W and M are |"
            r"and seen.safetensors beside it the percepts of",
        ):
            load_progress(run, folder / "S0")
    finally:
        path.write_bytes(raw)


def test_a_run_of_the_version_before(folder: Path) -> None:
    """Its log had other columns."""
    path = folder / "run.json"
    raw = path.read_text()
    try:
        assert json.loads(raw)["version"] == 6
        path.write_text(json.dumps({**json.loads(raw), "version": 5}))
        message = attempt(lambda: read_run(folder))
        assert message.endswith(
            "is of version 5, this cgtorch reads 6; use the version that wrote it"
        )
    finally:
        path.write_text(raw)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("action", lambda x: x + 1000),
        ("action", lambda x: torch.full_like(x, -1)),
        ("action", lambda x: x.int()),
        ("edges", lambda x: x + 1),
        ("edges", lambda x: torch.full_like(x, 10**6)),
        ("edges", lambda x: x[:, :, :1]),
        ("parameters", lambda x: x * float("nan")),
        ("parameters", lambda x: x.double()),
        ("parameters", lambda x: x[:, :1]),
        ("start", lambda x: x - 5),
        ("start", lambda x: x[:0]),
        ("strategy", lambda x: x + float("inf")),
        ("strategy", lambda x: x[:, :3]),
    ],
)
def test_graphs_that_are_not_valid(
    folder: Path, tmp_path: Path, name: str, change: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    run = read_run(folder)
    names = {"action", "edges", "parameters", "start", "strategy"}
    tensors = load_tensors(folder / "S0/specialists.safetensors", names)
    path = tmp_path / "specialists.safetensors"
    save_tensors(path, tensors, {})
    load_population(path, run.actions)
    save_tensors(path, {**tensors, name: change(tensors[name])}, {})
    with pytest.raises(RunError, match="does not hold valid graphs"):
        load_population(path, run.actions)


@pytest.mark.parametrize("name", ["robot.urdf", "robot.json"])
def test_a_run_without_its_robot(folder: Path, name: str) -> None:
    path = folder / "robot" / name
    raw = path.read_bytes()
    try:
        for content in (b"", b"<robot", b"{}", raw[: len(raw) // 2]):
            path.write_bytes(content)
            assert attempt(lambda: read_run(folder))
        path.unlink()
        assert attempt(lambda: read_run(folder))
    finally:
        path.write_bytes(raw)


def test_models_of_the_other_kind(folder: Path) -> None:
    run = read_run(folder)
    gamma, classifier = (folder / "S0" / f"{n}.safetensors" for n in ("gamma", "classifier"))
    raw = gamma.read_bytes(), classifier.read_bytes()
    try:
        gamma.write_bytes(raw[1])
        classifier.write_bytes(raw[0])
        with pytest.raises(RunError, match="other models than Γ and C"):
            load_progress(run, folder / "S0")
    finally:
        gamma.write_bytes(raw[0])
        classifier.write_bytes(raw[1])
