"""Ranks as `torchrun` starts them, forked from a process that has loaded torch already.

Loading it takes each process a second, and tests start dozens of ranks. `torchrun` itself starts
them in the tests of `tools/measure_ranks.py` and `tools/kill_rank.py`, and of restarts.
"""

import multiprocessing
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import torch

from cgtorch.ground import distributed as ranks

PATIENCE = 300
NEEDED = ("cgtorch.commands.training", "cgtorch.tabletop.domain", "torch.utils.tensorboard")
"""What a training imports."""


def on_ranks(count: int, program: Callable[..., None], *arguments: Any, output: Path) -> str:
    """What so many ranks print, which all call a function that can be imported; kept in a file."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["forked_ranks", "islands_on_ranks", *NEEDED])
    with socket.socket() as one:
        one.bind(("localhost", 0))
        port = one.getsockname()[1]
    where = {"MASTER_ADDR": "localhost", "MASTER_PORT": port, "TORCHELASTIC_RUN_ID": "test"}
    sizes = {"WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count, "OMP_NUM_THREADS": 1}
    output.touch()
    started = []
    for i in range(count):
        environment = where | sizes | {"RANK": i, "LOCAL_RANK": i}
        given = environment, output, program, arguments
        started.append(context.Process(target=_rank, args=given))
    for rank in started:
        rank.start()
    for rank in started:
        rank.join(PATIENCE)
        rank.kill()
    text = output.read_text()
    assert [rank.exitcode for rank in started] == [0] * count, text
    return text


def _rank(
    environment: dict[str, Any], output: Path, program: Callable[..., None], arguments: Any
) -> None:
    """A rank, whose standard output and errors are added to a file."""
    os.environ.update({name: str(value) for name, value in environment.items()})
    torch.set_num_threads(1)
    file = os.open(output, os.O_WRONLY | os.O_APPEND)
    os.dup2(file, 1)
    os.dup2(file, 2)
    program(*arguments)
    sys.stdout.flush()


def train(words: list[str]) -> None:
    """`cgtorch-train` with these words."""
    from cgtorch.commands.train import command

    command.main(words, standalone_mode=False)


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
                found = ranks.part_of_holder(own[i] if i in mine else None, i, parts)
                assert found is not None
                assert torch.equal(found, own[i])
        assert ranks.broadcast(ranks.first())
        assert ranks.broadcast(torch.tensor([int(ranks.first())])).tolist() == [1]
        ranks.wait()
        if ranks.first():
            click.echo("all gathered")
