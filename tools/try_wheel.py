"""Install a wheel into a fresh environment without a compiler, and train a skill there.

    python tools/try_wheel.py WHEEL

The environment has the versions of constraints.txt. It fails if anything is compiled, if the
library runs without compiled code, or if the wheel and what it needs beside torch take longer than
half a minute.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import click

ROOT = Path(__file__).parents[1]
MOST = 30.0
"""Seconds that the installation may take, without torch."""
ASKED = """
import shutil
from cgtorch.native import available, library
assert not any(map(shutil.which, ("cc", "gcc", "clang"))), "there is a compiler"
assert "site-packages" in library.__file__, library.__file__
assert available(), "there is no compiled code"
"""


@click.command()
@click.argument("wheel", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def command(wheel: Path) -> None:
    """Install WHEEL into a fresh environment without a compiler, and train a skill there."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        subprocess.run([sys.executable, "-m", "venv", str(place / "venv")], check=True)
        pip = ["pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
        pip += ["--constraint", str(ROOT / "constraints.txt")]
        seconds_of(place, "torch", [*pip, "torch"])
        taken = seconds_of(place, wheel.name, [*pip, str(wheel.resolve())])
        seconds_of(place, "compiled code", ["python", "-c", ASKED])
        seconds_of(place, "stage S0", ["cgtorch-train", "--stage", "S0", "--quiet"])
        if made := list((place / "cache").rglob("*.so")):
            raise click.ClickException(f"{made[0].name} was compiled; the wheel has to have it")
    if taken > MOST:
        raise click.ClickException(
            f"{wheel.name} took {taken:.0f} s to install, {MOST:.0f} at most"
        )


def seconds_of(place: Path, what: str, command: Sequence[str]) -> float:
    """Call a program of the environment in `place`, beside which no other program is found."""
    programs = place / "venv" / "bin"
    kept = {k: v for k, v in os.environ.items() if k not in ("CC", "PYTHONPATH")}
    own = {"PATH": str(programs), "XDG_CACHE_HOME": str(place / "cache")}
    begun = time.monotonic()
    subprocess.run(
        [str(programs / command[0]), *command[1:]], check=True, cwd=place, env=kept | own
    )
    taken = time.monotonic() - begun
    click.echo(f"{what}: {taken:.1f} s")
    return taken


if __name__ == "__main__":
    command()
