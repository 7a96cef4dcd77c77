"""The time until a command answers, from the shell's prompt on."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.measure import Comparison, DisagreementError, Effort, Line, Timing, cores, timing

COMMAND = [sys.executable, "-m", "cgtorch.commands.train"]


def cold_start(effort: Effort) -> Line:
    """Seconds until the help appears, and until a run has evolved its first generation."""
    cases: dict[str, tuple[Callable[[], float], float]] = {
        "cgtorch-train --help": (_help, 1.0),
        "a run's first generation, tried in the world": (_first_generation, 10.0),
    }
    return Line(
        name="cold_start",
        compared="seconds after a command was given / the most that they should be",
        unit="of the most",
        target=1.0,
        clock="wall",
        threads=cores(),
        parts=tuple(_part(name, *case, effort.repeats) for name, case in cases.items()),
        at_most=True,
    )


def _part(label: str, measure: Callable[[], float], most: float, repeats: int) -> Comparison:
    measure()  # files that are read for the first time, and sources to be compiled
    ours = timing([measure() for _ in range(repeats)])
    return Comparison(
        label=label,
        ours=ours,
        other=Timing(most, most, most, 1),
        ratio=ours.median / most,
        difference=None,
        note=f"{ours.median:.3g} s",
    )


def _help() -> float:
    begin = time.perf_counter()
    subprocess.run([*COMMAND, "--help"], check=True, capture_output=True)
    return time.perf_counter() - begin


def _first_generation() -> float:
    """Data, labels, fits of Γ and C, all of the default sizes, and one generation of S0."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["--stage", "S0", "--generations", "1", "--run-dir", str(Path(folder) / "run")]
        begin = time.perf_counter()
        with subprocess.Popen(
            [*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as run:
            for line in run.stdout or ():
                if line.startswith("S0.1:"):
                    seconds = time.perf_counter() - begin
                    run.kill()
                    return seconds
    raise DisagreementError("a run ended without a first generation; nothing was timed")
