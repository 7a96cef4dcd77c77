"""Confidence intervals of shares."""

from math import sqrt
from statistics import NormalDist


def wilson(successes: int, tried: int, confidence: float) -> tuple[float, float]:
    """The two-sided confidence interval of a share (Wilson 1927).

    Without tries, it is that of one failure.
    """
    n, z = max(1, tried), NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / n
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z * sqrt(rate * (1 - rate) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(0.0, centre - half), min(1.0, centre + half)
