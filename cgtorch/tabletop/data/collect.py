"""Collecting data for Γ and C by random driving in the world (section V)."""

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import Dataset, Lanes, start_lanes
from cgtorch.ground.processes import counted
from cgtorch.tabletop.data.labels import grasp_labels
from cgtorch.tabletop.data.motions import random_motions
from cgtorch.tabletop.data.poses import Scenes, poses_around

MOVES = 8  # of each robot


def collect(scenes: Scenes, transitions: int, labels: int, generator: Generator) -> Dataset:
    """Drive at random for transitions (p, u, p′), and try grasps for labels.

    DataError if almost no pose allows a grasp, or almost all do.
    """
    percept, motion, after = drive(scenes, transitions, generator)
    at, graspable = grasp_labels(scenes, labels, generator)
    return Dataset(percept, motion, after, at, graspable)


def drive(scenes: Scenes, count: int, generator: Generator) -> tuple[Tensor, Tensor, Tensor]:
    """`count` moves p (n, D), u (n, 3), p′ (n, D) of robots driven at random from random poses.

    Moves that are blocked or would leave the arena are not made.
    """
    rows: list[tuple[Tensor, Tensor, Tensor]] = []
    have, more = 0, counted("transitions", count)
    while have < count:
        robots = 2 + (count - have) // (2 * scenes.thrift)
        world = scenes.world(poses_around(scenes, robots, generator))
        lanes = start_lanes(world, torch.arange(robots), 0, 0)
        for _ in range(MOVES):
            motion = random_motions(robots, generator)
            before = lanes
            lanes, ok = world.step(lanes, motion)
            ok &= lanes.state[:, :2].norm(dim=1) <= scenes.arena
            lanes = _either(ok, lanes, before)
            rows.append((before.percept[ok], motion[ok], lanes.percept[ok]))
            have += int(ok.sum())
            more(int(ok.sum()))
    p, u, q = (torch.cat(part) for part in zip(*rows, strict=True))
    pick = torch.randperm(len(p), generator=generator)[:count]
    return p[pick], u[pick], q[pick]


def _either(first: Tensor, yes: Lanes, no: Lanes) -> Lanes:
    """Lanes from `yes` where `first` (n,), else from `no`."""
    pairs = zip(vars(yes).values(), vars(no).values(), strict=True)
    return Lanes(*(torch.where(first.view(-1, *[1] * (a.dim() - 1)), a, b) for a, b in pairs))
