"""What a percept leaves open: how often a grasp succeeds in the scenes that look the same.

A look has noise, and the box around a turned table does not show to which side it is turned. So
scenes with and without success give the same percept, and no classifier of percepts is always
right. As the scenes are our own, those behind a percept can be sampled, by importance resampling
(Rubin 1987).
"""

import torch
from torch import Generator, Tensor

from cgtorch.data import label
from cgtorch.data.poses import WorldOf, in_table
from cgtorch.models.ambiguity import placement_density
from cgtorch.world import Scenarios, random_scenarios
from cgtorch.world.geometry import bounding_box, rotate

_YAWS = 1440  # of a table, which looks the same after half a turn
_MORE = 8  # scenes drawn for each that is kept
_SMALLEST_BLUR = 1e-4  # m


def chance_of_success(
    world_of: WorldOf, percept: Tensor, samples: int, generator: Generator
) -> Tensor:
    """Share (n,) of `samples` scenes behind each percept in which a grasp succeeds.

    Args:
        world_of: makes the world of given scenarios; its noise is used.
        percept: (n, 7) percepts of free poses, with noise.
        samples: scenes for each percept; each costs the world a label.
        generator: of all random choices.
    """
    scenes = scenes_behind(world_of, percept, samples, generator)
    return label(world_of, scenes)[1].to(percept).view(len(percept), samples).mean(1)


def scenes_behind(
    world_of: WorldOf, percept: Tensor, samples: int, generator: Generator
) -> Scenarios:
    """Scenes (n · samples) drawn from those that percepts (n, 7) leave possible, row by row.

    Objects are placed and tables shaped as `random_scenarios` does; every free pose is as likely.
    """
    examples = random_scenarios("perimeter", 64, generator)
    world = world_of(examples)
    blur, table = float(world.blur.std().clamp_min(_SMALLEST_BLUR)), examples.table[0]
    many = samples * _MORE
    noise = blur * torch.randn(len(percept), many, 4, generator=generator)
    low, high = percept[:, None, [0, 2]], percept[:, None, [1, 3]]
    centre = (low + high) / 2 + noise[..., :2] / 2**0.5
    yaw = _likely_yaw((high - low)[:, 0], table[3:5], blur, many, generator)
    at = rotate(percept[:, None, 4:6] + noise[..., 2:] - centre, -yaw)  # in the table's frame
    pose = torch.cat([-rotate(centre, -yaw), -yaw[..., None]], -1)
    every = Scenarios(
        pose.reshape(-1, 3),
        table.expand(yaw.numel(), -1),
        at.reshape(-1, 2),
        torch.randint(2**31, (yaw.numel(),), generator=generator),
    )
    weight = placement_density(at, table[3:5].expand(*yaw.shape, 2))
    weight = weight * ~in_table(every, world.footprint).view(yaw.shape) + 1e-9
    kept = torch.multinomial(weight, samples, replacement=True, generator=generator)
    return every[(kept + many * torch.arange(len(percept))[:, None]).flatten()]


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
