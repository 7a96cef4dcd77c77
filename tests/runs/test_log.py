"""The log of a run: every event once, however often it is interrupted, and the evidence in it."""

import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from told_by_runs import logged, result_of
from trained import Trained

from cgtorch.evolution.population import STRATEGY
from cgtorch.ground.asked import NAMES as ASKED
from cgtorch.ground.errors import CgtorchError, RunError
from cgtorch.improvement.events import (
    Event,
    GenerationDone,
    ModelsFitted,
    SkillAccepted,
    WorldAsked,
    WorldTested,
)
from cgtorch.improvement.improve import OTHER
from cgtorch.improvement.trial import try_skill
from cgtorch.runs.log import COLUMNS, LOG, SOON, SPREAD_EVERY, LogWatch, Row, read_log, spreads
from cgtorch.runs.storage import load_evidence, load_progress
from cgtorch.runs.stored_run import read_run

DOCUMENTED = Path(__file__).parents[2] / "docs" / "log.md"
TIMES = ("time", "seconds", "search_seconds")


def plain(rows: list[Row]) -> list[Row]:
    """Rows without times."""
    return [{name: row[name] for name in row if name not in TIMES} for row in rows]


def log_of(folder: Path, events: tuple[Event, ...]) -> list[Row]:
    """The log in a folder after a process that told these events."""
    watch = LogWatch(folder)
    for event in events:
        watch(event)
    return read_log(folder)


def test_every_event_has_a_row_with_all_columns(trained: Trained) -> None:
    rows = read_log(trained.folder)
    for kind, name in (
        (GenerationDone, "generation"),
        (WorldTested, "candidate"),
        (SkillAccepted, "accepted"),
        (WorldAsked, "asked"),
        (ModelsFitted, "models"),
    ):
        wanted = sum(isinstance(event, kind) for event in trained.events)
        assert len(logged(trained.folder, name)) == wanted > 0
    of_rounds = {"decisive", "mean_holds", "in_a_row", "practice"}
    for row in rows:
        assert set(row) >= {"event", "time", *COLUMNS[row["event"]]} - of_rounds
    assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)


def test_a_generation_says_what_tensorboard_shows(trained: Trained) -> None:
    told = [e for e in trained.events if isinstance(e, GenerationDone)]
    for row, event in zip(logged(trained.folder, "generation"), told, strict=True):
        found = event.generation
        assert (row["stage"], row["candidate"]) == (event.stage, event.candidate)
        assert (row["generation"], row["best"]) == (found.number, found.best)
        assert row["mean"] == pytest.approx(float(found.fitness.mean()), rel=1e-5)
        assert row["low"] <= row["high"] <= row["best"]
        assert row["nodes"] == int(found.champion.graphs.num_nodes)
        assert (row["solved_m"], row["size_m"]) == (event.solved_m, event.size_m)
        assert (row["strategy"] is not None) == (found.number % SPREAD_EVERY == 0)
        if row["strategy"]:
            assert list(row["strategy"]) == list(STRATEGY)
            means = [mean for _, mean, _ in row["strategy"].values()]
            assert means == pytest.approx(found.population.strategy.mean(0).tolist(), abs=1e-5)


def test_a_spread_is_the_middle_of_a_column() -> None:
    values = torch.stack([torch.arange(101.0), torch.full((101,), 3.0)], 1).numpy()
    assert spreads(values) == [[10.0, 50.0, 90.0], [3.0, 3.0, 3.0]]


def test_the_columns_are_those_of_the_docs() -> None:
    """Each kind of row has a table, with a line for each column."""
    text = DOCUMENTED.read_text()
    for kind, columns in COLUMNS.items():
        section = text.split(f"\n### `{kind}`")[1].split("\n#")[0]
        names = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
        found = [name.strip(" `") for cell in names for name in cell.split(",")]
        assert found == list(columns), kind


def test_what_is_done_again_is_not_doubled(trained: Trained, tmp_path: Path) -> None:
    """As after a kill at any moment: the first half is repeated, in other times."""
    whole, half = trained.events, len(trained.events) // 2
    log_of(tmp_path, whole[:half])
    again = tuple(
        replace(e, seconds=77.0) if isinstance(e, GenerationDone | ModelsFitted) else e
        for e in whole
    )
    rows = log_of(tmp_path, again)
    shutil.copy(tmp_path / LOG, tmp_path / "kept")
    assert plain(rows) == plain(log_of(tmp_path, whole))
    assert (tmp_path / LOG).read_bytes() == (tmp_path / "kept").read_bytes()
    (tmp_path / "alone").mkdir()
    assert plain(rows) == plain(log_of(tmp_path / "alone", whole))
    asked = [e.asked for e in whole if isinstance(e, WorldAsked)]
    found = [tuple(row[name] for name in ASKED) for row in rows if row["event"] == "asked"]
    assert found == [tuple(vars(each).values()) for each in asked]  # also equal ones, each once


