"""Draw a skill at work as an animated picture, seen from above: docs/images/skill.gif.

    python tools/animate_skill.py [--run runs/reference] [--output docs/images/skill.gif]

Each scenario is one execution in the world with its noise, the same that `cgtorch-evaluate` counts.
The scenarios chosen are those in which the robot has to drive, each at another edge of the table.
"""

import io
from pathlib import Path
from typing import Any

import click
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image
from torch import Tensor

from cgtorch.runs.skills import last_skill
from cgtorch.tabletop.viewer.choice import scenario_of
from cgtorch.tabletop.viewer.execution import Execution, execute
from cgtorch.tabletop.world.geometry import rotate

ROOT = Path(__file__).resolve().parents[1]
TRIED, SHOWN, BETWEEN, REST = 60, 4, 8, 6
"""Scenarios tried and shown, pictures of a motion, and of a rest after each action."""
TABLE, RIM, ROBOT, WAITING, REACHED = "#f1e7d6", "#a58f6b", "#4a6fa5", "#1c1f24", "#1a7f37"


@click.command(help=__doc__.split("\n")[0] if __doc__ else None)
@click.option("--run", type=click.Path(path_type=Path), default=ROOT / "runs" / "reference")
@click.option(
    "--output", type=click.Path(path_type=Path), default=ROOT / "docs" / "images" / "skill.gif"
)
def command(run: Path, output: Path) -> None:
    """Write the picture."""
    torch.set_num_threads(1)
    opened, skill = last_skill(run)
    executions: dict[str, Execution] = {}
    for number in range(TRIED):
        scenario = scenario_of("perimeter", TRIED, 0, number)
        done = execute(skill, opened.domain.world(scenario))
        drives = int((done.pose.diff(dim=0).abs().sum(1) > 0.01).sum())
        edge = edge_of(scenario.object[0] - scenario.table[0, :2], scenario.table[0, 3:5])
        if done.end == "success" and drives and edge not in executions:
            executions[edge] = done
    names = [name for name in ("near", "left", "far", "right") if name in executions][:SHOWN]
    footprint = opened.domain.robot.description.footprint
    pictures = [p for name in names for p in pictures_of(executions[name], footprint)]
    first, *rest = pictures
    first.save(output, save_all=True, append_images=rest, duration=90, loop=0, optimize=True)
    click.echo(f"{output}: {len(pictures)} pictures, {output.stat().st_size} bytes")


def edge_of(place: Tensor, size: Tensor) -> str:
    """The edge of a table of this size that a place relative to its centre is nearest to."""
    distance = (size / 2 - place.abs()).tolist()
    x, y = place.tolist()
    if distance[0] < distance[1]:
        return "near" if x < 0 else "far"
    return "left" if y > 0 else "right"


def pictures_of(done: Execution, footprint: Any) -> list[Image.Image]:
    """The pictures of one execution."""
    found = [picture(done, footprint, done.pose[0], "start")] * REST
    for i, step in enumerate(done.steps):
        a, b = done.pose[i], done.pose[i + 1]
        turn = torch.remainder(b - a + torch.pi, 2 * torch.pi) - torch.pi
        way = torch.stack([(b - a)[0], (b - a)[1], turn[2]])
        moves = bool(way.abs().sum() > 0.01)
        last = i == len(done.steps) - 1
        text = f"{step.name} → {step.outcome}"
        for k in range(1, BETWEEN + 1) if moves else ():
            found.append(picture(done, footprint, a + way * k / BETWEEN, text))
        if moves or last or step.name == "Grasp":
            found += [picture(done, footprint, b, text, last)] * (REST * (2 if last else 1))
    return found


def picture(
    done: Execution, footprint: Any, pose: Tensor, text: str, reached: bool = False
) -> Image.Image:
    """The scene from above; away from the robot's first place is up."""
    figure = Figure(figsize=(4.4, 3.6), dpi=80, layout="constrained")
    axes = figure.subplots()
    scenario = done.scenario
    table = scenario.table[0]
    half = table[3:5] / 2
    signs = torch.tensor([[1.0, 1], [1, -1], [-1, -1], [-1, 1]])
    outline = rotate(signs * half, table[2].expand(4)) + table[:2]
    axes.add_patch(Polygon(_seen(outline), facecolor=TABLE, edgecolor=RIM))
    x0, x1, y0, y1 = footprint
    body = torch.tensor([[x0, y0], [x0, y1], [x1, y1], [x1, y0]])
    axes.add_patch(
        Polygon(_seen(rotate(body, pose[2].expand(4)) + pose[:2]), facecolor=ROBOT, alpha=0.8)
    )
    ahead = rotate(torch.tensor([[0.0, 0], [x1, 0]]), pose[2].expand(2)) + pose[:2]
    axes.plot(*zip(*_seen(ahead), strict=True), color="white", linewidth=2)
    x, y = _seen(scenario.object)[0]
    axes.plot(x, y, "o", markersize=9, color=REACHED if reached else WAITING)
    if reached:
        hand = torch.stack([pose[:2], scenario.object[0]])
        axes.plot(*zip(*_seen(hand), strict=True), color=REACHED, linewidth=2)
    axes.set_xlim(-2.2, 2.2)
    axes.set_ylim(-1.9, 1.7)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title(f"{text}{'  — reached' if reached else ''}", fontsize=11)
    file = io.BytesIO()
    figure.savefig(file, format="png")
    file.seek(0)
    return Image.open(file).convert("RGB").quantize(32, dither=Image.Dither.NONE)


def _seen(points: Tensor) -> list[tuple[float, float]]:
    """World x, y as right and up of the picture."""
    return [(-float(y), float(x)) for x, y in points]


if __name__ == "__main__":
    command()
