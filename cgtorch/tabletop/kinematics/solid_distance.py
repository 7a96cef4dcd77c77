"""Distances between solids by the Gilbert-Johnson-Keerthi algorithm, many pairs at once.

It needs only the point of a solid that is farthest in a direction ("A fast procedure for computing
the distance between complex objects in three-dimensional space", 1988). It searches the nearest
point to the origin of the difference of two solids in a simplex of its points.
"""

import itertools

import torch
from torch import Tensor

ROUNDS = 40
TOLERANCE = 1e-5  # m
TOUCHING = 1e-12  # m²: the origin lies in the difference of two solids
_TINY = 1e-30


def farthest(pose: Tensor, size: Tensor, way: Tensor) -> Tensor:
    """(M, 3) the point of each solid, without its ball, that is farthest in a direction (M, 3)."""
    local = (way[:, None] @ pose[..., :3]).squeeze(1)
    flat = local[:, :2].norm(dim=1, keepdim=True)
    disc = size[:, 3:4] * local[:, :2] / flat.clamp_min(_TINY)
    at = torch.where(local < 0, -size[:, :3], size[:, :3])
    at = at + torch.nn.functional.pad(disc, (0, 1))
    return (pose[..., :3] @ at[..., None]).squeeze(-1) + pose[..., 3]


def distance_of(pose: Tensor, size: Tensor, other_pose: Tensor, other_size: Tensor) -> Tensor:
    """(M,) a lower bound of the distance of solids with poses (M, 3, 4) and sizes (M, 5), m.

    It is exact to `TOLERANCE`, and 0 or less if they meet.
    """
    balls = size[:, 4] + other_size[:, 4]
    least = torch.full_like(balls, -torch.inf)
    away = pose[..., 3] - other_pose[..., 3]
    rows = torch.arange(len(balls), device=balls.device)
    corners = None
    for _ in range(ROUNDS):
        square = away.square().sum(1)
        new = farthest(pose[rows], size[rows], -away)
        new = new - farthest(other_pose[rows], other_size[rows], away)
        length = square.sqrt()
        bound = (away * new).sum(1) / length.clamp_min(_TINY)
        meets = square < TOUCHING
        least[rows] = torch.where(meets, 0.0, torch.maximum(least[rows], bound))
        open_ = ~meets
        if corners is None:
            corners = new[:, None].expand(-1, 3, 3)
            away = new
        else:
            open_ &= length - least[rows] >= TOLERANCE
            corners, away = _nearest_of_tetrahedron(corners, new)
        rows, corners, away = rows[open_], corners[open_], away[open_]
        if not len(rows):
            break
    return least - balls


def _nearest_of_tetrahedron(corners: Tensor, new: Tensor) -> tuple[Tensor, Tensor]:
    """The face (M, 3, 3) with the new corner that is nearest to the origin, and its nearest point.

    The point is the origin itself if it is inside the tetrahedron.
    """
    faces = [
        torch.stack([corners[:, i], corners[:, j], new], 1)
        for i, j in itertools.combinations(range(3), 2)
    ]
    points = torch.stack([_nearest_of_triangle(*face.unbind(1)) for face in faces], 1)
    best = points.square().sum(-1).argmin(1)
    rows = torch.arange(len(new), device=new.device)
    inside = _holds_origin(torch.cat([corners, new[:, None]], 1))
    point = torch.where(inside[:, None], 0.0, points[rows, best])
    return torch.stack(faces, 1)[rows, best], point


def _holds_origin(corners: Tensor) -> Tensor:
    """(M,) whether tetrahedra (M, 4, 3) with a volume contain the origin."""
    held = torch.ones(len(corners), dtype=torch.bool, device=corners.device)
    for i in range(4):
        a, b, c = (corners[:, j] for j in range(4) if j != i)
        normal = torch.linalg.cross(b - a, c - a)
        held &= (-a * normal).sum(1) * ((corners[:, i] - a) * normal).sum(1) > 0
    return held


def _nearest_of_triangle(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """(M, 3) the points of triangles that are nearest to the origin."""
    edges = [_nearest_of_segment(*ends) for ends in ((a, b), (a, c), (b, c))]
    normal = torch.linalg.cross(b - a, c - a)
    square = normal.square().sum(1, keepdim=True)
    sound = square > _TINY
    square = square.clamp_min(_TINY)
    flat = normal * (a * normal).sum(1, keepdim=True) / square
    v = (torch.linalg.cross(flat - a, c - a) * normal).sum(1, keepdim=True) / square
    w = (torch.linalg.cross(b - a, flat - a) * normal).sum(1, keepdim=True) / square
    within = sound & (v >= 0) & (w >= 0) & (v + w <= 1)
    points = torch.stack([*edges, torch.where(within, flat, edges[0])], 1)
    best = points.square().sum(-1).argmin(1)
    return points[torch.arange(len(a), device=a.device), best]


def _nearest_of_segment(a: Tensor, b: Tensor) -> Tensor:
    along = b - a
    share = -(a * along).sum(1, keepdim=True) / along.square().sum(1, keepdim=True).clamp_min(_TINY)
    return a + share.clamp(0, 1) * along
