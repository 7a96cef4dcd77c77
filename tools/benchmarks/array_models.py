"""Γ and C in NumPy and scikit-learn, for any number of rows at once."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.plain_models import Array, PlainModels, sklearn_svc, sklearn_svr
from cgtorch.tabletop.world.clear_motion import MAX_TRANSLATION, TURN_STEP

Mask = NDArray[np.bool_]
TURNS = math.ceil(math.pi / TURN_STEP)


class ArrayModels:
    """`PlainModels` for rows (n, 7) of percepts and (n, 3) of motions."""

    def __init__(self, models: PlainModels):
        self.models = models
        self.svr: Any = sklearn_svr(models.transition)
        self.svc: Any = sklearn_svc(models.success)
        self.radius = float(np.hypot(*models.body.T).max())
        centres = models.transition.centres
        self.squares = (centres * centres).sum(1)

    def success(self, percept: Array) -> Array:
        """C(p), (n,)."""
        placed = percept[:, 4:6]
        far = np.maximum(np.hypot(*placed.T), 1e-6)[:, None]
        parts = 0.5 * np.tanh(percept[:, :4] / 0.5), 4 * far, 2 * placed / far, 3 * percept[:, 6:7]
        machine = self.models.success
        features = np.concatenate(parts, 1)[:, : len(machine.mean)]
        slope, offset = self.models.platt
        decision = self.svc.decision_function((features - machine.mean) / machine.scale)
        return sigmoid(-(slope * decision + offset))

    def gamma(self, percept: Array, motion: Array) -> tuple[Array, Array]:
        """Γ(p, u): the next percepts (n, 7), and the novelty (n,) of each motion."""
        models, (a, b) = self.models, self.models.sides
        low, high, placed = percept[:, 0:4:2], percept[:, 1:4:2], percept[:, 4:6]
        centre, extent, turn = (low + high) / 2, high - low, motion[:, 2]
        w, h = extent.T
        sine = np.maximum((w * w + h * h - a * a - b * b) / (2 * a * b), 0)
        yaw = np.arctan2(sine, (h * h - w * w) / max(b * b - a * a, 1e-9)) / 2
        u, v = (placed - centre).T
        yaw = np.where(u * v < 0, -yaw, yaw)
        c, s = np.cos(yaw), np.sin(yaw)
        places = np.abs([c * u + s * v, c * v - s * u, c * u - s * v, c * v + s * u]).T
        rows = (places - models.transition.mean) / models.transition.scale
        value = self.svr.predict(rows)
        inner = self.squares - 2 * rows @ models.transition.centres.T
        distance = np.maximum(inner.min(1) + (rows * rows).sum(1), 0)
        misfit = extent - turned(yaw, a, b)
        extremes = [np.hypot(*x) for x in (placed.T, motion[:, :2].T, misfit.T)]
        extremes.insert(2, np.abs(turn))
        beyond = np.maximum(np.stack(extremes, 1) / models.most - 1, 0).sum(1)
        novelty = 1 - np.exp2(-(distance / models.reach + beyond / 0.1))
        first, second = turned(yaw - turn, a, b), turned(-yaw - turn, a, b)
        weight = np.sin(np.pi / 2 * np.clip(value, -1, 1))[:, None] / 2
        gap = (w - h) * np.cos(2 * turn)
        loose = np.stack([w + h + gap, w + h - gap], 1) / 2
        half = (first + second) / 2 + weight * (first - second)
        half = (loose + models.trust * (half - loose)) / 2
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        centre, placed = (
            c * (xy - motion[:, :2]) + s * (xy - motion[:, :2])[:, ::-1] * [1, -1]
            for xy in (centre, placed)
        )
        box = np.stack([centre - half, centre + half], 2).reshape(-1, 4)
        return np.concatenate([box, placed, percept[:, 6:]], 1), novelty

    def possible(self, percept: Array, motion: Array) -> Mask:
        """(n,) whether the base can drive and turn so without touching the table's box."""
        x0, x1, y0, y1 = box = percept[:, :4].T
        dx, dy, turn = motion.T
        free = (np.hypot(dx, dy) <= MAX_TRANSLATION) & np.isfinite(turn)
        there = (x1 > x0) & (y1 > y0)
        body = np.broadcast_to(self.models.body, (len(motion), 4, 2))
        swept = np.concatenate([body, body + motion[:, None, :2]], 1)
        hit = overlap(swept, box, np.stack([-dy, dx], 1)[:, None])
        gap = np.maximum(np.maximum([x0 - dx, y0 - dy], [dx - x1, dy - y1]), 0)
        near = free & there & ~hit & (np.hypot(*gap) < self.radius) & (turn != 0)
        (rows,) = near.nonzero()
        if len(rows):
            angle = (turn[rows, None] + np.pi) % (2 * np.pi) - np.pi
            angle = angle * np.linspace(1 / TURNS, 1, TURNS)
            c, s = np.cos(angle), np.sin(angle)
            x, y = self.models.body.T
            at = motion[rows, None, None, :2] + np.stack(
                [c[..., None] * x - s[..., None] * y, s[..., None] * x + c[..., None] * y], -1
            )
            axes = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
            hit[rows] = overlap(at, box[:, rows, None], axes).any(1)
        return np.asarray(free & ~(there & hit))


def overlap(polygon: Array, box: Array, axes: Array) -> Mask:
    """(...) whether convex polygons (..., V, 2) and boxes (4, ...) overlap.

    `axes` (..., K, 2) are the polygons' own normals.
    """
    x0, x1, y0, y1 = box
    low, high = polygon.min(-2), polygon.max(-2)
    apart = (high[..., 0] < x0) | (x1 < low[..., 0]) | (high[..., 1] < y0) | (y1 < low[..., 1])
    along = polygon @ axes.swapaxes(-1, -2)
    centre = np.stack([x0 + x1, y0 + y1], -1)[..., None, :] / 2
    half = np.stack([x1 - x0, y1 - y0], -1)[..., None, :] / 2
    middle, reach = (axes * centre).sum(-1), (np.abs(axes) * half).sum(-1)
    aside = (along.max(-2) < middle - reach) | (middle + reach < along.min(-2))
    return np.asarray(~(apart | aside.any(-1)))


def turned(yaw: Array, a: float, b: float) -> Array:
    """Extents (n, 2) of the boxes of rectangles of sides a and b (m), the first along x at 0."""
    c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    return np.stack([a * c + b * s, a * s + b * c], 1)


def sigmoid(x: Array) -> Array:
    """The logistic function, which saturates where its exponential would overflow."""
    return 1 / (1 + np.exp(np.minimum(-x, 700.0)))
