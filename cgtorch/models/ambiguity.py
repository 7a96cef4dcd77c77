"""What a percept leaves open: the next percepts that are possible given all that the robot knows.

The box around a turned rectangle does not show how it is turned, so the next percept has a
distribution, and no model errs less than its median. As the scenes are our own, that distribution
can be sampled, by importance sampling (Kahn & Marshall 1953): tables are drawn as the world draws
them and kept as often as the box seen makes them likely; the object and the motion weigh them.
"""

import torch
from torch import Generator, Tensor

from cgtorch.data.poses import WorldOf, poses_around
from cgtorch.models.geometry import to_parts
from cgtorch.world import motion_possible, random_scenarios
from cgtorch.world.geometry import bounding_box, moved, rectangle_in_frame, rotate
from cgtorch.world.percepts import percept_of
from cgtorch.world.scenarios import INSET_MAX, INSET_MIN

_POOL = 64  # scenarios whose noise is drawn from
_SMALLEST_BLUR = 1e-3  # m; below it the drawn tables would lie too far apart
_OUTLIER = 1e-6  # weight, relative to a whole table, of what the scenes are said not to contain


def possible_next(
    world_of: WorldOf,
    percept: Tensor,
    motion: Tensor,
    generator: Generator,
    candidates: int = 8192,
    samples: int = 256,
) -> tuple[Tensor, Tensor]:
    """Samples of the next percept given percepts and motions that were carried out.

    Args:
        world_of: makes the world of given scenarios; its noise is used.
        percept: (n, 7).
        motion: (n, 3).
        generator: of all random choices.
        candidates: tables drawn from the scenes.
        samples: S, next percepts for each row.

    Returns:
        Next percepts (n, S, 7) and their weights (n, S), each row's with sum 1.
    """
    world = world_of(random_scenarios("perimeter", _POOL, generator))
    drift, blur = world.drift.flatten(0, 1), world.blur.flatten(0, 1)
    deviation = float(blur.std().clamp_min(_SMALLEST_BLUR))
    parts, shape = to_parts(percept), (len(percept), samples)
    shapes = _likely_shapes(world_of, parts[:, 2:4], deviation, *shape[1:], candidates, generator)
    look = torch.randint(len(blur), shape, generator=generator)
    seen = torch.cat([percept[:, None, :4] - blur[look][..., :4], shapes.new_zeros(*shape, 3)], -1)
    centre = to_parts(seen)[..., :2]
    placed = percept[:, None, 4:6] - blur[look][..., 4:6]
    rectangle = torch.cat([centre, shapes], -1)
    weight = placement_density(rotate(placed - centre, -shapes[..., 0]), shapes[..., 1:])
    many = motion[:, None].expand(*shape, 3)
    free = motion_possible(many.flatten(0, 1), rectangle.flatten(0, 1), world.footprint)
    weight = (weight + _OUTLIER) * (free.view(shape) + _OUTLIER)
    height = percept[:, None, 6:] - blur[look][..., 6:]
    pick, then = (torch.randint(len(blur), shape, generator=generator) for _ in range(2))
    pose = moved(torch.zeros_like(many), many + drift[pick])
    following = percept_of(pose, torch.cat([rectangle, height], -1), placed) + blur[then]
    return following, weight / weight.sum(1, keepdim=True)


def _likely_shapes(
    world_of: WorldOf,
    extents: Tensor,
    deviation: float,
    samples: int,
    candidates: int,
    generator: Generator,
) -> Tensor:
    """Yaw and sides (n, S, 3) of tables drawn as the world draws them, given box extents (n, 2)."""
    scenes = poses_around(world_of, candidates, generator)
    tables = rectangle_in_frame(scenes.pose, scenes.table[:, :5])
    size = to_parts(torch.nn.functional.pad(bounding_box(tables), (0, 3)))[:, 2:4]
    # An extent is the difference of two numbers with noise.
    score = -torch.cdist(extents, size).square() / (4 * deviation**2)
    chance = (score - score.amax(1, keepdim=True)).exp()
    pick = torch.multinomial(chance, samples, replacement=True, generator=generator)
    return tables[pick][..., 2:]


def placement_density(at: Tensor, sides: Tensor) -> Tensor:
    """Density (..., per m²) of objects at (..., 2) in the frame of a table of sides (..., 2).

    That of `random_scenarios("perimeter")`: an edge is drawn by its length, then a place along it
    and a distance from it.
    """
    density = torch.zeros_like(at[..., 0])
    for axis in (0, 1):
        long, half = sides[..., 1 - axis], sides[..., axis] / 2
        inset = half - at[..., axis].abs()
        for distance in (inset, 2 * half - inset):  # from the near edge and from the far one
            inside = (distance >= INSET_MIN) & (distance <= INSET_MAX)
            inside &= at[..., 1 - axis].abs() <= long / 2 - INSET_MIN
            area = (INSET_MAX - INSET_MIN) * (long - 2 * INSET_MIN)
            density = density + inside * long / (2 * sides.sum(-1) * area)
    return density


def weighted_median(values: Tensor, weight: Tensor) -> Tensor:
    """Medians (n, k) of samples (n, S, k) with weights (n, S) that sum to 1 in each row."""
    ordered, place = values.sort(1)
    share = weight[..., None].expand_as(values).gather(1, place).cumsum(1)
    middle = (share < 0.5).sum(1, keepdim=True).clamp_max(values.shape[1] - 1)
    return ordered.gather(1, middle)[:, 0]
