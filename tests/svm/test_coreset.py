"""Fewer rows: which stay, and how well they cover the others."""

from itertools import combinations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.errors import SettingsError
from cgtorch.svm.coreset import coreset


@given(st.integers(1, 40), st.integers(1, 45), st.integers(0, 2**31))
def test_what_stays(count, limit, seed):
    rows = torch.randn(count, 3, generator=seeded(seed))
    keep = torch.rand(count, generator=seeded(seed)) < 0.3
    chosen = coreset(rows, keep, limit).tolist()
    assert chosen == sorted(set(chosen))
    assert len(chosen) == min(count, limit)
    wanted = set(keep.nonzero().flatten().tolist())
    assert wanted <= set(chosen) or set(chosen) <= wanted


@given(st.integers(2, 9), st.integers(1, 3), st.integers(0, 2**31))
def test_no_row_is_left_farther_out_than_twice_the_best_choice(count, limit, seed):
    rows = torch.randn(count, 2, dtype=torch.float64, generator=seeded(seed))

    def radius(kept):
        return float(torch.cdist(rows, rows[list(kept)]).amin(1).max())

    best = min(radius(kept) for kept in combinations(range(count), min(limit, count)))
    chosen = coreset(rows, torch.zeros(count, dtype=torch.bool), limit).tolist()
    assert radius(chosen) <= 2 * best + 1e-12


def test_a_limit_below_one_is_refused():
    with pytest.raises(SettingsError, match="limit is 0"):
        coreset(torch.zeros(3, 2), torch.zeros(3, dtype=torch.bool), 0)
