"""Ranks as `torchrun` starts them, forked from a process with torch, and what they do.

Loading it takes each process a second, and tests start dozens of ranks. `torchrun` itself starts
them in the tests of `tools/measure_ranks.py` and `tools/kill_rank.py`, and of restarts.
"""

import hashlib
import json
import multiprocessing
import os
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any
from unittest import mock

import click
import torch
from support import model, search, seeded, stochastic_actions

from cgtorch.evolution import EvolutionSettings
from cgtorch.ground import distributed as ranks
from cgtorch.ground.files import notes_of
from cgtorch.improvement.events import Event, GenerationDone
from cgtorch.improvement.setup import Budget
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.runs.journal import FileJournal

PATIENCE = 300
NEEDED = ("cgtorch.commands.training", "cgtorch.tabletop.domain", "torch.utils.tensorboard")
"""What a training imports."""
COUNTS = (1, 2, 4)
BUDGET = Budget(generations=9, patience=99)


def on_ranks(count: int, program: Callable[..., None], *arguments: Any, output: Path) -> str:
    """What so many ranks print, which all call a function that can be imported; kept in a file."""
    environment = _environment(count)
    started = [_begun(environment, i, output, program, arguments) for i in range(count)]
    text = _ended(started, output)
    assert [rank.exitcode for rank in started] == [0] * count, text
    return text


def as_first_rank(count: int, program: Callable[..., None], *arguments: Any, output: Path) -> None:
    """Call a function as the first of so many ranks, whose others print into a file."""
    environment = _environment(count)
    started = [_begun(environment, i, output, program, arguments) for i in range(1, count)]
    try:
        with mock.patch.dict(os.environ, _as_text(environment | {"RANK": 0, "LOCAL_RANK": 0})):
            program(*arguments)
    finally:
        text = _ended(started, output)
    assert [rank.exitcode for rank in started] == [0] * (count - 1), text


def _environment(count: int) -> dict[str, Any]:
    """What `torchrun` tells so many ranks."""
    with socket.socket() as one:
        one.bind(("localhost", 0))
        port = one.getsockname()[1]
    where = {"MASTER_ADDR": "localhost", "MASTER_PORT": port, "TORCHELASTIC_RUN_ID": "test"}
    return where | {"WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count, "OMP_NUM_THREADS": 1}


def _as_text(environment: dict[str, Any]) -> dict[str, str]:
    return {name: str(value) for name, value in environment.items()}


def _begun(
    environment: dict[str, Any], rank: int, output: Path, program: Callable[..., None],
    arguments: Any,
) -> BaseProcess:  # fmt: skip
    """A rank that has been started."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["forked_ranks", *NEEDED])
    output.touch()
    own = environment | {"RANK": rank, "LOCAL_RANK": rank}
    started = context.Process(target=_rank, args=(own, output, program, arguments))
    started.start()
    return started


def _ended(started: list[BaseProcess], output: Path) -> str:
    """What ranks have printed, after they have ended or lost patience."""
    for rank in started:
        rank.join(PATIENCE)
        rank.kill()
    return output.read_text()


def _rank(
    environment: dict[str, Any], output: Path, program: Callable[..., None], arguments: Any
) -> None:
    """A rank, whose standard output and errors are added to a file."""
    os.environ.update(_as_text(environment))
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


def gather(folder: Path) -> None:
    """Everything that ranks exchange; each of them makes a file in an empty folder."""
    with ranks.together():
        count = ranks.count()
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
            assert len(mine) == 1 or len(mine) <= -(-parts // count)
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
            assert ranks.all_reduce(1, group) == group.size
        assert ranks.all_reduce(3) == 3 * count
        assert ranks.broadcast(ranks.first())
        assert ranks.broadcast(torch.tensor([int(ranks.first())])).tolist() == [1]
        time.sleep(0 if ranks.first() else 0.1)
        (folder / f"{os.environ.get('RANK', 0)}.came").touch()
        ranks.wait()
        assert len(list(folder.glob("*.came"))) == count
        if ranks.first():
            click.echo(f"{count} gathered all")


def evolved(folder: Path, islands: int, stop: int) -> list[Any]:
    """Nine generations of 13 individuals an island, or those up to `stop`."""
    sizes = {"capacity": 10, "initial_nodes": (2, 8), "islands": islands, "migration": 2}
    settings = EvolutionSettings(13, **sizes)  # type: ignore[arg-type]
    generator, told = seeded(3), list[Any]()

    def watch(event: Event) -> None:
        if isinstance(event, GenerationDone):
            found = event.generation
            told.append([found.number, found.best, found.transitions, found.succeeded.tolist()])
            assert len(found.islands) == len(ranks.held(islands))
            if found.number == stop:
                raise KeyboardInterrupt

    with suppress(KeyboardInterrupt), FileJournal(folder, seconds=0) as journal:
        setup = search(stochastic_actions(), settings, BUDGET, journal)
        stage = replace(setup, name="S0", generator=generator, watch=watch)
        best = evolve_candidate(stage, "x", model(0, 7))
        champion, solved = best.champion, best.solved
        after = torch.rand(3, generator=generator)  # what follows an evolution draws from it, too
        found = [*vars(champion.graphs).values(), champion.strategy, solved, after]
        return [told, hashlib.sha256(b"".join(t.numpy().tobytes() for t in found)).hexdigest()]
    parts = sorted(folder.glob("*.*.safetensors")) if ranks.first() else []  # which wrote them
    return [told, [[p.name, notes_of(p.read_bytes())["sha256"]] for p in parts]]


def everything(folder: Path, stop: int) -> list[list[Any]]:
    """For each count of islands."""
    return [evolved(folder / str(islands), islands, stop) for islands in COUNTS]


def as_rank(folder: Path, stop: int) -> None:
    """The same with other ranks, of which the first prints it as JSON."""
    with ranks.together():
        result = everything(folder, stop)
        if ranks.first():
            click.echo(json.dumps(result))
