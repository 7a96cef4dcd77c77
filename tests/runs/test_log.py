"""The log of a run has a line for all that happened, and reads as rows for pandas."""

from dataclasses import replace
from pathlib import Path

import pytest
from trained import Trained

from cgtorch.ground.files import JsonLines
from cgtorch.improvement.events import GenerationDone, SkillAccepted, WorldTested
from cgtorch.runs.log import SOON, LogWatch, rows_of


def test_every_generation_and_candidate_has_a_line(trained: Trained, tmp_path: Path) -> None:
    log = JsonLines(tmp_path / "log.jsonl")
    with LogWatch(log) as watch:
        for event in trained.events:
            watch(event)
    rows = rows_of(log)
    generations = [e for e in trained.events if isinstance(e, GenerationDone)]
    told = [row for row in rows if row["event"] == "generation"]
    assert len(told) == len(generations) > 5
    for row, event in zip(told, generations, strict=True):
        assert (row["stage"], row["candidate"]) == (event.stage, event.candidate)
        assert row["generation"] == event.generation.number
        assert row["best"] == pytest.approx(event.generation.best)
        assert row["mean"] <= row["best"] + 1e-6
        assert row["nodes"] == int(event.generation.champion.graphs.num_nodes)
        assert (row["solved_m"], row["size_m"]) == (event.solved_m, event.size_m)
    for name, kind in (("candidate", WorldTested), ("accepted", SkillAccepted)):
        wanted = sum(isinstance(e, kind) for e in trained.events)
        assert sum(row["event"] == name for row in rows) == wanted > 0
    assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)


def test_a_generation_that_comes_again_counts_once(trained: Trained, tmp_path: Path) -> None:
    """As after an interruption: the last one counts, where it stands."""
    log = JsonLines(tmp_path / "log.jsonl")
    first, second, *_ = (e for e in trained.events if isinstance(e, GenerationDone))
    with LogWatch(log) as watch:
        for event in (first, second, replace(first, seconds=77.0)):
            watch(event)
    assert len(list(log.rows())) == 3
    found = rows_of(log)
    assert [row["generation"] for row in found] == [second.generation.number, 0]
    assert found[1]["seconds"] == 77.0


def test_generations_reach_the_disk_with_what_follows_or_soon(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, now = JsonLines(tmp_path / "log.jsonl"), [100.0]
    monkeypatch.setattr("time.time", lambda: now[0])
    done = next(e for e in trained.events if isinstance(e, GenerationDone))
    other = next(e for e in trained.events if isinstance(e, WorldTested))
    watch = LogWatch(log)
    watch(done)
    assert not list(log.rows())
    watch(other)
    assert [row["event"] for row in log.rows()] == ["generation", "candidate"]
    watch(done)
    now[0] += SOON + 0.1
    watch(done)
    assert len(list(log.rows())) == 4
    with watch:
        watch(done)
    assert len(list(log.rows())) == 5
