"""Shapes of links, and how far points are from them."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from cgtorch.tabletop.kinematics.shapes import Array, Shape


def outside(shape: Shape, points: Array) -> Array:
    """(V,) the distances of points (V, 3) from a shape, m; 0 inside."""
    local = (points - shape.pose[:3, 3]) @ shape.pose[:3, :3]
    if shape.kind == "box":
        away = np.abs(local) - np.array(shape.sizes) / 2
        return np.linalg.norm(away.clip(min=0), axis=1)
    radius, length = (*shape.sizes, 0.0)[:2]
    across, along = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2]) - length / 2
    if shape.kind == "cylinder":
        return np.hypot((across - radius).clip(min=0), along.clip(min=0))
    return (np.hypot(across, along.clip(min=0)) - radius).clip(min=0)


def shapes_of(link: Any, at: Array | None = None) -> Iterator[Shape]:
    """The collision elements of a URDF's link at a pose (4, 4) as shapes."""
    for collision in link.collisions:
        g, origin = collision.geometry, collision.origin
        assert g.mesh is None
        pose = (np.eye(4) if at is None else at) @ (np.eye(4) if origin is None else origin)
        if g.box is not None:
            yield Shape("box", pose, tuple(g.box.size))
        elif g.cylinder is not None:
            yield Shape("cylinder", pose, (g.cylinder.radius, g.cylinder.length))
        else:
            yield Shape("sphere", pose, (g.sphere.radius,))
