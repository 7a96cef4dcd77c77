"""Compare search methods on problems in the models of a finished run.

    python tools/compare_search.py RUN --out FOLDER [--seeds 0:10] [--problem NAME] [--only NAME]
                                   [--base NAME]

RUN is the folder of a run, of which start/ is read. Each trial is kept as one JSON file in FOLDER
and not repeated, so an interrupted comparison can continue, and tables are printed at once from
finished trials. The methods are those of `searches/variants.py`. p is that of Wilcoxon's
signed-rank test against the first method or another `--base`, seed by seed.
"""

from pathlib import Path

import click
import torch
from options.seeds import seeds_option
from searches.problems import PROBLEMS, pose
from searches.table import table
from searches.trial import tried
from searches.variants import VARIANTS

from cgtorch.ground.files import read_json, write_json

BASE = next(iter(VARIANTS))


def path_of(out: Path, problem: str, variant: str, seed: int) -> Path:
    """Where a trial is kept."""
    return out / problem / variant.replace(" ", "-") / f"{seed}.json"


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Where trials are kept."
)
@seeds_option("0:10")
@click.option("--problem", "problems", multiple=True, type=click.Choice(list(PROBLEMS)))
@click.option("--only", multiple=True, type=click.Choice(list(VARIANTS)))
@click.option("--base", type=click.Choice(list(VARIANTS)), default=BASE, show_default=True)
def main(
    run: Path, out: Path, seeds: range, problems: tuple[str, ...], only: tuple[str, ...], base: str
) -> None:
    """Make the trials that are missing, then print one table for each problem."""
    torch.set_num_threads(1)
    problems, variants = problems or tuple(PROBLEMS), only or tuple(VARIANTS)
    for seed in seeds:
        for problem in problems:
            for name in variants:
                path = path_of(out, problem, name, seed)
                if not path.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    models, actions = pose(PROBLEMS[problem], run, seed)
                    cap = PROBLEMS[problem].cap
                    found = tried(VARIANTS[name], models, actions, cap, seed)
                    write_json(path, found)
    for problem in problems:
        click.echo(f"\n{problem}\n\n{table(kept(out, problem), base)}")


def kept(out: Path, problem: str) -> dict[str, dict[int, dict[str, object]]]:
    """The trials of a problem by variant and seed, whoever made them."""
    found = {}
    for name in VARIANTS:
        files = path_of(out, problem, name, 0).parent.glob("*.json")
        found[name] = {int(file.stem): read_json(file) for file in sorted(files)}
    return found


if __name__ == "__main__":
    main()
