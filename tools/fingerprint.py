"""Make a small run and print one number of all that it came to, to compare machines by.

    python tools/fingerprint.py [--stage S0] [--seed 0]

Machines whose CPU has the same vector instructions, with the same version of torch, print the same
fingerprint: the same skills, W, M, ledgers and history of fitness, to the last bit.
"""

import hashlib
import json
import tempfile
from pathlib import Path

import click
import torch
from kill_and_resume import told, train


@click.command()
@click.option("--stage", default="S0", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the run.")
def command(stage: str, seed: int) -> None:
    """Make a small run and print a fingerprint of all that it came to."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(run, stage, seed)
        found = fingerprint(run)
    vectors = torch.backends.cpu.get_cpu_capability()
    click.echo(f"torch {torch.__version__}, {vectors}, {stage} of seed {seed}: {found}")


def fingerprint(run: Path) -> str:
    """16 hexadecimal digits of what a run came to."""
    told_json = json.dumps(told(run), sort_keys=True)
    return hashlib.sha256(told_json.encode()).hexdigest()[:16]


if __name__ == "__main__":
    command()
