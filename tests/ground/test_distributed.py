"""Several ranks come to what one does, to the last bit."""

import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click
import pytest
import torch
from forked_ranks import on_ranks, train
from islands_on_ranks import as_rank, everything
from torch._C._distributed_c10d import HashStore
from trained import SMALL, trained_run

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from measure_ranks import torchrun

from cgtorch.domains.settings import to_plain
from cgtorch.ground import distributed as ranks


def gather() -> None:
    """Everything that ranks exchange, on five of them."""
    with ranks.together():
        assert ranks.count() == 5
        for rows in range(13):
            for whole in (
                torch.arange(rows),
                torch.arange(rows * 3.0).view(rows, 3),
                torch.arange(rows) % 2 == 0,
            ):
                part = whole[ranks.share(rows)]
                assert torch.equal(ranks.all_gather(part, rows), whole)
                assert ranks.all_gather(part, rows).dtype == whole.dtype
        for parts in range(1, 12):
            mine, group = ranks.held(parts), ranks.group_of(parts)
            assert len(mine) == 1 or len(mine) <= -(-parts // 5)
            own = torch.arange(parts * 6.0).view(parts, 2, 3)
            every = ranks.all_gather_parts(own[mine.start : mine.stop], parts)
            assert torch.equal(every, own)
            before = [(part - 1) % parts for part in mine]
            for whole in (own, own > 9):
                found = ranks.ring_shift(whole[mine.start : mine.stop], parts)
                assert torch.equal(found, whole[before])
            rows = torch.arange(7) + 10 * mine.start
            part = rows[ranks.share(7, group)]
            assert torch.equal(ranks.all_gather(part, 7, group), rows)
            for i in range(parts):
                held = {"x": own[i if i in mine else mine.start], "y": torch.tensor([i in mine])}
                found = ranks.gather_part(held, i, parts)
                assert not ranks.first() or torch.equal(found["x"], own[i])
                assert not ranks.first() or bool(found["y"])
        assert ranks.broadcast(ranks.first())
        assert ranks.broadcast(torch.tensor([int(ranks.first())])).tolist() == [1]
        ranks.wait()
        if ranks.first():
            click.echo("all gathered")


RESTARTED = """
import os, signal, sys
import torch
from cgtorch.ground import distributed as ranks

with ranks.together():
    if int(os.environ["TORCHELASTIC_RESTART_COUNT"]) < 2:
        ranks.wait()
        if ranks.first():
            os.kill(os.getpid(), signal.SIGKILL)
        ranks.wait()
    ranks.wait()  # one that ends while others still connect would break their connection
    if ranks.first():
        print("met again")
"""


def test_ranks_that_were_started_again_meet(tmp_path: Path) -> None:
    script = tmp_path / "restarted.py"
    script.write_text(RESTARTED)
    assert "met again" in torchrun(3, ["--max-restarts=2", str(script)])


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


def test_alone_everything_is_ones_own() -> None:
    rows = torch.arange(7)
    with ranks.together():
        assert ranks.count() == 1
        assert ranks.first()
        assert ranks.share(7) == slice(0, 7)
        assert ranks.all_gather(rows, 7) is rows
        assert ranks.broadcast(True)
        assert not ranks.broadcast(False)
        assert ranks.held(3) == range(3)
        assert torch.equal(ranks.all_gather_parts(rows, 7), rows)
        assert torch.equal(ranks.ring_shift(rows, 7), rows.roll(1))
        assert ranks.gather_part({"x": rows}, 6, 7)["x"] is rows
        ranks.wait()


def test_uneven_parts_are_gathered_in_order(tmp_path: Path) -> None:
    assert "all gathered" in on_ranks(5, gather, output=tmp_path / "printed.txt")


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
    assert [len(kept) for _, kept in one] == [2, 4, 6, 8]  # of the last two generations
    for count, folder in ((2, "one"), (5, "three")):
        for (told, result), (before, _), (after, same) in zip(
            whole, one, found(count, folder, -1), strict=True
        ):
            assert same == result
            assert before == told[:5]
            assert after == told[4:]


@pytest.fixture(scope="session")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained_run(tmp_path_factory.getbasetemp()).folder


@pytest.mark.parametrize("count", [2, 3])
def test_any_number_of_ranks_makes_the_same_run(count: int, alone: Path, tmp_path: Path) -> None:
    """60 individuals and 13 scenarios do not divide evenly by all of these."""
    given = {k: v for k, v in to_plain(SMALL).items() if v != getattr(type(SMALL), k, None)}
    options = [
        part
        for name, value in given.items()
        if name != "actions"
        for part in (f"--{name.replace('_', '-')}", str(value))
    ]
    run = tmp_path / "run"
    words = ["--stage", "S0", "--quiet", "--run-dir", str(run), *options]
    printed = on_ranks(count, train, words, output=tmp_path / "printed.txt")
    assert printed.count("S0     perimeter") == 1  # only one of them says so
    for name in ("start/gamma", "start/classifier", "S0/data", "S0/specialists"):
        path = f"{name}.safetensors"
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    for path in ("S0/skill.json", "S0/scenarios.json", "ledger/S0.json"):
        assert (run / path).read_bytes() == (alone / path).read_bytes(), path
    assert len(list(run.glob("events.*"))) == 1
