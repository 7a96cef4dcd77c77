"""Predictions of percepts by geometry alone, without data.

Percepts are those of `cgtorch.tabletop.world.percepts`. A motion (..., 3) is dx, dy and dθ: the
robot translates by (dx, dy) with its heading fixed, and then turns by dθ. Units are metres and
radians, in the robot's base frame.

Thousands of motions are computed at once, so the columns of results are contiguous in memory
(`columns`), which makes operations on single columns several times as fast.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.ground.errors import DataError
from cgtorch.ground.numerics import atan2
from cgtorch.tabletop.world.percepts import Percept, parts_of

CENTRE, EXTENTS, OBJECT = slice(0, 2), slice(2, 4), slice(4, 6)
"""The slices of the box's centre, its extents, and the object's x and y in `to_parts`."""


def columns(*parts: Tensor) -> Tensor:
    """Parts (..., k_i) joined to (..., sum k_i), with each column contiguous."""
    return torch.cat([part.movedim(-1, 0) for part in parts]).movedim(0, -1)


def side_by_side(*numbers: Tensor) -> Tensor:
    """Numbers (...), with shapes that broadcast, as columns (..., k)."""
    if any(x.shape != numbers[0].shape for x in numbers):
        numbers = torch.broadcast_tensors(*numbers)
    return torch.stack(numbers).movedim(0, -1)


def length(vector: Tensor) -> Tensor:
    """Length (...) of vectors (..., 2)."""
    # The bound keeps the gradient at 0 finite.
    return vector.square().sum(-1).clamp_min(1e-30).sqrt()


def check_shapes(percept: Tensor, motion: Tensor) -> None:
    """DataError unless percepts are of the tabletop, and motions (..., 3)."""
    parts_of(percept)
    if motion.shape[-1:] != (3,):
        raise DataError(f"motion has shape {tuple(motion.shape)}; pass (..., 3)")


def to_parts(percept: Tensor) -> Tensor:
    """Box centre x, y, extents along x, y and object x, y, z (..., 7) of a percept (..., D)."""
    low, high = percept[..., 0:4:2], percept[..., 1:4:2]
    return columns((low + high) / 2, high - low, percept[..., 4:7])


def from_parts(parts: Tensor) -> Tensor:
    """The first numbers (..., 7) of a percept with the parts (..., 7) of `to_parts`."""
    centre, half = parts[..., CENTRE], parts[..., EXTENTS] / 2
    low, high = centre - half, centre + half
    return columns(low[..., :1], high[..., :1], low[..., 1:], high[..., 1:], parts[..., 4:])


def move_rigidly(parts: Tensor, motion: Tensor) -> Tensor:
    """Parts (..., 7) after the robot's motion (..., 3), with the box's extents unchanged.

    A point moves to R(-dθ)(point - (dx, dy)). So does the centre of the box, because the table is a
    centrally symmetric rectangle. Only the extents cannot be computed: they depend on the rectangle
    inside the box, which the percept does not show.
    """
    dx, dy, cos, sin = motion[..., 0], motion[..., 1], motion[..., 2].cos(), motion[..., 2].sin()
    moved = list(parts.unbind(-1))
    for x, y in ((0, 1), (4, 5)):
        px, py = parts[..., x] - dx, parts[..., y] - dy
        moved[x], moved[y] = cos * px + sin * py, cos * py - sin * px
    return side_by_side(*moved)


def table_sides(extents: Tensor) -> Tensor:
    """Short and long side (2,) of the one table whose box had extents (n, 2) at n yaws.

    The box of a rectangle a × b has the extents w = a|cos| + b|sin| and h = a|sin| + b|cos|. With A
    = a² + b², B = 2ab and K = A² - B², all (w, h) lie on the ellipse (A (w² + h²) - 2B wh) / K = 1,
    whose two coefficients are found by linear least squares. If they give no rectangle, the mean
    extents are the sides.
    """
    w, h = extents.double().unbind(-1)
    terms = torch.stack([w * w + h * h, -2 * w * h], dim=1)
    gram = terms.T @ terms + 1e-12 * torch.eye(2).to(terms)
    first, second = torch.linalg.solve(gram, terms.sum(0)).unbind()
    scale = first * first - second * second
    total, gap = (first + second) / scale, (first - second) / scale
    if bool((scale > 0) & (gap > 0) & (total > gap)):
        low, high = total.sqrt() - gap.sqrt(), total.sqrt() + gap.sqrt()
        return torch.stack([low, high]) / 2
    return extents.double().mean(0).sort().values


def turned_extents(yaw: Tensor, sides: Tensor) -> Tensor:
    """Extents (..., 2) of the box of a rectangle of sides (..., 2), the first along x at yaw 0."""
    c, s = yaw.cos().abs(), yaw.sin().abs()
    a, b = sides[..., 0], sides[..., 1]
    return side_by_side(a * c + b * s, a * s + b * c)


def loosely_turned(extents: Tensor, turn: Tensor) -> Tensor:
    """Extents (..., 2) of a box after turns (...) of the robot, for an unknown shape.

    Their sum stays, and their difference changes like that of an ellipse's squared extents: a
    quarter turn swaps them, and half-way they are equal.
    """
    total, gap = extents.sum(-1), (extents[..., 0] - extents[..., 1]) * torch.cos(2 * turn)
    return side_by_side(total + gap, total - gap) / 2


def boxes_moved(boxes: Tensor, motion: Tensor) -> Tensor:
    """Boxes of obstacles (..., K, 4) after motions (..., 3); absent ones stay absent."""
    parts = to_parts(torch.nn.functional.pad(boxes, (0, 3)))
    each = motion[..., None, :]
    moved = move_rigidly(parts, each)
    extents = loosely_turned(parts[..., EXTENTS], each[..., 2])
    centre, half = moved[..., CENTRE], extents / 2
    after = torch.stack([centre - half, centre + half], dim=-1).flatten(-2)
    return torch.where((boxes != 0).any(-1, keepdim=True), after, torch.zeros_like(after))


def side_turned(side: Tensor, motion: Tensor) -> Tensor:
    """Sides of tables (..., 2 or 0), at twice their angle, after motions (..., 3)."""
    if not side.shape[-1]:
        return side.expand(*torch.broadcast_tensors(side[..., :0], motion[..., :0])[0].shape)
    c, s = torch.cos(2 * motion[..., 2]), torch.sin(2 * motion[..., 2])
    x, y = side[..., 0], side[..., 1]
    return side_by_side(c * x + s * y, c * y - s * x)


@dataclass(frozen=True)
class Scene:
    """Quantities derived once from percepts (..., D), for several functions.

    Attributes:
        seen: The parts of the percepts.
        parts: (..., 7) of `to_parts`.
        yaws: (..., 2) the possible yaws of the table; equal if the percepts contain the yaw.
        sides: (2,) or (..., 2) of the table.
    """

    seen: Percept
    parts: Tensor
    yaws: Tensor
    sides: Tensor


def scene_of(percept: Tensor, sides: Tensor) -> Scene:
    """The scene of percepts (..., D); `sides` (2,) are the table's if only its box is seen."""
    seen, parts = parts_of(percept), to_parts(percept)
    if not seen.side.shape[-1]:
        return Scene(seen, parts, mirror_yaws(parts, sides), sides)
    table = seen.table
    return Scene(seen, parts, table[..., 2:3].expand(*table.shape[:-1], 2), table[..., 3:])


