"""Give the library's loaders hostile files, and count what they make of them.

    python tools/fuzz.py [--count 100000] [--seed 0] [--only FORMAT] [--first 0] [--keep FOLDER]

Real files are damaged: bytes, JSON values, tensors and headers of safetensors, elements of XML. A
loader may accept a file or raise a `CgtorchError` of one printable line. All else is a failure:
another error, a crash, ten seconds without an answer, more than 512 MiB of memory, a file written
elsewhere, a program started, anything unpickled. Every failure is kept with the command that
repeats it, and makes the exit code 1.
"""

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
from hostile.formats import FORMATS

PATIENCE, START = 10.0, 300.0  # s for an answer, and for a worker to be ready
LEAST = 1000  # inputs of a format
SHOWN, KEPT = 5, 20  # failures of a format


@dataclass
class Tally:
    """What became of the inputs of one format.

    Attributes:
        accepted: loaded.
        refused: ended in a `CgtorchError`.
        failed: number of the input and what happened, for all others.
        grown: most memory beyond what an idle worker has, KiB.
    """

    accepted: int = 0
    refused: int = 0
    failed: list[tuple[int, str]] = field(default_factory=list)
    grown: int = 0

    @property
    def inputs(self) -> int:
        """All of them."""
        return self.accepted + self.refused + len(self.failed)


@click.command()
@click.option("--count", default=100_000, show_default=True, help="Inputs of all formats.")
@click.option("--seed", default=0, show_default=True, help="Of the inputs.")
@click.option("--only", type=click.Choice(list(FORMATS)), help="This format alone.")
@click.option("--first", default=0, show_default=True, help="Number of the first input.")
@click.option(
    "--keep", type=click.Path(path_type=Path), help="Where failures go.  [a temporary folder]"
)
def command(count: int, seed: int, only: str | None, first: int, keep: Path | None) -> None:
    """Give the library's loaders hostile files, and count what they make of them."""
    keep = keep or Path(tempfile.mkdtemp(prefix="fuzz-"))
    tallies = {}
    for name, inputs in ({only: count} if only else shares(count)).items():
        tallies[name] = tally = fuzzed(name, seed, first, first + inputs, keep)
        click.echo(line(name, tally) if len(tallies) > 1 else f"{HEAD}\n{line(name, tally)}")
        for number, what in tally.failed[:SHOWN]:
            again = f"--only '{name}' --seed {seed} --first {number} --count 1"
            click.echo(f"  {what}\n    again: python tools/fuzz.py {again}")
    if len(tallies) > 1:
        everything = Tally(
            sum(t.accepted for t in tallies.values()),
            sum(t.refused for t in tallies.values()),
            [f for t in tallies.values() for f in t.failed],
            max(t.grown for t in tallies.values()),
        )
        click.echo(line("all", everything))
    if any(t.failed for t in tallies.values()):
        raise click.ClickException(f"there are failures; the files are in {keep}")


def shares(count: int) -> dict[str, int]:
    """Inputs of each format, `LEAST` at least where there are that many."""
    whole = sum(kind.share for kind in FORMATS.values())
    least = min(LEAST, count // len(FORMATS))
    return {name: max(least, round(count * f.share / whole)) for name, f in FORMATS.items()}


HEAD = f"{'format':14}{'inputs':>9}{'accepted':>10}{'refused':>9}{'failures':>10}{'memory MiB':>12}"


def line(name: str, tally: Tally) -> str:
    """A format's line of the table."""
    counts = f"{tally.inputs:9,}{tally.accepted:10,}{tally.refused:9,}{len(tally.failed):10,}"
    return f"{name:14}{counts}{tally.grown / 1024:12.0f}"


def fuzzed(name: str, seed: int, first: int, end: int, keep: Path) -> Tally:
    """What becomes of the inputs from `first` up to `end`; a lost worker is replaced."""
    tally, at = Tally(), first
    while at < end:
        with tempfile.TemporaryDirectory(prefix="fuzz-work-") as work:
            at = _work(name, seed, at, end, Path(work), tally, keep)
    return tally


def _work(name: str, seed: int, first: int, end: int, work: Path, tally: Tally, keep: Path) -> int:
    """Have one worker read inputs until all are done or it is lost; the next input's number."""
    paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    words = [name, str(seed), str(first), str(end), str(work)]
    at, errors = first, work / "errors"
    with errors.open("wb") as log:
        worker = subprocess.Popen(
            [sys.executable, "-m", "hostile.worker", *words],
            stdout=subprocess.PIPE, stderr=log, cwd=work,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(work)},
        )  # fmt: skip

    def fail(number: int, what: str) -> None:
        tally.failed.append((number, what))
        if len(tally.failed) <= KEPT:
            keep.mkdir(parents=True, exist_ok=True)
            source = work / "run" / FORMATS[name].file
            shutil.copy(source, keep / f"{name.replace(' ', '-')}-{seed}-{number}")

    try:
        for number, verdict, text, grown in _answers(worker):
            at, tally.grown = number + 1, max(tally.grown, grown)
            if verdict == "failed":
                fail(number, text)
            else:
                setattr(tally, verdict, getattr(tally, verdict) + 1)
        if at < end:
            code, last = worker.poll(), errors.read_text(errors="replace").strip()[-200:]
            how = f"no answer in {PATIENCE:.0f} s" if code is None else f"exit code {code}: {last}"
            fail(at, how)
            at += 1
    finally:
        worker.kill()
        worker.wait()
    return at


def _answers(worker: "subprocess.Popen[bytes]") -> Iterator[Any]:
    """The worker's lines, until there are no more or none comes in time."""
    assert worker.stdout is not None  # noqa: S101  it is a pipe
    pipe, rest, ready = worker.stdout.fileno(), b"", False
    while select.select([pipe], [], [], PATIENCE if ready else START)[0]:
        if not (more := os.read(pipe, 2**16)):
            worker.wait()
            if not ready:
                raise click.ClickException("the worker did not become ready")
            return
        *lines, rest = (rest + more).split(b"\n")
        if not ready:
            ready = bool(lines) and lines.pop(0) == b"ready"
        yield from map(json.loads, lines)


if __name__ == "__main__":
    command()
