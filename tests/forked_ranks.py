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

PATIENCE = 300


def on_ranks(count: int, program: Callable[..., None], *arguments: Any, output: Path) -> str:
    """What so many ranks print, which all call a function that can be imported; kept in a file."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["torch.distributed", "cgtorch.commands.training"])
    with socket.socket() as one:
        one.bind(("localhost", 0))
        port = one.getsockname()[1]
    where = {"MASTER_ADDR": "localhost", "MASTER_PORT": port, "TORCHELASTIC_RUN_ID": "test"}
    sizes = {"WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count, "OMP_NUM_THREADS": 1}
    output.touch()
    ranks = []
    for i in range(count):
        environment = where | sizes | {"RANK": i, "LOCAL_RANK": i}
        given = environment, output, program, arguments
        ranks.append(context.Process(target=_rank, args=given))
    for rank in ranks:
        rank.start()
    for rank in ranks:
        rank.join(PATIENCE)
        rank.kill()
    text = output.read_text()
    assert [rank.exitcode for rank in ranks] == [0] * count, text
    return text


def _rank(
    environment: dict[str, Any], output: Path, program: Callable[..., None], arguments: Any
) -> None:
    """A rank, whose standard output and errors are added to a file."""
    import torch

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
