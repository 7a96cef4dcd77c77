"""Film a skill at work in physics, as an animated picture: docs/images/skill.webp.

    python tools/animate_skill.py [--run runs/reference] [--output docs/images/skill.webp]

The scenarios chosen are those in which the robot has to drive, each at another edge of the table.
"""

import os
from pathlib import Path

import click
import torch
from torch import Tensor

os.environ.setdefault("MUJOCO_GL", "egl")  # which MuJoCo reads when it is imported

from cgtorch.domains.film import animated
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.physics.film import film_of
from cgtorch.tabletop.viewer.execution import execute, scenario_of
from cgtorch.tabletop.world import Scenarios

ROOT = Path(__file__).resolve().parents[1]
TRIED = 60
"""The number of scenarios from which those that are shown are chosen."""
SHOWN = ("near", "left", "right")


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.option("--run", type=click.Path(path_type=Path), default=ROOT / "runs" / "reference")
@click.option(
    "--output", type=click.Path(path_type=Path), default=ROOT / "docs" / "images" / "skill.webp"
)
def command(run: Path, output: Path) -> None:
    """Write the picture."""
    torch.set_num_threads(1)
    opened, skill = last_skill(run)
    chosen: dict[str, Scenarios] = {}
    for number in range(TRIED):
        scenario = scenario_of("perimeter", TRIED, 0, number)
        done = execute(skill, opened.domain.world(scenario))
        drives = int((done.pose.diff(dim=0).abs().sum(1) > 0.01).sum())
        edge = edge_of(scenario.object[0] - scenario.table[0, :2], scenario.table[0, 3:5])
        if done.end == "success" and drives and edge not in chosen:
            chosen[edge] = scenario
    domain = opened.domain.in_world("mujoco")
    physics, world_in = domain.physics, domain.world_in
    films = [film_of(skill, physics, world_in, chosen[edge]) for edge in SHOWN if edge in chosen]
    output.write_bytes(animated(films, output.suffix[1:]))
    pictures = sum(len(film.frames) for film in films)
    click.echo(f"{output}: {pictures} pictures, {output.stat().st_size} bytes")


def edge_of(place: Tensor, size: Tensor) -> str:
    """The edge of a table of this size that is nearest to a place relative to its centre."""
    distance = (size / 2 - place.abs()).tolist()
    x, y = place.tolist()
    if distance[0] < distance[1]:
        return "near" if x < 0 else "far"
    return "left" if y > 0 else "right"


if __name__ == "__main__":
    command()
