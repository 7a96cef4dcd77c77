"""Change single lines of the package, and count how many changes the closest tests notice.

    python tools/mutate.py [--room NAME] [--count 40] [--seed 1] [--output FILE]

Each mutant changes one random line in a copy of the repository: a comparison, an operator, a
condition, a constant, an argument, or a statement that is deleted; in C as well. The closest tests
(tools/mutants/closest.py) run until one fails, or takes four times as long as usual. A mutant that
no test can notice belongs in `tools/mutants/equivalent.json`, with a line that says why; the score
leaves it out.
"""

import functools
import json
import os
import signal
import sys
import tempfile
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # threads do not survive a fork

import click
from mutants.closest import Recorded, closest
from mutants.drawn import Mutant, drawn, rooms
from mutants.recording import make_once, recorded
from mutants.trials import SAME, Trial, tried
from mutants.workshop import Workshop

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = Path("tools", "mutants", "equivalent.json")
HEAD = f"{'room':14}{'mutants':>8}{'killed':>8}{'equivalent':>12}{'score':>8}"


@dataclass
class Tally:
    """The trials of a room, and how many equivalent mutants were drawn."""

    room: str
    seed: int
    trials: list[Trial] = field(default_factory=list)
    equivalent: int = 0

    @property
    def survivors(self) -> list[Trial]:
        """Those that no test noticed."""
        return [trial for trial in self.trials if not trial.killed]

    def line(self) -> str:
        """The room's line of the table."""
        count = len(self.trials)
        killed = count - len(self.survivors)
        score = f"{100 * killed / count:.0f} %" if count else "–"
        return f"{self.room:14}{count:8}{killed:8}{self.equivalent:12}{score:>8}"


@click.command()
@click.option(
    "--room", "chosen", multiple=True, type=click.Choice(rooms(ROOT / "cgtorch")),
    help="A folder of the package; can be repeated.  [all]",
)  # fmt: skip
@click.option("--count", default=40, show_default=True, help="Lines of a room.")
@click.option("--seed", default=1, show_default=True, help="Of the lines and changes.")
@click.option("--seconds", default=30.0, show_default=True, help="Usual time of a mutant's tests.")
@click.option("--output", type=click.Path(path_type=Path), help="Where results go as JSON.")
def command(
    chosen: tuple[str, ...], count: int, seed: int, seconds: float, output: Path | None
) -> None:
    """Change single lines of the package, and count how many changes the closest tests notice."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cgtorch-mutants"
    known = excused(ROOT / EQUIVALENT)
    tallies = []
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and remove the copy
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        make_once(shop := Workshop(ROOT, Path(folder)))
        for room in chosen or rooms(ROOT / "cgtorch"):
            tallies.append(tally := Tally(room, seed))
            tried_in(shop, tally, count, seconds, known, cache)
            if output:
                output.write_text(json.dumps([asdict(each) for each in tallies], indent=1))
    click.echo("\n".join([HEAD, *(tally.line() for tally in tallies)]))


def excused(path: Path) -> set[tuple[str, str, str]]:
    """File, old and new text of the mutants that are known to be equivalent."""
    return {(each["file"], each["old"], each["new"]) for each in json.loads(path.read_text())}


def tried_in(
    shop: Workshop, tally: Tally, count: int, seconds: float, known: set[tuple[str, str, str]],
    cache: Path,
) -> None:  # fmt: skip
    """Try `count` mutants of a room that compile and are not known to be equivalent."""
    recordings = functools.cache(partial(recorded, shop, cache=cache))
    for mutant in drawn(shop.root, tally.room, tally.seed):
        if len(tally.trials) == count:
            return
        if (mutant.file, mutant.old, mutant.new) in known:
            tally.equivalent += 1
            continue
        trial = trial_of(shop, mutant, seconds, recordings)
        tally.equivalent += trial.by == SAME
        if trial.killed is not None:
            tally.trials.append(trial)
            told(tally, trial)


def trial_of(shop: Workshop, mutant: Mutant, seconds: float, recordings: Recorded) -> Trial:
    """A trial with the closest tests; without any, the mutant survives."""
    tests = closest(shop.root, mutant.file, mutant.line, recordings, seconds)
    return tried(shop, mutant, tests) if tests else Trial(mutant, False, "no test", 0)


def told(tally: Tally, trial: Trial) -> None:
    """A line of progress, and the change if it survives."""
    what = "killed by" if trial.killed else f"SURVIVED {trial.tests} tests, last"
    where = f"{trial.mutant.file}:{trial.mutant.line}"
    click.echo(f"{tally.room} {len(tally.trials)}: {where}: {what} {trial.by or 'an import'}")
    if not trial.killed:
        click.echo(f"    {trial.mutant.old}\n  → {trial.mutant.new}")


if __name__ == "__main__":
    command()
