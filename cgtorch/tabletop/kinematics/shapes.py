"""Boxes, cylinders, capsules and spheres around meshes, with a volume as small as possible."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]

ROUNDING = 1e-6  # m by which shapes are larger, so that what they are made for is inside
THIN = 1e-3  # minimum thickness, m
MAX_FLATNESS = 400  # of a box: as many times as long as thick at most
MOST_PARTS = 4  # shapes of one mesh
WORTH = 0.9
"""A part is split if its two parts have at most this share of its volume."""
CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)  # where a part may be cut, as shares of its box's sides
MOST_CUT = 20_000  # triangles; of a mesh with more, its convex hull is cut, if that has no more
SEARCHED = 100  # directions whose furthest points decide how a shape lies


@dataclass(frozen=True)
class Shape:
    """A convex shape.

    Attributes:
        kind: "box", "cylinder", "capsule" or "sphere".
        pose: (4, 4) of its centre; a cylinder's or capsule's axis is z, m.
        sizes: A box's three sides; radius and length of a cylinder, radius and length of a
            capsule's straight part, a sphere's radius; m.
    """

    kind: str
    pose: Array
    sizes: tuple[float, ...]

    @property
    def volume(self) -> float:
        """Volume, m³."""
        if self.kind == "box":
            return math.prod(self.sizes)
        radius, length = (*self.sizes, 0.0)[:2]
        ends = 0.0 if self.kind == "cylinder" else 4 / 3 * math.pi * radius**3
        return math.pi * radius**2 * length + ends


@dataclass(frozen=True)
class Fit:
    """The shapes around a mesh.

    Attributes:
        shapes: Together they contain the whole mesh.
        corners: (K, 3) the corners of its convex hull, m.
        hull_volume: The volume of that hull, m³.
    """

    shapes: tuple[Shape, ...]
    corners: Array
    hull_volume: float

    @property
    def ratio(self) -> float:
        """Volume of the shapes, with overlaps counted twice, divided by that of the convex hull."""
        return sum(shape.volume for shape in self.shapes) / max(self.hull_volume, 1e-12)


def capsule(start: Array, end: Array, radius: float) -> Shape:
    """The capsule around the line between two points (3,), m."""
    along = end - start
    length = float(np.linalg.norm(along))
    pose = np.eye(4)
    pose[:3, 3] = (start + end) / 2
    if length < ROUNDING:
        return Shape("sphere", pose, (radius,))
    pose[:3, :3] = trimesh.geometry.align_vectors([0, 0, 1], along)[:3, :3]
    return Shape("capsule", pose, (radius, length))


def fitted(mesh: trimesh.Trimesh) -> Fit:
    """Up to `MOST_PARTS` shapes around a mesh.

    First there is one shape around all of it. Then the part whose shape exceeds its hull most is
    cut in two, by the plane that gives the smallest boxes, as long as this pays off.
    """
    corners, volume = _hull(mesh.vertices)
    cut = len(mesh.faces) <= MOST_CUT or 2 * len(corners) <= MOST_CUT
    if cut and len(mesh.faces) > MOST_CUT:
        mesh = trimesh.convex.convex_hull(corners)
    parts = [(_shape(corners), volume, mesh)]
    whole: list[tuple[Shape, float, trimesh.Trimesh]] = []
    while cut and parts and len(parts) + len(whole) < MOST_PARTS:
        parts.sort(key=lambda part: part[0].volume - part[1])
        worst = parts.pop()
        pieces = _cut(worst[2])
        hulls = [_hull(piece.vertices) for piece in pieces]
        made = [(_shape(hull[0]), hull[1], p) for hull, p in zip(hulls, pieces, strict=True)]
        worth = sum(shape.volume for shape, *_ in made) <= WORTH * worst[0].volume
        (parts if made and worth else whole).extend(made if made and worth else [worst])
    return Fit(tuple(shape for shape, *_ in (*whole, *parts)), corners, volume)


def _hull(points: Array) -> tuple[Array, float]:
    """Corners (K, 3) of the convex hull of points, and its volume; of flat ones, of a box."""
    middle, axes, extent = _principal(points)
    if extent.min() >= THIN:
        try:
            hull = ConvexHull(points)
            return points[hull.vertices], float(hull.volume)
        except QhullError:
            pass  # such as a million points in a plane, but for rounding
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    half = np.maximum(extent, max(THIN, extent.max() / MAX_FLATNESS)) / 2
    return middle + (signs * half) @ axes.T, float(8 * half.prod())


def _principal(points: Array) -> tuple[Array, Array, Array]:
    """Middle (3,), axes as columns (3, 3) and sides (3,) of the box along the principal axes."""
    centre = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - centre).T) if len(points) > 1 else np.eye(3))
    local = (points - centre) @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    return centre + axes @ ((low + high) / 2), axes, high - low


def _shape(corners: Array) -> Shape:
    """The shape of the least volume that is found around the corners (K, 3) of a hull."""
    few = _outermost(corners)
    axes, long = _box_axes(few)
    found = [_box(corners, axes)]
    for turned in (_cylinder_axes(few), np.roll(axes, 2 - long, axis=1)):
        found.extend(_round(corners, turned) if turned is not None else ())
    return min(found, key=lambda shape: shape.volume)


def _outermost(corners: Array) -> Array:
    """The corners that are farthest in some of many evenly spread directions."""
    if len(corners) <= SEARCHED:
        return corners
    z = 1 - (2 * np.arange(SEARCHED) + 1) / SEARCHED
    turn = np.arange(SEARCHED) * math.pi * (3 - math.sqrt(5))
    across = np.sqrt(1 - z**2)
    ways = np.stack([across * np.cos(turn), across * np.sin(turn), z])
    return corners[np.unique([int((corners @ way).argmax()) for way in ways.T])]


def _box_axes(points: Array) -> tuple[Array, int]:
    """Axes as columns (3, 3) of the least box around points, and which of its sides is longest."""
    try:
        to_box, sides = trimesh.bounds.oriented_bounds(points)
        return np.linalg.inv(to_box)[:3, :3], int(np.argmax(sides))
    except (QhullError, ValueError):
        _, axes, extent = _principal(points)
        return _right_handed(axes), int(np.argmax(extent))


def _cylinder_axes(points: Array) -> Array | None:
    """Axes (3, 3) of the least cylinder around points, along z, if one is found."""
    try:
        found = trimesh.bounds.minimum_cylinder(points)
    except (QhullError, ValueError, IndexError):
        return None
    return np.asarray(found["transform"], dtype=np.float64)[:3, :3]


def _box(points: Array, axes: Array) -> Shape:
    """The box along axes around points."""
    local = points @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    sides = high - low
    sides = np.maximum(sides, max(THIN, sides.max() / MAX_FLATNESS)) + 2 * ROUNDING
    return Shape("box", _pose(axes, (low + high) / 2), tuple(sides.tolist()))


def _round(points: Array, axes: Array) -> tuple[Shape, Shape]:
    """The cylinder and the capsule, a sphere if it is short, around points, along the axes' z."""
    local = points @ axes
    centre = _circle(local[:, :2])
    away, height = np.linalg.norm(local[:, :2] - centre, axis=1), local[:, 2]
    radius = max(float(away.max()), THIN / 2) + ROUNDING
    low, high = float(height.min()), float(height.max())
    length = max(high - low, THIN) + 2 * ROUNDING
    middle = np.array([*centre, (low + high) / 2])
    cylinder = Shape("cylinder", _pose(axes, middle), (radius, length))
    bulge = np.sqrt((radius**2 - away**2).clip(min=0))
    low, high = float((height + bulge).min()), float((height - bulge).max())
    middle = np.array([*centre, (low + high) / 2])
    if high - low > THIN:
        capsule = Shape("capsule", _pose(axes, middle), (radius, high - low + 2 * ROUNDING))
        return cylinder, capsule
    ball = float(np.linalg.norm(local - middle, axis=1).max()) + ROUNDING
    return cylinder, Shape("sphere", _pose(axes, middle), (ball,))