def test_what_happens_twice_is_there_twice(trained: Trained, tmp_path: Path) -> None:
    """A repeated event stands for one row of before, and a second one like it is new."""
    asked = next(event for event in trained.events if isinstance(event, WorldAsked))
    assert len(log_of(tmp_path, (asked,))) == 1
    assert len(log_of(tmp_path, (asked, asked))) == 2
    assert len(log_of(tmp_path, (asked, asked))) == 2


def test_the_log_of_a_run_is_what_its_events_come_to(trained: Trained, tmp_path: Path) -> None:
    ends = ("result", "ended")
    kept = [row for row in read_log(trained.folder) if row["event"] not in ends]
    assert plain(kept) == plain(log_of(tmp_path, trained.events))
    for stage, result in zip(("S0", "S1"), trained.results, strict=True):
        assert result_of(trained.folder, stage).items() >= result.items()
    assert [row["stage"] for row in logged(trained.folder, "ended")] == ["S1"]


def test_a_cut_last_line_is_not_there_and_the_log_goes_on(trained: Trained, tmp_path: Path) -> None:
    whole = log_of(tmp_path, trained.events)
    path = tmp_path / LOG
    path.write_bytes(path.read_bytes()[:-7])
    assert read_log(tmp_path) == whole[:-1]
    assert plain(log_of(tmp_path, trained.events)) == plain(whole)