def mirror_yaws(parts: Tensor, sides: Tensor) -> Tensor:
    """The two yaws (..., 2) that a table of sides (2,) may have within the box of parts (..., 7).

    With the terms of `table_sides`, w² + h² = A + B |sin 2θ| and h² - w² = (b² - a²) cos 2θ, so the
    box determines the yaw except for its sign. The first of the two has the sign of u v, where (u,
    v) is the object's place relative to the box's centre: then mirroring the scene mirrors both
    yaws and changes nothing else.
    """
    w2, h2 = parts[..., 2].square(), parts[..., 3].square()
    u, v = parts[..., 4] - parts[..., 0], parts[..., 5] - parts[..., 1]
    a2, b2 = sides.square().unbind()
    sin = ((w2 + h2 - a2 - b2) / (2 * sides.prod())).clamp_min(0)
    size = atan2(sin, (h2 - w2) / (b2 - a2).clamp_min(1e-9)) / 2
    first = torch.where(u * v < 0, -size, size)
    return side_by_side(first, -first)


def places_on_table(scene: Scene) -> Tensor:
    """Features (..., 4): |x|, |y| (m) of the object in the table's frame, for either yaw.

    A rectangle is the same after half a turn and when mirrored in its axes, so only magnitudes
    matter. They distinguish the yaws, because people put things near the edges of tables.
    """
    offset = scene.parts[..., OBJECT] - scene.parts[..., CENTRE]
    u, v, c, s = offset[..., :1], offset[..., 1:], scene.yaws.cos(), scene.yaws.sin()
    (x1, x2), (y1, y2) = ((c * u + s * v).unbind(-1), (c * v - s * u).unbind(-1))
    return side_by_side(x1, y1, x2, y2).abs()


def boxes_after(yaws: Tensor, motion: Tensor, sides: Tensor) -> Tensor:
    """Extents (..., 2 yaws, 2) of the box after motions (..., 3), for either yaw (..., 2)."""
    return turned_extents(yaws - motion[..., 2:3], sides[..., None, :])


def next_percept(scene: Scene, motion: Tensor, value: Tensor, trust: Tensor) -> Tensor:
    """Next percepts (..., D), given which of the two yaws `value` (...) selects, 1 or -1.

    With a `trust` () of 0, the box is turned by `loosely_turned` instead.
    """
    moved = move_rigidly(scene.parts, motion)
    first, second = boxes_after(scene.yaws, motion, scene.sides).unbind(-2)
    # Sharper than the value itself, which the width of the kernel has smoothed.
    weight = torch.sin(torch.pi / 2 * value.clamp(-1, 1))[..., None] / 2
    extents = (first + second) / 2 + weight * (first - second)
    loose = loosely_turned(scene.parts[..., EXTENTS], motion[..., 2])
    extents = loose + trust.to(loose) * (extents - loose)
    seven = from_parts(columns(moved[..., CENTRE], extents, moved[..., 4:]))
    if scene.seen.side.shape[-1] + scene.seen.obstacles.shape[-2] == 0:
        return seven
    others = boxes_moved(scene.seen.obstacles, motion).flatten(-2)
    return torch.cat([seven, side_turned(scene.seen.side, motion), others], dim=-1)


def extremes(scene: Scene, motion: Tensor) -> Tensor:
    """How unusual a transition is (..., 4).

    These are the distance of the object (m), the distance driven (m), the size of the turn (rad),
    and the misfit of table and box (m).
    """
    misfit = scene.parts[..., EXTENTS] - turned_extents(scene.yaws[..., 0], scene.sides)
    far, way = length(scene.parts[..., OBJECT]), length(motion[..., :2])
    return side_by_side(far, way, motion[..., 2].abs(), length(misfit))
