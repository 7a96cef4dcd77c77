"""Make runs/reference again: the small run that comes with the repository."""

import shutil
import subprocess
import sys
from pathlib import Path

import click

FOLDER = Path(__file__).resolve().parent.parent / "runs" / "reference"
KEPT = ("run.json", "log.jsonl", "robot", "by_rows", "S0", "S1", "S2", "S3")
"""The files that are kept, besides TensorBoard's: those for evaluation, and the last models."""


@click.command()
def main() -> None:
    """Train with seed 3 and keep the skills, the settings, the log and the TensorBoard files."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    train = [Path(sys.executable).parent / "cgtorch-train", "--stage", "S3", "--seed", "3"]
    subprocess.run([*train, "--run-dir", FOLDER], check=True)
    for path in FOLDER.iterdir():
        if path.name not in KEPT and not path.name.startswith("events.out"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    for path in FOLDER.glob("S?/*.safetensors"):
        if path.parent.name != "S3" or path.stem == "specialists":
            path.unlink()
    for path in FOLDER.rglob("events.out.*"):
        path.rename(path.with_name("events.out.tfevents.0.reference"))


if __name__ == "__main__":
    main()
