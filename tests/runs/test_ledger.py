"""The ledger: all history, all evidence, every skill restored; and what damage does to it."""

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from trained import Trained

from cgtorch.graphs import skill_to_dict
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.improvement.events import SkillAccepted
from cgtorch.improvement.improve import OTHER
from cgtorch.improvement.trial import try_skill
from cgtorch.runs.ledger import WAS, enter, read_entry, read_index
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import read_run

W, M, NEW = range(len(WAS))


def last_accepted(trained: Trained, name: str) -> SkillAccepted[Any]:
    """The last skill that a stage accepted, which is the one in the ledger."""
    found = [e for e in trained.events if isinstance(e, SkillAccepted) and e.stage == name]
    return found[-1]


def test_the_whole_history_can_be_read(trained: Trained) -> None:
    index = read_index(trained.folder)
    assert [(s["name"], s["parent"]) for s in index] == [("S0", None), ("S1", "S0")]
    run = read_run(trained.folder)
    for line, result in zip(index, trained.results, strict=True):
        entry = read_entry(trained.folder, line["name"], run.actions, run.like())
        assert entry.summary == line
        assert line["members"] == list(entry.skill.sub_skills)
        kept = last_accepted(trained, line["name"]).keep  # the stage's W, and what it solved
        assert (line["w_before"], line["w_lost"]) == (int(kept.sum()), 0)
        assert line["w_before"] >= result["w_size"]
        assert line["m_solved"] > 0
        assert (line["nodes"], line["depth"]) == (result["nodes"], result["depth"])


def test_every_skill_is_restored_as_it_was(trained: Trained) -> None:
    run = read_run(trained.folder)
    for name in ("S0", "S1"):
        restored = read_entry(trained.folder, name, run.actions, run.like()).skill
        kept = load_progress(run, run.folder / name).skill
        assert kept is not None
        assert skill_to_dict(restored) == skill_to_dict(kept)


def test_the_evidence_is_what_the_world_says(trained: Trained) -> None:
    """Eq. 1 from the ledger alone: the world gives the same result on every scenario again."""
    run = read_run(trained.folder)
    for name in ("S0", "S1"):
        entry = read_entry(run.folder, name, run.actions, run.like())
        again = try_skill(entry.skill, run.domain.world(entry.scenarios)).succeeded
        assert torch.equal(again, entry.succeeded)
        assert again[entry.was == W].all()  # eq. 1a
        assert again[entry.was == M].any()  # eq. 1b


def test_w_under_other_noise(trained: Trained) -> None:
    """All of W, which is small here, was met by other noise than its own and mostly holds."""
    run = read_run(trained.folder)
    for name in ("S0", "S1"):
        entry = read_entry(run.folder, name, run.actions, run.like())
        solved = load_progress(run, run.folder / name).solved
        again = try_skill(entry.skill, run.domain.world(solved.with_noise(OTHER))).succeeded
        assert entry.other_noise == entry.summary["w_other_noise"]
        assert entry.other_noise == {"tried": len(solved), "succeeded": int(again.sum())}
        assert again.sum() > len(solved) / 2


def test_a_ledger_from_before_other_noise_was_tried(trained: Trained, tmp_path: Path) -> None:
    shutil.copytree(trained.folder / "ledger", tmp_path / "ledger")
    for path in (tmp_path / "ledger").iterdir():
        data = json.loads(path.read_text())
        for line in data.get("skills", [data]):
            del line["w_other_noise"]
        path.write_text(json.dumps(data))
    assert [s["name"] for s in read_index(tmp_path)] == ["S0", "S1"]
    run = read_run(trained.folder)
    entry = read_entry(tmp_path, "S1", run.actions, run.like())
    assert entry.other_noise is None
    assert entry.summary["w_other_noise"] is None


def test_w_and_m_before_and_after(trained: Trained) -> None:
    """What a stage ends with is what its entry says, and W before is W after the one before."""
    run = read_run(trained.folder)

    def seeds(rows: Any) -> list[Any]:
        return sorted(zip(rows.seed.tolist(), rows.object.tolist(), strict=True))

    before: list[Any] = []
    for name in ("S0", "S1"):
        entry = read_entry(run.folder, name, run.actions, run.like())
        progress = load_progress(run, run.folder / name)
        was = seeds(entry.scenarios[entry.was == W])
        assert all(each in was for each in before)
        assert seeds(entry.scenarios[entry.succeeded]) == seeds(progress.solved)
        assert seeds(entry.scenarios[~entry.succeeded]) == seeds(progress.missed)
        assert int((entry.was != NEW).sum()) == len(last_accepted(trained, name).scenarios)
        assert not (entry.was == NEW).any()  # it was tried on all that the stage has met
        before = seeds(progress.solved)


