"""Plain planar geometry, one rectangle at a time, that knows nothing of the project's own."""

import math
from collections.abc import Sequence

from shapely import Polygon, affinity, box

Numbers = Sequence[float]


def polygon(rectangle: Numbers) -> Polygon:
    """A rectangle: centre x, y, yaw, sizes."""
    x, y, yaw, sx, sy = rectangle[:5]
    flat = box(-sx / 2, -sy / 2, sx / 2, sy / 2)
    return affinity.translate(affinity.rotate(flat, yaw, origin=(0, 0), use_radians=True), x, y)


def plain_point(pose: Numbers, point: Numbers) -> tuple[float, float]:
    """A point as seen from a pose."""
    dx, dy, c, s = point[0] - pose[0], point[1] - pose[1], math.cos(pose[2]), math.sin(pose[2])
    return c * dx + s * dy, c * dy - s * dx


def plain_box(pose: Numbers, rectangle: Numbers) -> list[float]:
    """The least and largest x and y of a rectangle's corners, seen from a pose."""
    corners = polygon(rectangle).exterior.coords[:4]
    xs, ys = zip(*(plain_point(pose, corner) for corner in corners), strict=True)
    return [min(xs), max(xs), min(ys), max(ys)]


def plain_percept(pose: Numbers, table: Numbers, placed: Numbers) -> list[float]:
    """The paper's seven numbers."""
    return [*plain_box(pose, table), *plain_point(pose, placed), table[5]]


def driven(pose: Numbers, motion: Numbers) -> Numbers:
    """The pose after a motion in the robot's own frame: drive, then turn."""
    (x, y, theta), (dx, dy, turn) = pose, motion
    c, s = math.cos(theta), math.sin(theta)
    return x + c * dx - s * dy, y + s * dx + c * dy, theta + turn
