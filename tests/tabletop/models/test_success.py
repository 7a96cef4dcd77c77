"""C: accurate, calibrated, differentiable, and honest about both."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from random_models import first_percepts, random_classifier
from stand_in import labelled, labels, transitions

from cgtorch.domains.success import calibration, fit_success_classifier
from cgtorch.ground.errors import DataError
from cgtorch.native import available
from cgtorch.svm import fit_reduced_set
from cgtorch.tabletop.models import GraspClassifier

GRID = {"C": [8.0, 64.0], "gamma": [0.03, 0.1]}


@pytest.fixture(scope="module")
def fitted():
    return fit_success_classifier(GraspClassifier(), *labelled(900, 1), **GRID)


def compacted(model, centres, x):
    """A classifier of fewer centres that says nearly the same of percepts (n, D)."""
    small = deepcopy(model)
    small.machine = fit_reduced_set(model.machine, centres, model.features(x))
    return small


def test_it_is_right_on_fresh_percepts_and_its_report_says_how_often(fitted):
    model, report = fitted
    x, y = labelled(2000, 2)
    chance = model(torch.tensor(x)).numpy()
    right = (chance > 0.5) == (y > 0)
    balanced = (right[y > 0].mean() + right[y == 0].mean()) / 2
    assert balanced > 0.95
    assert report.balanced_accuracy == pytest.approx(balanced, abs=0.03)
    assert report.brier == pytest.approx(np.mean((chance - y) ** 2), abs=0.02)
    assert report.calibration_error < 0.04
    assert sum(rows for _, _, rows in report.reliability) == report.rows == 900


@pytest.mark.skipif(not available(), reason="there is no C compiler")
@pytest.mark.parametrize(("percept", "obstacles", "seeds"), [("box", 0, (1, 2)), ("yaw", 1, (1,))])
def test_c_is_compiled_for_all_features_that_there_are(percept, obstacles, seeds):
    """Those of a box without the height, with it, and those of a turned table."""
    percepts = first_percepts(1, 20, percept, obstacles)
    for seed in seeds:
        model = random_classifier(seed, percepts)
        assert model.compiled(percepts) is not None
        torch.testing.assert_close(model(percepts), model.predict_in_torch(percepts))
        unknown = deepcopy(model)
        unknown.mean = unknown.mean[:6]
        assert unknown.compiled(percepts) is None
        unknown = deepcopy(model)
        unknown.machine.platt[1] = torch.nan
        assert unknown.compiled(percepts) is None
    other = "yaw" if percept == "box" else "box"
    assert model.compiled(first_percepts(1, 20, other, 0)) is None


def test_gradients_equal_finite_differences():
    x, y = labelled(150, 3)
    model, _ = fit_success_classifier(GraspClassifier(), x, y, dtype=torch.float64, **GRID)
    small = compacted(model, 16, torch.tensor(x))
    x = torch.tensor(labelled(4, 4)[0], requires_grad=True)
    assert torch.autograd.gradcheck(model, (x,))
    assert torch.autograd.gradcheck(small, (x,))


def test_percepts_of_any_shape_but_of_a_tabletop(fitted):
    x, y = labelled(150, 5)
    model, _ = fitted
    assert model(torch.tensor(x).reshape(3, 50, 7)).shape == (3, 50)
    with pytest.raises(DataError, match="a percept has 2 numbers; give 7"):
        model(torch.tensor(x[:, 4:6]))
    with pytest.raises(DataError, match="a percept has 2 numbers; give 7"):
        fit_success_classifier(GraspClassifier(), x[:, 4:6], y, **GRID)


def test_one_class_and_tiny_data_are_refused():
    x, _ = labelled(60, 6)
    with pytest.raises(DataError, match="1 classes"):
        fit_success_classifier(GraspClassifier(), x, np.ones(60))
    with pytest.raises(DataError, match="one class has 1 rows, fewer than the 2 folds"):
        fit_success_classifier(GraspClassifier(), x[:22], np.arange(22) < 1, **GRID)


def test_learning_on_improves(fitted):
    x, y = labelled(700, 7)
    order = np.random.default_rng(0).permutation(700)
    x, y = x[order], y[order]
    start, _ = fit_success_classifier(GraspClassifier(), x[:120], y[:120], **GRID)
    grown = start.updated(x, y)
    fresh, _, _ = transitions(6000, 8)
    truth = torch.tensor(labels(fresh)) > 0
    wrong = [
        float(((m(torch.tensor(fresh)) > 0.5) != truth).double().mean()) for m in (start, grown)
    ]
    assert wrong[1] < wrong[0]


def test_a_compact_classifier_keeps_its_probabilities(fitted):
    model, _ = fitted
    x = torch.tensor(labelled(900, 1)[0])
    small = compacted(model, 64, x)
    assert len(small.machine.centres) <= 64
    fresh = torch.tensor(labelled(500, 9)[0])
    assert float((small(fresh) - model(fresh)).abs().mean()) < 0.03


def test_calibration_error_counts_what_it_should():
    chance = torch.tensor([0.15, 0.15, 0.95, 0.95])
    error, curve = calibration(chance, torch.tensor([0.0, 0.0, 1.0, 0.0]))
    assert error == pytest.approx(0.5 * 0.15 + 0.5 * 0.45)
    assert [rows for _, _, rows in curve] == [2, 2]
