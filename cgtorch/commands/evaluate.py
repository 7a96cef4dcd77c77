"""`cgtorch-evaluate`: try a skill in the world on fresh scenarios."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cgtorch.commands.command import import_from_here, run_command

if TYPE_CHECKING:
    from cgtorch.experiments.evaluate import Score

EXAMPLES = """\b
Examples:
  cgtorch-evaluate runs/reference
  cgtorch-evaluate runs/seed-0/S2 --scenarios right --count 100 --seed 3
  cgtorch-evaluate runs/reference --scenarios general --picture scenes.png
  cgtorch-evaluate runs/auto --skill auto-1
  cgtorch-evaluate skill.json --count 1000 --json
"""


PICTURED = 24


@click.command("cgtorch-evaluate", epilog=EXAMPLES)
@click.argument("path", metavar="RUN_OR_SKILL", type=click.Path(path_type=Path))
@click.option(
    "--scenarios",
    default="perimeter",
    show_default=True,
    help="near, left, right, far or perimeter of the paper's table; general: any table, from any "
    "side; general-clutter: half of them with a box in the way.",
)
@click.option("--count", type=click.IntRange(1, 1_000_000), default=40, show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True)
@click.option("--skill", help="An earlier skill of the run, by its name in the run's ledger.")
@click.option("--actions", multiple=True, help="Further actions that the skill uses.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help=f"Also draw the first {PICTURED} scenes from above into this PNG file.",
)
@click.version_option(package_name="cgtorch")
def command(path: Path, scenarios: str, count: int, seed: int, as_json: bool, **rest: Any) -> None:
    """Try a skill in the world on fresh scenarios and print succeeded / tried.

    RUN_OR_SKILL is a run's folder, which stands for its last skill, a stage's folder in it, or a
    skill file, which is tried on the built-in PR2 with the default noise.
    """
    import torch

    from cgtorch.experiments.evaluate import evaluate_skill
    from cgtorch.experiments.ledger import read_entry
    from cgtorch.experiments.run import last_skill, lone_skill, open_run, tabletop_of
    from cgtorch.kinematics import load_robot
    from cgtorch.world import LAB_NOISE

    torch.set_num_threads(1)
    import_from_here(rest["actions"])
    if rest["skill"] is not None:
        run = open_run(path, rest["actions"])
        skill, world_of = read_entry(path, rest["skill"], run.actions).skill, run.world_of
    elif path.is_file():
        percept, skill = lone_skill(path, rest["actions"], scenarios)
        world_of = tabletop_of(load_robot(), LAB_NOISE, percept)
    else:
        run, skill = last_skill(path, rest["actions"])
        world_of = run.world_of
    score = evaluate_skill(skill, world_of, scenarios, count, seed)
    if rest["picture"]:
        _draw(rest["picture"], score, skill.name)
    low, high = score.interval
    if as_json:
        result = {
            "skill": skill.name,
            "scenarios": scenarios,
            "seed": seed,
            "tried": score.tried,
            "succeeded": score.successes,
            "rate": score.rate,
            "interval": [low, high],
        }
        click.echo(json.dumps(result))
        return
    click.echo(
        f"{skill.name} on {scenarios}: {score.successes} / {score.tried} succeeded, "
        f"{score.rate:.1%} (95 % confidence {low:.1%} to {high:.1%})"
    )


def _draw(path: Path, score: "Score", name: str) -> None:
    """Write the first scenes and whether they were reached as a PNG file."""
    import io

    from cgtorch.files import write_bytes
    from cgtorch.report import draw_scenes

    image = io.BytesIO()
    some = slice(0, PICTURED)
    draw_scenes(score.scenarios[some], score.succeeded[some], title=name).savefig(image)
    write_bytes(path, image.getvalue())


def main() -> None:
    """Entry point of `cgtorch-evaluate`."""
    run_command(command)
