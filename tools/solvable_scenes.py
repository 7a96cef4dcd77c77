"""Estimate the share of random scenes that can be solved at all, and in how many moves.

    python tools/solvable_scenes.py [--scenarios general-clutter] [--run RUN]

A scene can be solved if there is a pose of the base from which an arm can grasp the object, and a
route to it, in straight motions with a turn at their end, that the world allows. Poses and routes
are sampled, so the share is a lower bound, and the number of moves an upper bound. With a run, its
last skill is tried on the same scenes, and those that it misses are reported.
"""

from collections import Counter
from pathlib import Path

import click
import torch
from solvability.poses import poses_that_grasp
from solvability.ways import fewest_moves
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.world import DRAWS, Scenarios
from cgtorch.training.evaluate import evaluate_skill

ROUNDS = 64  # of sampling, while a scene is open; each knows more poses and a wider roadmap
MOST_MOVES = 10  # of 20 transitions, as each move takes a node that says where to


@click.command()
@click.option("--scenarios", default="general-clutter", type=click.Choice(list(DRAWS)))
@click.option("--count", default=1000, show_default=True, help="How many scenes.")
@click.option("--seed", default=11_000_001, show_default=True, help="That they are drawn with.")
@click.option("--samples", default=150, show_default=True, help="Poses of a roadmap at first.")
@click.option("--run", type=click.Path(path_type=Path), help="A run to try on these scenes.")
def command(scenarios: str, count: int, seed: int, samples: int, run: Path | None) -> None:
    """Print the share of random scenes that can be solved, and what a skill misses of them."""
    torch.set_num_threads(1)
    domain: Domain[Scenarios] = Tabletop().for_run(scenarios, "compose")
    scenes = domain.draw(scenarios, count, Generator().manual_seed(seed))
    found, moves = solvable(domain, scenes, samples, Generator().manual_seed(seed))
    can = moves > 0
    click.echo(f"{int(found.sum())} of {count} scenes have a pose that grasps")
    click.echo(f"{int(can.sum())} of {count} can be solved: {_counted(moves)}")
    if run is None:
        return
    its_run, skill = last_skill(run)
    done = evaluate_skill(skill, its_run.domain, scenarios, count, seed).succeeded
    share = float((done & can).sum() / can.sum())
    click.echo(
        f"{skill.name} solves {int((done & can).sum())} of the {int(can.sum())}, {share:.2%}, "
        f"and {int((done & ~can).sum())} of the others"
    )
    boxes = (scenes.obstacles[..., 3:].amin(2) > 0).any(1)
    missed = can & ~done
    click.echo(
        f"missed: {int((missed & boxes).sum())} of {int(boxes.sum())} with a box; "
        f"{_counted(moves[missed])}; scenes {missed.nonzero()[:, 0].tolist()}"
    )


def solvable(
    domain: Domain[Scenarios], scenes: Scenarios, samples: int, generator: Generator
) -> tuple[Tensor, Tensor]:
    """(B,) bool, whether a suitable pose was found, and (B,) long moves to it, 0 for none."""
    world = domain.world
    footprint = world(scenes[:0]).footprint
    moves = torch.zeros(len(scenes), dtype=torch.long)
    goals = [torch.empty(0, 3) for _ in range(len(scenes))]
    for number in range(ROUNDS):
        still = (moves == 0).nonzero()[:, 0]
        if not len(still):
            break
        good, poses = poses_that_grasp(world, scenes[still], generator)
        for i, row in enumerate(still.tolist()):
            goals[row] = torch.cat([goals[row], poses[i][good[i]]])
            if len(goals[row]):
                moves[row] = fewest_moves(
                    scenes[row : row + 1],
                    footprint,
                    goals[row],
                    samples * (number + 1),
                    MOST_MOVES,
                    generator,
                )
    return torch.tensor([len(g) > 0 for g in goals]), moves


def _counted(moves: Tensor) -> str:
    """How many scenes take how many moves."""
    counts = sorted(Counter(moves[moves > 0].tolist()).items())
    return ", ".join(f"{number} in {n} move{'s' * (n > 1)}" for n, number in counts)


if __name__ == "__main__":
    command()
