"""Make a small run and print one number of all that it came to, to compare machines and ranks by.

    python tools/fingerprint.py [--stage S0] [--seed 0] [--ranks 1 --ranks 2 ...]

Machines whose CPU has the same vector instructions, with the same version of torch, print the same
fingerprint with any number of ranks: the same skills, W, M, ledgers and history of fitness, to the
last bit. The population, 61, divides by none.
"""

import hashlib
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import click
import torch
from kill_and_resume import SMALL, told
from measure_ranks import torchrun


@click.command()
@click.option("--stage", default="S0", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the run.")
@click.option("--ranks", "counts", multiple=True, default=(1,), help="Ranks; may be repeated.")
def command(stage: str, seed: int, counts: Sequence[int]) -> None:
    """Make a small run and print a fingerprint of all that it came to."""
    vectors = torch.backends.cpu.get_cpu_capability()
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            train(run, stage, seed, count)
            found = fingerprint(run)
        about = f"torch {torch.__version__}, {vectors}, {stage} of seed {seed}, ranks {count}"
        click.echo(f"{about}: {found}")


def train(run: Path, stage: str, seed: int, ranks: int) -> None:
    """Make a small run with so many ranks."""
    about = ["--stage", stage, "--seed", str(seed), "--run-dir", str(run)]
    torchrun(ranks, ["-m", "cgtorch.commands.train", *about, *SMALL, "--population", "61"])


def fingerprint(run: Path) -> str:
    """16 hexadecimal digits of what a run came to."""
    told_json = json.dumps(told(run), sort_keys=True)
    return hashlib.sha256(told_json.encode()).hexdigest()[:16]


if __name__ == "__main__":
    command()
