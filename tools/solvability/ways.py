"""Whether poses can be driven to: a roadmap of straight moves between sampled poses."""

import math

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import rectangle_in_frame, to_frame, wrap
from cgtorch.tabletop.world.scenarios import Scenarios

ARENA = 3.0  # m around the table's centre in which poses are sampled


def fewest_moves(
    scene: Scenarios,
    footprint: Tensor,
    goals: Tensor,
    samples: int,
    most: int,
    generator: Generator,
) -> int:
    """How many straight moves lead from the start of one scene to the first goal reached.

    A probabilistic roadmap (Kavraki et al. 1996) of the start, `samples` random free poses and the
    goals (G, 3), searched breadth first; each move is one that the world's own check allows. The
    number is an upper bound. 0 where no goal is reached in at most `most` moves.
    """
    spread = torch.tensor([ARENA, ARENA, math.pi])
    free = spread * (2 * torch.rand(samples, 3, generator=generator) - 1)
    free = free[_allowed(scene, free, torch.zeros_like(free), footprint)]
    poses = torch.cat([scene.pose, goals, free])
    is_goal = torch.zeros(len(poses), dtype=torch.bool)
    is_goal[1 : 1 + len(goals)] = True
    new = torch.zeros(1, dtype=torch.long)
    waiting = torch.arange(1, len(poses))
    for moves in range(1, most + 1):
        if not len(new) or not len(waiting):
            return 0
        origin, target = new.repeat_interleave(len(waiting)), waiting.repeat(len(new))
        motion = motions(poses[origin], poses[target])
        reached = _allowed(scene, poses[origin], motion, footprint).view(len(new), -1).any(0)
        if is_goal[waiting[reached]].any():
            return moves
        new, waiting = waiting[reached], waiting[~reached]
    return 0


def motions(origin: Tensor, target: Tensor) -> Tensor:
    """Motions (n, 3), straight and then a turn, that lead from poses (n, 3) to poses (n, 3)."""
    turn = wrap(target[:, 2] - origin[:, 2])
    return torch.cat([to_frame(origin, target[:, :2]), turn[:, None]], 1)


def _allowed(scene: Scenarios, poses: Tensor, motion: Tensor, footprint: Tensor) -> Tensor:
    """(n,) bool, whether motions (n, 3) from poses (n, 3) in one scene are possible."""
    things = torch.cat([scene.table[0, None, :5], scene.obstacles[0]])
    things = things.expand(len(poses), -1, -1)
    return motion_possible(motion, rectangle_in_frame(poses[:, None], things), footprint)
