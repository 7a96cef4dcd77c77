"""Make a small run and print one number for its results, to compare machines and ranks.

    python tools/fingerprint.py [--stage S0] [--seed 0] [--ranks 1 --ranks 2 ...] [--note]

Machines of one kind, that is, with the same CPU, compiler, C library and version of torch, print
the same fingerprint with any number of ranks: the same skills, W, M, models and log, bit for bit.
The population of 61 is divisible by no number of ranks.

`tools/fingerprints.json` contains the known fingerprint of each kind of machine. If it has another
one for this kind, or numbers of ranks differ, the exit code is 1. `--note` adds a new kind.
"""

import hashlib
import json
import platform
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import click
import torch
from kill_and_resume import SMALL, results_of
from measure_ranks import torchrun

from cgtorch import native
from cgtorch.ground.files import write_json

KNOWN = Path(__file__).parent / "fingerprints.json"


@click.command()
@click.option("--stage", default="S0", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the run.")
@click.option("--ranks", "counts", multiple=True, default=(1,), help="Ranks; may be repeated.")
@click.option("--note", is_flag=True, help="Write the fingerprint down as this kind's.")
def command(stage: str, seed: int, counts: Sequence[int], note: bool) -> None:
    """Make a small run, print a fingerprint of its results, and compare it."""
    name = f"{stage} of seed {seed} on {kind_of_machine()}"
    known = json.loads(KNOWN.read_text())
    found = set()
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            train(run, stage, seed, count)
            found.add(fingerprint(run))
        click.echo(f"{name}, ranks {count}: {fingerprint_of(found)}")
    if note:
        write_json(KNOWN, {**known, name: fingerprint_of(found)})
    elif name not in known:
        click.echo("no machine of this kind has been here before; --note writes it down")
    elif {known[name]} == found:
        click.echo("the same as on another machine of this kind")
    else:
        raise SystemExit(f"another machine of this kind has {known[name]}")


def fingerprint_of(found: set[str]) -> str:
    """The only fingerprint; a ClickException if numbers of ranks gave different ones."""
    if len(found) > 1:
        raise SystemExit(f"the ranks differ: {', '.join(sorted(found))}")
    return next(iter(found))


def kind_of_machine() -> str:
    """Everything on which the last digits of this machine's numbers depend."""
    cpu = {}
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        name, _, value = line.partition(":")
        cpu.setdefault(name.strip(), value.strip())
    parts = [
        " ".join(cpu.get(name, "?") for name in ("vendor_id", "cpu family", "model")),
        torch.backends.cpu.get_cpu_capability(),
        " ".join(platform.libc_ver()),
        f"torch {torch.__version__}",
        _compiler() if native.available() else "no compiler",
    ]
    return ", ".join(parts)


def _compiler() -> str:
    said = subprocess.run(["cc", "--version"], check=True, capture_output=True, text=True)  # noqa: S607
    return said.stdout.splitlines()[0]


def train(run: Path, stage: str, seed: int, ranks: int) -> None:
    """Make a small run with so many ranks."""
    about = ["--stage", stage, "--seed", str(seed), "--run-dir", str(run)]
    torchrun(ranks, ["-m", "cgtorch.commands.train", *about, *SMALL, "--population", "61"])


def fingerprint(run: Path) -> str:
    """16 hexadecimal digits of the results of a run."""
    results = json.dumps(results_of(run), sort_keys=True)
    return hashlib.sha256(results.encode()).hexdigest()[:16]


if __name__ == "__main__":
    command()
