"""Medians, quartiles and a paired test of few numbers."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """First quartile, median and third quartile."""
    low, middle, high = np.quantile(np.asarray(values, dtype=float), [0.25, 0.5, 0.75])
    return float(low), float(middle), float(high)


def signed_rank(differences: Sequence[float]) -> float:
    """Two-sided p of Wilcoxon's signed-rank test, exact, also with ties.

    Differences of 0 are left out; all signs of the others are equally likely under the null
    hypothesis, and all 2^n of them are tried, so n is at most 20.
    """
    kept = np.asarray([d for d in differences if d != 0], dtype=float)
    if len(kept) == 0:
        return 1.0
    if len(kept) > 20:
        raise ValueError(f"{len(kept)} differences; give at most 20")
    ranks = midranks(np.abs(kept))
    signs = np.array(list(product((0.0, 1.0), repeat=len(kept))))
    centre = ranks.sum() / 2
    seen = abs(ranks[kept > 0].sum() - centre)
    return float((np.abs(signs @ ranks - centre) >= seen - 1e-9).mean())


def midranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks from 1, equal values sharing the mean of theirs."""
    below = (values[:, None] > values).sum(1)
    equal = (values[:, None] == values).sum(1)
    ranks: NDArray[np.float64] = below + (equal + 1) / 2
    return ranks
