"""Labels for C: percepts and whether a grasp succeeds, sampled where they are most informative.

Sampling never depends on a row's own label, so among equal percepts labels are as frequent as in
the world, and probabilities learned from them are correct.
"""

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import DataError
from cgtorch.ground.processes import counted
from cgtorch.tabletop.data.poses import Scenes, poses_around, poses_at_object
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.percepts import parts_of, percept_of

ANYWHERE = 0.06  # share of the labels that are drawn anywhere, far from the table too
BESIDE = 0.7  # share that is drawn beside the boundary
ROUNDS = 2  # in which these are drawn, each nearer to the boundary
CANDIDATES = 8  # poses for each that is labelled beside the boundary
NEIGHBOURS = 4  # of either label that say how near the boundary is
SIDES_MATTER = 1.0  # m from the base; where the table ends further away matters no more
OBJECT_MATTERS = 2.0  # how much a distance between objects counts, against one between sides
PROBE = 200  # poses, at least, that show whether there is anything to learn


def label(scenes: Scenes, scenarios: Scenarios) -> tuple[Tensor, Tensor]:
    """The percept at each pose (B, D), and (B,) bool whether a grasp succeeds there."""
    world = scenes.world(scenarios)
    lanes = start_lanes(world, torch.arange(len(scenarios)), 0, 0)
    return lanes.percept, world.success(lanes)[1] > 0.5


def grasp_labels(scenes: Scenes, count: int, generator: Generator) -> tuple[Tensor, Tensor]:
    """`count` percepts (n, D) and (n,) bool labels, in random order.

    Some poses are around the object, more are close to the boundary between success and failure,
    and the others are anywhere, so that models do not predict success where there are no data. The
    base never overlaps the table, as no skill can bring it there. DataError if fewer than one pose
    in a hundred around the object has either label.
    """
    anywhere, beside = int(ANYWHERE * count), int(BESIDE * count) // ROUNDS
    first = count - anywhere - ROUNDS * beside
    poses = poses_at_object(scenes, max(first, PROBE), generator)
    answered = counted("labels", len(poses) + ROUNDS * beside + anywhere)
    percept, graspable = label(scenes, poses)
    answered(len(poses))
    rate = float(graspable.float().mean())
    if not 0.01 < rate < 0.99:
        raise DataError(
            f"a grasp succeeds at {rate:.1%} of random poses around the object; check that the "
            "arms of the robot description reach the table"
        )
    probes = len(percept)
    for _ in range(ROUNDS):
        more = poses_at_object(scenes, CANDIDATES * beside, generator)
        more = more[nearest_to_boundary(more, percept, graspable, beside)]
        seen, answer = label(scenes, more)
        percept, graspable = torch.cat([percept, seen]), torch.cat([graspable, answer])
        answered(beside)
    far, fails = label(scenes, poses_around(scenes, anywhere, generator, 2))
    answered(anywhere)
    percept = torch.cat([percept[:first], percept[probes:], far])
    graspable = torch.cat([graspable[:first], graspable[probes:], fails])
    order = torch.randperm(count, generator=generator)
    return percept[order], graspable[order]


def nearest_to_boundary(
    scenarios: Scenarios, percept: Tensor, graspable: Tensor, count: int
) -> Tensor:
    """Indices (count,) of scenarios about equally far from known successes and known failures.

    The known percepts are (n, D), and their labels `graspable` (n,), with some of either.
    """
    seen = percept_of(scenarios.pose, scenarios.table, scenarios.object)
    to_success = _distance(seen, percept[graspable])
    to_failure = _distance(seen, percept[~graspable])
    uneven = (to_success - to_failure).abs() / (to_success + to_failure)
    return uneven.topk(count, largest=False).indices


def _distance(seen: Tensor, known: Tensor) -> Tensor:
    """Mean distance (B,) from percepts (B, 7) to the nearest few of the known ones (n, D)."""

    def place(percept: Tensor) -> Tensor:
        part = parts_of(percept)
        sides = part.box.clamp(-SIDES_MATTER, SIDES_MATTER)
        return torch.cat([sides, OBJECT_MATTERS * part.object], 1)

    few = min(NEIGHBOURS, len(known))
    parts = [
        torch.cdist(place(part), place(known)).topk(few, largest=False).values
        for part in seen.split(2048)
    ]
    return torch.cat(parts).mean(1)
