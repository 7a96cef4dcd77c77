"""Several ranks come to what one does, to the last bit."""

import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from forked_ranks import as_first_rank, as_rank, everything, gather, on_ranks, train
from hypothesis import given
from hypothesis import strategies as st
from torch._C._distributed_c10d import HashStore
from trained import SMALL, trained_run

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from measure_ranks import torchrun

from cgtorch.domains.settings import to_plain
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import RobotStoppedError, RunError
from cgtorch.runs.log import read_log

RESTARTED = """
import os, signal, sys
import torch
from cgtorch.ground import distributed as ranks
from cgtorch.runs.log import read_log

with ranks.together():
    if int(os.environ["TORCHELASTIC_RESTART_COUNT"]) < 1:
        ranks.wait()
        if ranks.first():
            os.kill(os.getpid(), signal.SIGKILL)
        ranks.wait()
    ranks.wait()  # one that ends while others still connect would break their connection
    if ranks.first():
        print("met again")
"""


@pytest.mark.hostile
def test_ranks_that_were_started_again_meet(tmp_path: Path) -> None:
    script = tmp_path / "restarted.py"
    script.write_text(RESTARTED)
    assert "met again" in torchrun(2, ["--max-restarts=1", str(script)])


def test_no_start_of_ranks_is_called_as_one_before() -> None:
    store = HashStore()
    names = [ranks.name_of_start(store, 0, 1) for _ in range(3)]
    assert len(set(names)) == 3
    store.set("word of 1", "left by a rank that is gone")
    with ThreadPoolExecutor(3) as pool:
        late = pool.submit(ranks.name_of_start, store, 0, 3)
        time.sleep(0.3)
        others = [pool.submit(ranks.name_of_start, store, rank, 3) for rank in (1, 2)]
        assert len({each.result(30) for each in [late, *others]} - set(names)) == 1


def test_alone_everything_is_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gather(tmp_path)
    assert capsys.readouterr().out == "1 gathered all\n"


def test_uneven_parts_are_gathered_in_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_first_rank(5, gather, tmp_path, output=tmp_path / "printed.txt")
    assert capsys.readouterr().out == "5 gathered all\n"
    assert ranks.count() == 1  # this process left them at the end
    assert ranks._groups.cache_info().currsize == 0  # and forgot which groups there were


def test_looks_at_common_work_become_rarer_up_to_a_millisecond(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slept, looks, waited = list[float](), iter(range(51)), list[bool]()

    class Work:
        def is_completed(self) -> bool:
            return next(looks) == 50

        def wait(self) -> None:
            waited.append(True)

    monkeypatch.setattr(time, "sleep", slept.append)
    work: Any = Work()
    ranks._finish(work)
    assert waited == [True]
    assert slept[:21] == pytest.approx([i * 5e-5 for i in range(21)])
    assert slept[21:] == pytest.approx([1e-3] * 29)


def test_a_lost_rank_is_one_error_and_others_stay_themselves() -> None:
    with pytest.raises(ranks.RankLostError, match="its own error says why"), ranks._others_there():
        raise RuntimeError("connection closed")
    for error in (RunError("x"), RobotStoppedError("x"), ValueError("x")):
        with pytest.raises(type(error), match=r"^x$"), ranks._others_there():
            raise error


@given(st.integers(0, 40), st.integers(1, 9))
def test_rows_are_shared_evenly_and_in_order(rows: int, size: int) -> None:
    shares = [ranks.share(rows, ranks.Group(i, size)) for i in range(size)]
    assert [row for share in shares for row in range(rows)[share]] == list(range(rows))
    sizes = [len(range(rows)[share]) for share in shares]
    assert max(sizes) - min(sizes) <= 1


@given(st.integers(1, 12), st.integers(1, 12))
def test_parts_are_held_evenly_and_each_by_somebody(parts: int, size: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ranks, "count", lambda: size)
        holds = [ranks.held(parts, rank) for rank in range(size)]
    assert {part for held in holds for part in held} == set(range(parts))
    assert all(a.start <= b.start for a, b in pairwise(holds))
    assert max(map(len, holds)) - min(map(len, holds)) <= 1
    if size <= parts:
        assert sum(map(len, holds)) == parts


def test_cores_are_shared_by_the_ranks_of_a_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(6))
    monkeypatch.delenv("LOCAL_WORLD_SIZE", raising=False)
    assert ranks.cores() == 6
    for size, cores in ((1, 6), (4, 1), (3, 2), (7, 1)):
        monkeypatch.setenv("LOCAL_WORLD_SIZE", str(size))
        assert ranks.cores() == cores
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 14)
    assert ranks.cores() == 2
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert ranks.cores() == 1


def test_islands_are_the_same_on_any_number_of_ranks_and_go_on_where_they_stood(
    tmp_path: Path,
) -> None:
    """Broken off after five generations on some ranks, and ended on others."""

    def found(count: int, folder: str, stop: int) -> list[Any]:
        output = tmp_path / f"{folder}-{count}.txt"
        on_ranks(count, as_rank, tmp_path / folder, stop, output=output)
        return json.loads(output.read_text().splitlines()[-1])

    whole = everything(tmp_path / "whole", -1)
    one, three = everything(tmp_path / "one", 4), found(3, "three", 4)
    assert len({str(told) for told, _ in whole}) == len(whole)  # they do exchange something
    assert one == three
    assert [len(kept) for _, kept in one] == [2, 4, 8]  # of the last two generations
    for count, folder in ((2, "one"), (5, "three")):
        for (told, result), (before, _), (after, same) in zip(
            whole, one, found(count, folder, -1), strict=True
        ):
            assert same == result
            assert before == told[:5]
            assert after == told[4:]


def test_three_ranks_make_the_same_run(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """13 scenarios do not divide evenly."""
    alone, usual = trained_run(tmp_path_factory).folder, to_plain(type(SMALL)())
    given = {name: value for name, value in to_plain(SMALL).items() if value != usual[name]}
    options = [f"--{name.replace('_', '-')}={value}" for name, value in given.items()]
    run = tmp_path / "run"
    words = ["--stage", "S0", "--quiet", "--run-dir", str(run), *options]
    printed = on_ranks(3, train, words, output=tmp_path / "printed.txt")
    assert printed.count("S0 on perimeter: ") == 1  # only one of them says so
    for name in ("start/gamma", "start/classifier", "S0/data", "S0/seen", "S0/specialists"):
        path = f"{name}.safetensors"
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    for path in ("S0/skill.json", "S0/scenarios.json"):
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    rows = (read_log(folder) for folder in (run, alone))
    every = [[row for row in each if row["stage"] in ("start", "S0")] for each in rows]
    times = ("time", "seconds", "search_seconds", "stages")
    one, other = ([{k: r[k] for k in r if k not in times} for r in each] for each in every)
    assert [row for row in one if row["event"] != "ended"] == other
    assert len(list(run.glob("events.*"))) == 1
