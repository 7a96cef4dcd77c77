"""Measure how many refused grasps are possible, by a finer search for ways of the arm.

    python tools/measure_grasps.py [--robot pr2] [--count 400] [--seed 0]

It takes minutes. The finer search samples the pan angle four times as densely, tests every posture
at every approach, and plans ten times as long to many more of them.
"""

from unittest.mock import patch

import click
import torch
from benchmarks.grasps import objects

from cgtorch.tabletop.kinematics import (
    grasp_lines,
    graspable,
    has_posture,
    load_robot,
    rrt_connect,
    way_search,
)
from cgtorch.tabletop.kinematics.arm import ArmModel

FINER = 4


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
    usual = ArmModel.candidates
    with (
        patch.object(ArmModel, "candidates", lambda arm, pose: usual(arm, pose, 36 * FINER)),
        patch.multiple(grasp_lines, NEAR=64, TRIED=16, PAN_SAMPLES=36 * FINER),
        patch.object(way_search, "PLANNED", 20),
        patch.object(rrt_connect, "ROUNDS", 1000),
    ):
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
