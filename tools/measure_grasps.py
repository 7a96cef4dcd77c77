"""Measure how many refused grasps are possible, by a finer search for ways of the arm.

    python tools/measure_grasps.py [--robot pr2] [--count 400] [--seed 0]

It takes minutes. The finer search is that of `tools/solvability/finer.py`.
"""

import click
import torch
from benchmarks.grasps import objects
from solvability.finer import finer_search

from cgtorch.tabletop.kinematics import graspable, has_posture, load_robot


@click.command()
@click.option("--robot", default="pr2", show_default=True)
@click.option("--count", default=400, show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(robot: str, count: int, seed: int) -> None:
    """Print how many objects are accepted, and how many of the refused ones are possible."""
    loaded = load_robot(description=robot)
    position, table = objects(count, seed)
    found = graspable(loaded, position, table)
    posture = has_posture(loaded, position, table)
    with finer_search():
        finer = graspable(loaded, position[~found], table[~found])
    possible = int(finer.sum())
    refused = possible / max(1, possible + int(found.sum()))
    click.echo(
        f"{robot}: {int(found.sum())} of {count} accepted, {int(posture.sum())} have a posture; "
        f"of the refused the finer search finds {possible} possible, {refused:.1%} of all that are"
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