def _circle(points: Array) -> Array:
    """The centre (2,) of the least circle around points (V, 2)."""
    try:
        centre, _ = trimesh.nsphere.minimum_nsphere(_outermost_flat(points))
        return np.asarray(centre, dtype=np.float64)
    except (QhullError, ValueError, IndexError):
        return (points.min(axis=0) + points.max(axis=0)) / 2


def _outermost_flat(points: Array) -> Array:
    turn = np.linspace(0, math.tau, SEARCHED, endpoint=False)
    found = (points @ np.stack([np.cos(turn), np.sin(turn)])).argmax(axis=0)
    return points[np.unique(found)]


def _pose(axes: Array, middle: Array) -> Array:
    """(4, 4) of axes as columns, with its origin at a point in their coordinates."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, axes @ middle
    return pose


def _right_handed(axes: Array) -> Array:
    return np.array([1.0, 1.0, np.sign(np.linalg.det(axes))]) * axes


def _cut(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The two pieces of a mesh with the smallest boxes along its own axes; none if it fails."""
    axes, _ = _box_axes(_outermost(_hull(mesh.vertices)[0]))
    local = mesh.vertices @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    least, where = math.inf, (0, 0.0)
    for axis in np.flatnonzero(high - low > THIN).tolist():
        for at in (low[axis] + share * (high[axis] - low[axis]) for share in CUTS):
            sides = _sides(local, mesh.edges_unique, axis, at)
            total = sum(float(np.ptp(side, axis=0).clip(min=THIN).prod()) for side in sides)
            if total < least:
                least, where = total, (axis, at)
    if not math.isfinite(least):
        return []
    normal = axes[:, where[0]]
    pieces = [mesh.slice_plane(normal * where[1], sign * normal) for sign in (1, -1)]
    return [] if any(piece is None or not len(piece.faces) for piece in pieces) else pieces


def _sides(local: Array, edges: NDArray[np.int64], axis: int, at: float) -> tuple[Array, Array]:
    """The points on both sides of a plane, including those where edges cross it."""
    above = local[:, axis] >= at
    crossing = edges[above[edges[:, 0]] != above[edges[:, 1]]]
    start, end = local[crossing[:, 0]], local[crossing[:, 1]]
    share = (at - start[:, axis]) / (end - start)[:, axis]
    points = start + share[:, None] * (end - start)
    return np.concatenate([local[above], points]), np.concatenate([local[~above], points])
