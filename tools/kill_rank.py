"""Kill one of several ranks at a random moment, and compare the result with that of one process.

    python tools/kill_rank.py FOLDER [--kills 10] [--ranks 2] [--stage S1] [--seed 0]

A small run is made once by one process. Then it is made again and again under `torchrun`, which
restarts all ranks after one of them was killed (`kill -9`). The results must be equal, as in
`tools/kill_and_resume.py`.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
from kill_and_resume import SIZES, SMALL, check_same, results_of, train

PATIENCE = 20.0  # times what one process takes


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--kills", default=10, show_default=True, help="Kills to survive.")
@click.option("--ranks", default=2, show_default=True, help="How many ranks there are.")
@click.option("--stage", default="S1", show_default=True, help="Stage to train up to.")
@click.option("--seed", default=0, show_default=True, help="Of the runs and of the moments.")
def command(folder: Path, kills: int, ranks: int, stage: str, seed: int) -> None:
    """Kill one of several ranks at a random moment and compare with one process."""
    draw = random.Random(seed)  # noqa: S311  of moments, not of secrets
    shutil.rmtree(folder / "alone", ignore_errors=True)
    began = time.monotonic()
    train(folder / "alone", ["--stage", stage, "--seed", str(seed), *SIZES["kinematic"]])
    usual = time.monotonic() - began
    wanted, survived = results_of(folder / "alone"), 0
    while survived < kills:
        run = folder / f"killed-{survived}"
        shutil.rmtree(run, ignore_errors=True)
        moment, victim = draw.uniform(0, usual), draw.randrange(ranks)
        seconds = killed(run, stage, seed, ranks, moment, victim, PATIENCE * usual)
        if seconds is None:
            click.echo(f"{run}: ended before {moment:.1f} s, once more")
            continue
        check_same(run, wanted)
        survived += 1
        when = f"rank {victim} killed after {moment:.1f} s, ended {seconds:.1f} s later"
        click.echo(f"{run}: {when}, the same; {survived} of {kills}")


def killed(
    run: Path, stage: str, seed: int, ranks: int, moment: float, victim: int, patience: float
) -> float | None:
    """Seconds that a run under torchrun went on for after a rank was killed.

    Args:
        run: folder of the run.
        stage: to train up to.
        seed: of the run.
        ranks: how many there are.
        moment: seconds after the beginning at which one is killed.
        victim: which one.
        patience: seconds to wait for the end.

    Returns:
        None if it had ended before.

    Raises:
        click.ClickException: it did not end, or not well.
    """
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--max-restarts=3"]
    about = ["--stage", stage, "--seed", str(seed), "--run-dir", str(run), *SMALL]
    about += SIZES["kinematic"]
    process = subprocess.Popen(
        [*torchrun, f"--nproc-per-node={ranks}", "-m", "cgtorch.commands.train", *about],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        time.sleep(moment)
        children = wait_for_children(process, ranks)
        if process.poll() is not None:
            return None
        os.kill(children[victim], signal.SIGKILL)
        began = time.monotonic()
        code = process.wait(patience)
    except subprocess.TimeoutExpired as e:
        raise click.ClickException(f"{run} did not end within {patience:.0f} s") from e
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    if code:
        raise click.ClickException(f"training {run} ended with exit code {code}")
    return time.monotonic() - began


def wait_for_children(process: subprocess.Popen[bytes], count: int) -> list[int]:
    """The processes another one has started, as soon as they are so many or it has ended."""
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None:
        children = [int(word) for word in listed.read_text().split()]
        if len(children) >= count:
            return children
        time.sleep(0.05)
    return []


if __name__ == "__main__":
    command()
