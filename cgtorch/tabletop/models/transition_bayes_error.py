"""What a percept leaves open: the next percepts that are possible given all that the robot knows.

The box around a turned rectangle does not show how it is turned, so the next percept has a
distribution, and no model errs less than its median. As the scenes are our own, that distribution
can be sampled, by importance sampling (Kahn & Marshall 1953): tables are drawn as the world draws
them and kept as often as the box seen makes them likely; the object and the motion weigh them.
"""

import torch
from torch import Generator, Tensor

from cgtorch.tabletop.data.poses import PERIMETER, Scenes, WorldOf, poses_around
from cgtorch.tabletop.models.geometry import to_parts
from cgtorch.tabletop.models.object_prior import placement_density
from cgtorch.tabletop.models.table_posterior import tables_behind
from cgtorch.tabletop.world import motion_possible
from cgtorch.tabletop.world.geometry import bounding_box, moved, rectangle_in_frame, rotate
from cgtorch.tabletop.world.percepts import TABLETOP, percept_of

_POOL = 64  # scenarios whose noise is drawn from
_SMALLEST_BLUR = 1e-3  # m; below it the drawn tables would lie too far apart
_OUTLIER = 1e-6  # weight, relative to a whole table, of what the scenes are said not to contain


def possible_next(
    world_of: WorldOf,
    percept: Tensor,
    motion: Tensor,
    generator: Generator,
    scenes: Scenes = PERIMETER,
    candidates: int = 8192,
    samples: int = 256,
) -> tuple[Tensor, Tensor]:
    """Samples of the next percept given percepts and motions that were carried out.

    Args:
        world_of: makes the world of given scenarios; its noise is used.
        percept: (n, D).
        motion: (n, 3).
        generator: of all random choices.
        scenes: to draw from; either the paper's table, or any.
        candidates: tables drawn from the scenes, where they are the paper's.
        samples: S, next percepts for each row.

    Returns:
        Next percepts' first numbers (n, S, 7) and their weights (n, S), each row's with sum 1.
    """
    world = world_of(scenes.draw(_POOL, generator))
    drift, blur = world.drift.flatten(0, 1), world.blur.flatten(0, 1)[:, :TABLETOP]
    deviation, shape = float(blur.std().clamp_min(_SMALLEST_BLUR)), (len(percept), samples)
    if scenes is PERIMETER:
        look = blur[torch.randint(len(blur), shape, generator=generator)]
        shapes = _likely_shapes(world_of, percept, deviation, samples, candidates, generator)
        rectangle, placed, weight = _one_table(percept, shapes, look)
    else:
        rectangle, placed, weight = tables_behind(percept, deviation, samples, generator)
    many = motion[:, None].expand(*shape, 3)
    free = motion_possible(many.flatten(0, 1), rectangle.flatten(0, 1), world.footprint)
    weight = weight * (free.view(shape) + _OUTLIER)
    pick, then = (torch.randint(len(blur), shape, generator=generator) for _ in range(2))
    # The height has the noise of both looks.
    height = (
        percept[:, None, 6:7] - blur[torch.randint(len(blur), shape, generator=generator)][..., 6:]
    )
    pose = moved(torch.zeros_like(many), many + drift[pick])
    following = percept_of(pose, torch.cat([rectangle, height], -1), placed) + blur[then]
    return following, weight / weight.sum(1, keepdim=True)


def _one_table(percept: Tensor, shapes: Tensor, look: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Tables (n, S, 5), objects (n, S, 2) and weights (n, S) of the paper's scenes.

    Args:
        percept: (n, D).
        shapes: (n, S, 3) yaw and sides.
        look: (n, S, 7) noise of the percept.
    """
    seen = percept[:, None, :TABLETOP] - look
    centre, placed = to_parts(seen)[..., :2], seen[..., 4:6]
    weight = placement_density(rotate(placed - centre, -shapes[..., 0]), shapes[..., 1:])
    return torch.cat([centre, shapes], -1), placed, weight + _OUTLIER


def _likely_shapes(
    world_of: WorldOf,
    percept: Tensor,
    deviation: float,
    samples: int,
    candidates: int,
    generator: Generator,
) -> Tensor:
    """Yaw and sides (n, S, 3) of tables drawn as the world draws them, given percepts (n, D)."""
    scenes = poses_around(world_of, candidates, generator)
    tables = rectangle_in_frame(scenes.pose, scenes.table[:, :5])
    size = to_parts(torch.nn.functional.pad(bounding_box(tables), (0, 3)))[:, 2:4]
    # An extent is the difference of two numbers with noise.
    score = -torch.cdist(to_parts(percept)[:, 2:4], size).square() / (4 * deviation**2)
    chance = (score - score.amax(1, keepdim=True)).exp()
    pick = torch.multinomial(chance, samples, replacement=True, generator=generator)
    return tables[pick][..., 2:]


def weighted_median(values: Tensor, weight: Tensor) -> Tensor:
    """Medians (n, k) of samples (n, S, k) with weights (n, S) that sum to 1 in each row."""
    ordered, place = values.sort(1)
    share = weight[..., None].expand_as(values).gather(1, place).cumsum(1)
    middle = (share < 0.5).sum(1, keepdim=True).clamp_max(values.shape[1] - 1)
    return ordered.gather(1, middle)[:, 0]
