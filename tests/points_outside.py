"""How far points are from fitted shapes."""

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
