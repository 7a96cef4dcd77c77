"""Fewer rows: which stay, how well they cover the others, and what is still known."""

from itertools import combinations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded
from tabletop import labelled, transitions

from cgtorch.errors import SettingsError
from cgtorch.tabletop.models import fit_success_classifier, fit_transition_model
from cgtorch.svm import update_success_classifier, update_transition_model
from cgtorch.svm.coreset import coreset, label_coreset, transition_coreset

GRID = {"C": [2.0], "gamma": [1.0], "grid_rows": 300}


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


def test_gamma_errs_no_more_on_the_transitions_left_out():
    data = [torch.tensor(a) for a in transitions(600, 1)]
    model, report = fit_transition_model(*data, dtype=torch.float64, **GRID)
    held_out = sum(report.error[:4]) / 4
    for limit in (report.centres + 50, report.centres // 2):
        kept, start = transition_coreset(model, *data, limit)
        assert len(kept) == limit
        after = update_transition_model(start, *(a[kept] for a in data))
        out = np.setdiff1d(np.arange(600), kept.numpy())
        before, error = (
            float((m(data[0][out], data[1][out]) - data[2][out]).abs()[:, :4].mean())
            for m in (model, after)
        )
        # With half of the support vectors gone, the rows left out are as fresh ones.
        assert error < (before + 0.0005 if limit > report.centres else 1.1 * held_out)
    everything, same = transition_coreset(model, *data, 600)
    assert len(everything) == 600
    assert same is model


def test_rows_that_are_no_support_vectors_change_nothing():
    data = [torch.tensor(a) for a in transitions(600, 2)]
    model, report = fit_transition_model(*data, dtype=torch.float64, **GRID)
    kept, start = transition_coreset(model, *data, report.centres + 5)
    p, u, _ = (torch.tensor(a) for a in transitions(300, 3))
    assert torch.allclose(start(p, u), model(p, u), atol=1e-9)  # it still has all of them
    after = update_transition_model(start, *(a[kept] for a in data))
    assert float((after(p, u) - model(p, u)).abs().max()) < 1e-3


def test_c_is_no_worse_on_the_labels_left_out():
    x, y = labelled(900, 1)
    order = np.random.default_rng(0).permutation(900)
    x, y = torch.tensor(x[order]), torch.tensor(y[order])
    model, report = fit_success_classifier(
        x, y, C=[8.0], gamma=[0.1], dtype=torch.float64, grid_rows=300
    )
    kept, start = label_coreset(model, x, max(300, report.centres + 50))
    after = update_success_classifier(start, x[kept], y[kept])
    out = np.setdiff1d(np.arange(900), kept.numpy())
    right = [float(((m(x[out]) > 0.5) == (y[out] > 0)).double().mean()) for m in (model, after)]
    assert right[1] > right[0] - 0.005
