"""Γ and C on fewer rows than they were fitted on: what is still known, and how well."""

import numpy as np
import torch
from stand_in import labelled, transitions

from cgtorch.domains.success import fit_success_classifier
from cgtorch.domains.transition import Grid
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.tabletop.models import GraspClassifier, TableTransitionModel

GRID = Grid([2.0], [4.0], [0.1], 300)


def test_gamma_errs_no_more_on_the_transitions_left_out():
    data = [torch.tensor(a) for a in transitions(600, 1)]
    model, report = fit_transition_model(
        TableTransitionModel(), *data, dtype=torch.float64, grid=GRID
    )
    held_out = sum(report.error[:4]) / 4
    for limit in (report.centres + 50, report.centres // 2):
        kept, start = model.coreset(*data, limit=limit)
        assert len(kept) == limit
        after = start.updated(*(a[kept] for a in data))
        out = np.setdiff1d(np.arange(600), kept.numpy())
        before, error = (
            float((m(data[0][out], data[1][out]) - data[2][out]).abs()[:, :4].mean())
            for m in (model, after)
        )
        # With half of the support vectors gone, the rows left out are as fresh ones.
        assert error < (before + 0.0005 if limit > report.centres else 1.1 * held_out)
    everything, same = model.coreset(*data, limit=600)
    assert len(everything) == 600
    assert same is model


def test_rows_that_are_no_support_vectors_change_nothing():
    data = [torch.tensor(a) for a in transitions(600, 2)]
    model, report = fit_transition_model(
        TableTransitionModel(), *data, dtype=torch.float64, grid=GRID
    )
    kept, start = model.coreset(*data, limit=report.centres + 5)
    p, u, _ = (torch.tensor(a) for a in transitions(300, 3))
    assert torch.allclose(start(p, u), model(p, u), atol=1e-9)  # it still has all of them
    after = start.updated(*(a[kept] for a in data))
    assert float((after(p, u) - model(p, u)).abs().max()) < 1e-3


def test_c_is_no_worse_on_the_labels_left_out():
    x, y = labelled(900, 1)
    order = np.random.default_rng(0).permutation(900)
    x, y = torch.tensor(x[order]), torch.tensor(y[order])
    model, report = fit_success_classifier(
        GraspClassifier(), x, y, C=[8.0], gamma=[0.1], dtype=torch.float64, grid_rows=300
    )
    kept, start = model.coreset(x, y, limit=max(300, report.centres + 50))
    after = start.updated(x[kept], y[kept])
    out = np.setdiff1d(np.arange(900), kept.numpy())
    right = [float(((m(x[out]) > 0.5) == (y[out] > 0)).double().mean()) for m in (model, after)]
    assert right[1] > right[0] - 0.005
