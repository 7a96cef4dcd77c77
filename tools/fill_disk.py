"""Let a training run out of disk space at random moments, and go on with it once there is some.

    mount -t tmpfs -o size=64m tmpfs /mnt/small
    python tools/fill_disk.py /mnt/small [--times 20] [--stage S0] [--seed 0] [--options "..."]

A small run is made elsewhere without a disturbance. Then, again and again, it is made on the small
file system, where all but a random part of what it needs is taken. It must end with exit code 2 and
one line, and once there is space again, the same command must end as the run left alone, in all
that `kill_and_resume.results_of` compares.
"""

import os
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from kill_and_resume import SMALL, results_of

SMALLEST, LARGEST = 16 * 2**20, 2**30  # bytes of a file system that is filled


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--times", default=20, show_default=True, help="How often to run out of space.")
@click.option("--stage", default="S0", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the runs and of the spaces.")
@click.option("--options", default=" ".join(SMALL), help="Of the runs.  [a small one]")
def command(folder: Path, times: int, stage: str, seed: int, options: str) -> None:
    """Let a training run out of disk space at random moments, and go on with it."""
    if not SMALLEST <= (size := capacity(folder)) <= LARGEST:
        raise click.ClickException(
            f"{folder} is on a file system of {size / 2**20:.0f} MiB; give one of "
            f"{SMALLEST / 2**20:.0f} to {LARGEST / 2**20:.0f} MiB that may be filled"
        )
    draw, run = random.Random(seed), folder / "run"  # noqa: S311  of spaces, not of secrets
    words = ["--stage", stage, "--seed", str(seed), *shlex.split(options)]
    with tempfile.TemporaryDirectory() as elsewhere:
        complete(alone := Path(elsewhere) / "alone", words)
        wanted, needed = results_of(alone), used(alone)
    done = 0
    while done < times:
        shutil.rmtree(run, ignore_errors=True)
        space = draw.randrange(needed)
        with ballast(folder, space):
            code, lines = trained(run, words)
        if code == 0:  # it had space enough
            continue
        if code != 2 or len(lines) != 1:
            raise click.ClickException(f"with {space} bytes: exit code {code}, {lines[-8:]}")
        if left := [str(p) for p in run.rglob(".*.tmp")]:
            raise click.ClickException(f"with {space} bytes it leaves {left[0]}")
        complete(run, words)
        if (found := results_of(run)) != wanted:
            odd = sorted(k for k in {*wanted, *found} if wanted.get(k) != found.get(k))
            raise click.ClickException(f"with {space} bytes {run} differs in {', '.join(odd)}")
        done += 1
        click.echo(f"{done} of {times}: {space / 1024:.0f} KiB; {lines[0]}; then the same")


def capacity(folder: Path) -> int:
    """Bytes of a file system."""
    about = os.statvfs(folder)
    return about.f_blocks * about.f_frsize


def used(folder: Path) -> int:
    """Bytes that the files of a folder take, in whole blocks."""
    return sum(p.stat().st_blocks * 512 for p in folder.rglob("*") if p.is_file())


@contextmanager
def ballast(folder: Path, space: int) -> Iterator[None]:
    """While it is there, only so many bytes of the file system are free."""
    about, path = os.statvfs(folder), folder / "ballast"
    try:
        with path.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, max(1, about.f_bavail * about.f_frsize - space))
        yield
    finally:
        path.unlink(missing_ok=True)


def trained(run: Path, words: list[str]) -> tuple[int, list[str]]:
    """A training's exit code, and the lines that it wrote to stderr."""
    program = str(Path(sys.executable).with_name("cgtorch-train"))
    command = [program, "--run-dir", str(run), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    return done.returncode, done.stderr.strip().splitlines()


def complete(run: Path, words: list[str]) -> None:
    """Begin a training or go on with it, and have it end well."""
    code, lines = trained(run, words)
    if code:
        raise click.ClickException(f"training {run} ended with exit code {code}: {lines[-8:]}")


if __name__ == "__main__":
    command()
