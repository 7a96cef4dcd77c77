"""A small stand-in for a robot that sees a table: transitions and labels with 5 mm of noise."""

import numpy as np

DEPTH, WIDTH = 0.8, 1.2


def _rim(rng, count, low, high):
    """Points at a distance inside (negative) or outside each of the four edges, and outward."""
    side, along = rng.integers(0, 4, count), rng.uniform(-0.9, 0.9, count)
    angle = np.array([np.pi, 0, -np.pi / 2, np.pi / 2])[side]
    half = np.where(side < 2, DEPTH, WIDTH) / 2 + rng.uniform(low, high, count)
    other = np.where(side < 2, WIDTH, DEPTH) / 2 * along
    x = np.cos(angle) * half - np.sin(angle) * other
    y = np.sin(angle) * half + np.cos(angle) * other
    return x, y, angle


def _percept(rng, rx, ry, theta, ox, oy, noise):
    cos, sin = np.cos(theta), np.sin(theta)

    def seen(x, y):
        return cos * (x - rx) + sin * (y - ry), cos * (y - ry) - sin * (x - rx)

    (cx, cy), (px, py) = seen(0, 0), seen(ox, oy)
    w = DEPTH * np.abs(cos) + WIDTH * np.abs(sin)
    h = DEPTH * np.abs(sin) + WIDTH * np.abs(cos)
    box = [cx - w / 2, cx + w / 2, cy - h / 2, cy + h / 2, px, py, np.full_like(px, 0.78)]
    return np.stack(box, -1) + noise * rng.standard_normal((len(rx), 7))


def transitions(count, seed=0, noise=0.005):
    """Percepts (n, 7), motions (n, 3) and next percepts (n, 7)."""
    rng = np.random.default_rng(seed)
    rx, ry, angle = _rim(rng, count, 0.5, 1.1)
    theta = angle + np.pi + rng.uniform(-1, 1, count)
    ox, oy, _ = _rim(rng, count, -0.15, -0.05)
    u = rng.uniform([-0.6, -0.6, -np.pi], [0.6, 0.6, np.pi], (count, 3))
    p = _percept(rng, rx, ry, theta, ox, oy, noise)
    x = rx + np.cos(theta) * u[:, 0] - np.sin(theta) * u[:, 1]
    y = ry + np.sin(theta) * u[:, 0] + np.cos(theta) * u[:, 1]
    return p, u, _percept(rng, x, y, theta + u[:, 2], ox, oy, noise)


def labels(p):
    """1 where the object is in reach, ahead, and near the box's front side (n,)."""
    reach, angle = np.hypot(p[:, 4], p[:, 5]), np.arctan2(p[:, 5], p[:, 4])
    near = p[:, 4] - p[:, 0] < 0.3
    return ((reach > 0.4) & (reach < 0.95) & (np.abs(angle) < 0.9) & near).astype(int)


def labelled(count, seed=0):
    """Percepts (n, 7) and labels (n,), a third of them positive."""
    p, _, _ = transitions(12 * count, seed)
    y = labels(p)
    keep = np.concatenate([np.flatnonzero(y)[: count // 3], np.flatnonzero(y == 0)])[:count]
    return p[keep], y[keep]
