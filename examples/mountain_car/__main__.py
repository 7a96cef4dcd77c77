"""`python -m examples.mountain_car train` and `test`: make a skill, and try it in Gymnasium."""

from pathlib import Path

import click
import torch

from cgtorch.commands.command import run_command
from cgtorch.errors import CgtorchError
from cgtorch.files import write_json
from cgtorch.graphs import load_skill, save_skill
from cgtorch.report.progress import ProgressDisplay
from examples.mountain_car.actions import car_actions
from examples.mountain_car.models import save_models
from examples.mountain_car.train import STAGES, train, tried
from examples.mountain_car.world import SOLVED, draw_starts

TRAINED = Path(__file__).parent / "trained"
FRESH_SEED = 5_000_001  # far from seeds that one would train with
GOAL = 0.99


class NotReachedError(CgtorchError, RuntimeError):
    """Too few fresh starts are solved."""


@click.group("mountain-car")
def group() -> None:
    """Gymnasium's MountainCarContinuous-v0 with evolved skills."""
    torch.set_num_threads(1)


@group.command("train")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True)
@click.option("--count", type=click.IntRange(1), default=1000, show_default=True)
@click.option("--quiet", is_flag=True, help="Print the result only.")
def train_command(folder: Path, seed: int, count: int, quiet: bool) -> None:
    """Train a skill, keep it in FOLDER and try it on fresh starts."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProgressDisplay(quiet=quiet) as display:
        progress = train(seed, display, display.working)
    if progress.skill is None:
        raise NotReachedError("no skill was accepted; try another --seed")
    save_skill(folder / "skill.json", progress.skill)
    save_models(folder, progress.knowledge)
    result = _try(folder, count)
    write_json(folder / "result.json", result)
    _check(result)


@group.command("test")
@click.argument("folder", type=click.Path(path_type=Path), default=TRAINED)
@click.option("--count", type=click.IntRange(1), default=1000, show_default=True)
def test_command(folder: Path, count: int) -> None:
    """Try the skill in FOLDER on fresh starts; that of the repository if not given."""
    _check(_try(folder, count))


def _try(folder: Path, count: int) -> dict[str, dict[str, float]]:
    """What the skill of a folder does on fresh starts of each stage, printed as well."""
    skill = load_skill(folder / "skill.json", car_actions())
    result = {}
    for name, between in STAGES.items():
        generator = torch.Generator().manual_seed(FRESH_SEED)
        succeeded, points = tried(skill, draw_starts(count, generator, between))
        result[name] = {
            "tried": count,
            "succeeded": int(succeeded.sum()),
            "mean_points": round(float(points.mean()), 2),
            "least_points": round(float(points.min()), 2),
        }
        click.echo(
            f"{name}: {int(succeeded.sum())} of {count} fresh starts solved, mean "
            f"{points.mean():.2f} points, worst {points.min():.2f}; solved is {SOLVED:.0f}"
        )
    return result


def _check(result: dict[str, dict[str, float]]) -> None:
    """The command has failed unless nearly all starts were solved."""
    if any(one["succeeded"] < GOAL * one["tried"] for one in result.values()):
        raise NotReachedError(f"fewer than {GOAL:.0%} of the starts are solved; try another --seed")


if __name__ == "__main__":
    run_command(group)