def test_entries_are_for_people_too(trained: Trained) -> None:
    lines = (trained.folder / "ledger" / "S1.json").read_text().splitlines()
    rows = [line for line in lines if '"was"' in line]
    run = read_run(trained.folder)
    assert len(rows) == len(read_entry(trained.folder, "S1", run.actions, run.like()).scenarios)
    assert all(json.loads(row.rstrip(",")) for row in rows)


def test_an_entry_made_again_replaces_the_old_one(trained: Trained, tmp_path: Path) -> None:
    shutil.copytree(trained.folder / "ledger", tmp_path / "ledger")
    run = read_run(trained.folder)
    was = (tmp_path / "ledger" / "S1.json").read_bytes()
    enter(tmp_path, read_entry(trained.folder, "S1", run.actions, run.like()))
    assert read_index(tmp_path) == read_index(trained.folder)
    assert (tmp_path / "ledger" / "S1.json").read_bytes() == was
    assert not any(path.name.endswith(".tmp") for path in (tmp_path / "ledger").iterdir())


def test_a_run_without_a_ledger(tmp_path: Path, trained: Trained) -> None:
    assert read_index(tmp_path) == []
    run = read_run(trained.folder)
    with pytest.raises(RunError, match="this one has no ledger"):
        read_entry(tmp_path, "S0", run.actions, run.like())


CHANGES: list[Callable[[dict[str, Any]], object]] = [
    lambda d: d.update(version=2),
    lambda d: d.update(format="other"),
    lambda d: d.update(parent=3),
    lambda d: d.update(w_other_noise=3),
    lambda d: d.update(w_other_noise={"tried": 3, "succeeded": 4}),
    lambda d: d.update(skill=None),
    lambda d: d["skill"].update(name="S0"),
    lambda d: d.update(scenarios={}),
    lambda d: d["scenarios"].append(None),
    lambda d: d["scenarios"][0].update(was="X"),
    lambda d: d["scenarios"][0].update(was=[]),
    lambda d: d["scenarios"][0].update(succeeded=1),
    lambda d: d["scenarios"][0].pop("seed"),
    lambda d: d["scenarios"][0].update(pose=[1]),
]


@pytest.mark.parametrize("change", range(len(CHANGES)))
def test_damaged_entries(trained: Trained, tmp_path: Path, change: int) -> None:
    shutil.copytree(trained.folder / "ledger", tmp_path / "ledger")
    path = tmp_path / "ledger" / "S1.json"
    data = json.loads(path.read_text())
    CHANGES[change](data)
    path.write_text(json.dumps(data))
    run = read_run(trained.folder)
    with pytest.raises(CgtorchError) as caught:
        read_entry(tmp_path, "S1", run.actions, run.like())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["../S1", "/etc/passwd", "", ".S1", "a/b", None, 3])
def test_names_in_the_index_lead_nowhere(trained: Trained, tmp_path: Path, name: object) -> None:
    shutil.copytree(trained.folder / "ledger", tmp_path / "ledger")
    path = tmp_path / "ledger" / "index.json"
    data = json.loads(path.read_text())
    data["skills"][0]["name"] = name
    path.write_text(json.dumps(data))
    with pytest.raises(RunError, match="skills of"):
        read_index(tmp_path)


@pytest.mark.parametrize("file", ["index.json", "S1.json"])
def test_damaged_bytes_end_in_a_typed_error(trained: Trained, tmp_path: Path, file: str) -> None:
    shutil.copytree(trained.folder / "ledger", tmp_path / "ledger")
    path, choice = tmp_path / "ledger" / file, random.Random(file)
    raw, run = path.read_bytes(), read_run(trained.folder)
    errors = 0
    for _ in range(60):
        damaged = bytearray(raw)
        for _ in range(3):
            damaged[choice.randrange(len(raw))] = choice.randrange(256)
        path.write_bytes(bytes(damaged))
        try:
            read_entry(tmp_path, "S1", run.actions, run.like())
        except CgtorchError:
            errors += 1
    assert errors > 20
