"""What a percept leaves open: how often a grasp succeeds in the scenes that look the same.

A look has noise, and the box around a turned table does not show to which side it is turned. So
scenes with and without success give the same percept, and no classifier of percepts is always
right. As the scenes are our own, those behind a percept can be sampled, by importance resampling
(Rubin 1987).
"""

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.data import label
from cgtorch.tabletop.data.poses import PERIMETER, Scenes, WorldOf, in_table
from cgtorch.tabletop.models.object_prior import placement_density
from cgtorch.tabletop.models.table_posterior import tables_behind
from cgtorch.tabletop.world import Scenarios
from cgtorch.tabletop.world.geometry import bounding_box, rotate
from cgtorch.tabletop.world.percepts import TABLETOP

_YAWS = 1440  # of a table, which looks the same after half a turn
_MORE = 8  # scenes drawn for each that is kept
_SMALLEST_BLUR = 1e-4  # m


def chance_of_success(
    world_of: WorldOf,
    percept: Tensor,
    samples: int,
    generator: Generator,
    scenes: Scenes = PERIMETER,
) -> Tensor:
    """Share (n,) of `samples` scenes behind each percept in which a grasp succeeds.

    Args:
        world_of: makes the world of given scenarios; its noise is used.
        percept: (n, D) percepts of free poses, with noise.
        samples: scenes for each percept; each costs the world a label.
        generator: of all random choices.
        scenes: to draw from; either the paper's table, or any.
    """
    behind = scenes_behind(world_of, percept, samples, generator, scenes)
    return label(world_of, behind)[1].to(percept).view(len(percept), samples).mean(1)


def scenes_behind(
    world_of: WorldOf,
    percept: Tensor,
    samples: int,
    generator: Generator,
    scenes: Scenes = PERIMETER,
) -> Scenarios:
    """Scenes (n · samples) drawn from those that percepts (n, D) leave possible, row by row.

    Objects are placed and tables shaped as in these scenes; every free pose is as likely.
    Obstacles, which are reached over, are left out.
    """
    examples = scenes.draw(64, generator)
    world = world_of(examples)
    blur = float(world.blur[..., :TABLETOP].std().clamp_min(_SMALLEST_BLUR))
    many = samples * _MORE
    if scenes is PERIMETER:
        table, placed, weight = _one_table(percept, examples.table[0], blur, many, generator)
    else:
        table, placed, weight = tables_behind(percept, blur, many, generator)
    yaw = table[..., 2]
    at = rotate(placed - table[..., :2], -yaw)  # in the table's frame
    pose = torch.cat([-rotate(table[..., :2], -yaw), -yaw[..., None]], -1)
    seen = percept[:, 6, None] + blur * torch.randn(yaw.shape, generator=generator)
    height = seen.clamp(*examples.table[:, 5].aminmax())[..., None]
    shape = torch.cat([torch.zeros_like(pose), table[..., 3:5], height], -1)
    every = Scenarios(
        pose.reshape(-1, 3),
        shape.reshape(-1, 6),
        at.reshape(-1, 2),
        torch.randint(2**31, (yaw.numel(),), generator=generator),
    )
    weight = weight * ~in_table(every, world.footprint).view(yaw.shape) + 1e-9
    kept = torch.multinomial(weight, samples, replacement=True, generator=generator)
    return every[(kept + many * torch.arange(len(percept))[:, None]).flatten()]


def _one_table(
    percept: Tensor, table: Tensor, blur: float, count: int, generator: Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Tables (n, count, 5), objects (n, count, 2) and weights (n, count) given a table (6,)."""
    noise = blur * torch.randn(len(percept), count, 4, generator=generator)
    low, high = percept[:, None, [0, 2]], percept[:, None, [1, 3]]
    centre = (low + high) / 2 + noise[..., :2] / 2**0.5
    placed = percept[:, None, 4:6] + noise[..., 2:]
    yaw = _likely_yaw((high - low)[:, 0], table[3:5], blur, count, generator)
    sides = table[3:5].expand(*yaw.shape, 2)
    weight = placement_density(rotate(placed - centre, -yaw), sides)
    return torch.cat([centre, yaw[..., None], sides], -1), placed, weight


def _likely_yaw(
    extents: Tensor, sides: Tensor, blur: float, count: int, generator: Generator
) -> Tensor:
    """Yaws (n, count) of a table with given sides (2,), drawn given box extents (n, 2)."""
    yaw = torch.arange(_YAWS) * (torch.pi / _YAWS)
    zero = torch.zeros_like(yaw)
    box = bounding_box(torch.stack([zero, zero, yaw, zero + sides[0], zero + sides[1]], 1))
    size = torch.stack([box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]], 1)
    # An extent is the difference of two numbers with noise.
    chance = (-torch.cdist(extents, size).square() / (4 * blur**2)).softmax(1)
    return yaw[torch.multinomial(chance, count, replacement=True, generator=generator)]