def test_a_full_disk_is_one_error_and_costs_one_line(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a line is written, which the next one does not follow."""
    first, *rest = (e for e in trained.events if isinstance(e, WorldTested))
    watch, write, left = LogWatch(tmp_path), os.write, [40]

    def full(file: int, data: bytes) -> int:
        if not left[0]:
            raise OSError(28, "No space left on device")
        part, left[0] = data[: left[0]], 0
        return write(file, part)

    watch(first)
    monkeypatch.setattr("os.write", full)
    with pytest.raises(RunError, match="No space left on device"):
        watch(rest[0])
    monkeypatch.undo()
    assert len(read_log(tmp_path)) == 1
    watch(rest[0])
    assert [row["candidate"] for row in read_log(tmp_path)] == [first.candidate, rest[0].candidate]


def test_a_stage_that_begins_again_under_other_settings_voids_its_rows(tmp_path: Path) -> None:
    look = {"event": "look", "stage": "S1", "phase": "trials", "episode": 1, "percept": [0.0]}
    stages = [
        {"event": "chance", "stage": name, "succeeded": 1, "tried": 2} for name in ("S0", "S1")
    ]
    change = {"event": "changed", "stage": "S1", "changed": {"population": [60, 30]}}
    for aside, count in ((None, 4), ("set-aside/1", 3)):
        rows = [look, *stages, {**change, "set_aside": aside}]
        lines = (json.dumps({"time": i, **row}) + "\n" for i, row in enumerate(rows))
        (tmp_path / LOG).write_text("".join(lines))
        found = read_log(tmp_path)
        assert len(found) == count
        assert found[0]["event"] == "look"  # the robot has acted all the same
        assert found[-2]["stage"] == ("S0" if aside else "S1")


def test_generations_reach_the_disk_with_what_follows_or_soon(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("time.time", lambda: now[0])
    first, second, third, *_ = (e for e in trained.events if isinstance(e, GenerationDone))
    watch = LogWatch(tmp_path)
    watch(first)
    assert not read_log(tmp_path)
    watch(next(e for e in trained.events if isinstance(e, WorldTested)))
    assert [row["event"] for row in read_log(tmp_path)] == ["generation", "candidate"]
    watch(second)
    now[0] += SOON + 0.1
    watch(third)
    assert len(read_log(tmp_path)) == 4


VALUES = [None, -1, 1.5, True, "x", [], {}, 10**30, 1e300, {"succeeded": 4, "tried": 3}]


@pytest.mark.parametrize("kind", ["result", "accepted", "models", "generation", "asked"])
def test_a_row_with_a_wrong_value_is_one_error_that_says_where(
    trained: Trained, tmp_path: Path, kind: str
) -> None:
    rows = read_log(trained.folder)
    number = next(i for i, row in enumerate(rows) if row["event"] == kind)
    said = []
    for column in ("event", "time", *COLUMNS[kind]):
        for value in VALUES:
            lines = [*rows[:number], {**rows[number], column: value}]
            (tmp_path / LOG).write_text("".join(json.dumps(row) + "\n" for row in lines))
            try:
                read_log(tmp_path)
            except RunError as e:
                said.append((column, str(e)))
    assert len(said) > 6 * len(COLUMNS[kind])
    for column, message in said:
        assert message.startswith(f"{column} in line {number + 1} of ")
        assert "\n" not in message


@pytest.mark.parametrize("asked", [3, {"trials": 3}, {"trials": {}}, {"trials": {"motions": 1}}])
def test_counts_of_what_was_asked_are_whole(
    trained: Trained, tmp_path: Path, asked: object
) -> None:
    """A run that cannot say what it has asked of its world cannot keep to a budget."""
    row = logged(trained.folder, "result")[-1]
    (tmp_path / LOG).write_text(json.dumps({**row, "asked": asked}) + "\n")
    with pytest.raises(RunError, match="asked in line 1 of"):
        read_log(tmp_path)


def test_a_run_whose_log_lacks_a_result(trained: Trained, tmp_path: Path) -> None:
    folder = shutil.copytree(trained.folder, tmp_path / "run")
    rows = [row for row in read_log(folder) if (row["event"], row["stage"]) != ("result", "S1")]
    (folder / LOG).write_text("".join(json.dumps(row) + "\n" for row in rows))
    with pytest.raises(RunError, match=r"log\.jsonl' has no result of S1; restore the file"):
        _ = read_run(folder).results


def test_the_evidence_is_what_the_world_says(trained: Trained) -> None:
    """Eq. 1 from the files alone: the world gives the same result on every scenario again."""
    run, parent, before = read_run(trained.folder), None, 0
    for name in ("S0", "S1"):
        (row,) = logged(run.folder, "accepted", name)
        skill = load_progress(run, run.folder / name).skill
        assert skill is not None
        every, was, succeeded = load_evidence(run.folder / name / "scenarios.json", run.like())
        again = try_skill(skill, run.domain.world(every)).succeeded
        assert torch.equal(again, succeeded)
        in_w, in_m = (torch.tensor([w == kind for w in was]) for kind in ("W", "M"))
        assert again[in_w].all()  # eq. 1a
        assert again[in_m].any()  # eq. 1b
        counts = int(in_w.sum()), 0, int(in_m.sum()), int(again[in_m].sum())
        names = "w_before", "w_lost", "m_before", "m_solved"
        assert tuple(row[name] for name in names) == counts
        assert len(was) == sum(counts[::2])  # it was tried on all that the stage has met
        assert (row["skill"], row["parent"]) == (name, parent)
        assert row["members"] == list(skill.sub_skills)
        assert counts[0] >= before
        parent, before = name, int(succeeded.sum())


def test_w_under_other_noise(trained: Trained) -> None:
    """All of W, which is small here, was met by other noise than its own and mostly holds."""
    run = read_run(trained.folder)
    for name in ("S0", "S1"):
        progress = load_progress(run, run.folder / name)
        assert progress.skill is not None
        others = progress.solved.with_noise(OTHER)
        again = try_skill(progress.skill, run.domain.world(others)).succeeded
        (row,) = logged(run.folder, "accepted", name)
        counts = {"tried": len(progress.solved), "succeeded": int(again.sum())}
        assert row["w_other_noise"] == counts
        assert again.sum() > len(progress.solved) / 2


CHANGES: list[Callable[[dict[str, Any]], object]] = [
    lambda d: d.pop("was"),
    lambda d: d.update(was=3),
    lambda d: d["was"].append("W"),
    lambda d: d["was"].__setitem__(0, "X"),
    lambda d: d["was"].__setitem__(0, []),
    lambda d: d.update(W={}),
    lambda d: d["W"].append(None),
    lambda d: d["W"][0].pop("seed"),
    lambda d: d["W"][0].update(pose=[1]),
]


@pytest.mark.parametrize("change", CHANGES)
def test_damaged_evidence(
    trained: Trained, tmp_path: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    data = json.loads((trained.folder / "S1" / "scenarios.json").read_text())
    change(data)
    path = tmp_path / "scenarios.json"
    path.write_text(json.dumps(data))
    with pytest.raises(RunError) as caught:
        load_evidence(path, read_run(trained.folder).like())
    assert "\n" not in str(caught.value)


def test_damaged_bytes_end_in_a_typed_error(trained: Trained, tmp_path: Path) -> None:
    folder, choice = shutil.copytree(trained.folder, tmp_path / "run"), random.Random(0)
    run, rows, errors = read_run(folder), read_log(folder), 0
    few = [row for row in rows if row["event"] != "generation"]
    raw = "".join(json.dumps(row) + "\n" for row in few).encode()
    for _ in range(100):
        damaged = bytearray(raw)
        for _ in range(3):
            damaged[choice.randrange(len(raw))] = choice.randrange(256)
        (folder / LOG).write_bytes(bytes(damaged))
        try:
            _ = run.results
        except CgtorchError:
            errors += 1
    assert errors > 50
