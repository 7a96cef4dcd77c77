"""Units, offsets and degenerate data: what scikit-learn says, in whatever unit it is asked."""

import numpy as np
import pytest
import sklearn.svm
import torch

from cgtorch.svm import SVC, SVR

RNG = np.random.default_rng(0)
X = RNG.standard_normal((90, 3))
FRESH = RNG.standard_normal((300, 3))
LABEL = (X[:, 0] + 0.3 * RNG.standard_normal(90) > 0).astype(int)
TARGET = np.sin(2 * X[:, 0]) + 0.1 * RNG.standard_normal(90)
DECISION = sklearn.svm.SVC(C=2.0, tol=1e-8).fit(X, LABEL).decision_function(FRESH)
VALUE = sklearn.svm.SVR(C=2.0, epsilon=0.05, tol=1e-8).fit(X, TARGET).predict(FRESH)


SCALES = [(1e-200, 0.0), (1e-8, 0.0), (1e8, 0.0), (1e200, 0.0), (1.0, 1e8), (1e-3, -5.0)]


@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1e8])
def test_the_unit_of_the_features_changes_nothing(scale):
    ours = SVC(2.0).fit(X * scale, LABEL)
    np.testing.assert_allclose(ours.decision_function(FRESH * scale), DECISION, atol=1e-4)
    ours = SVR(2.0, epsilon=0.05).fit(X * scale, TARGET)
    np.testing.assert_allclose(ours.predict(FRESH * scale), VALUE, atol=1e-4)


@pytest.mark.parametrize(("scale", "offset"), SCALES)
def test_unit_and_offset_of_the_targets_change_nothing(scale, offset):
    model = SVR(2.0 * scale, epsilon=0.05 * scale).fit(X, TARGET * scale + offset)
    values = (model.predict(FRESH) - offset) / scale
    np.testing.assert_allclose(values, VALUE, atol=1e-4)
    assert float(model.gap) <= 1e-3 * scale * scale
    again = model.fit(X, TARGET * scale + offset, warm=True).predict(FRESH)
    np.testing.assert_allclose((again - offset) / scale, values, atol=1e-4)


def test_outputs_may_have_different_units():
    both = np.stack([TARGET * 1e-6, TARGET * 1e6], 1)
    model = SVR([2e-6, 2e6], epsilon=[0.05e-6, 0.05e6]).fit(X, both)
    np.testing.assert_allclose(
        model.predict(FRESH) / [1e-6, 1e6], VALUE[:, None] * [1, 1], atol=1e-4
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_offset_of_the_features_changes_nothing(dtype):
    """Also in float32, where |x|^2 - 2 x'c + |c|^2 alone would be all rounding."""
    offset = 1000.0
    rows = torch.tensor(X + offset).to(dtype)
    fresh = torch.tensor(FRESH + offset).to(dtype)
    plain = SVR(2.0, epsilon=0.05, gamma=0.3).fit(rows.double() - offset, TARGET)
    moved = SVR(2.0, epsilon=0.05, gamma=0.3).fit(rows, TARGET).to(dtype)
    values = moved.predict(fresh).double()
    torch.testing.assert_close(values, plain.predict(fresh.double() - offset), atol=1e-3, rtol=0)
    distance = moved.values_and_distance(fresh)[1].double()
    truth = torch.cdist(fresh.double(), moved.centres.double()).square().amin(1)
    torch.testing.assert_close(distance, truth, atol=1e-3, rtol=1e-3)


def test_features_in_very_different_units_are_what_scikit_learn_makes_of_them():
    scales = np.array([1e-8, 1.0, 1e8])
    oracle = sklearn.svm.SVC(C=2.0, tol=1e-8).fit(X * scales, LABEL)
    ours = SVC(2.0).fit(X * scales, LABEL).decision_function(FRESH * scales)
    np.testing.assert_allclose(ours, oracle.decision_function(FRESH * scales), atol=1e-4)


def test_gamma_scale_of_constant_features_is_one():
    x, y = np.ones((20, 2)), np.arange(20) % 2
    oracle = sklearn.svm.SVC(tol=1e-8).fit(x, y)
    model = SVC().fit(x, y)
    assert float(model.gamma_value) == 1.0
    np.testing.assert_allclose(model.decision_function(x), oracle.decision_function(x), atol=1e-3)


@pytest.mark.parametrize("copies", [2, 5])
def test_duplicated_rows_are_what_scikit_learn_makes_of_them(copies):
    x, y, t = np.tile(X, (copies, 1)), np.tile(LABEL, copies), np.tile(TARGET, copies)
    oracle = sklearn.svm.SVC(C=2.0, tol=1e-8).fit(x, y).decision_function(FRESH)
    np.testing.assert_allclose(SVC(2.0).fit(x, y).decision_function(FRESH), oracle, atol=1e-4)
    oracle = sklearn.svm.SVR(C=2.0, epsilon=0.05, tol=1e-8).fit(x, t).predict(FRESH)
    ours = SVR(2.0, epsilon=0.05).fit(x, t).predict(FRESH)
    np.testing.assert_allclose(ours, oracle, atol=1e-4)


def test_the_same_row_with_both_labels_is_what_scikit_learn_makes_of_it():
    x, y = np.repeat(X[:30], 2, axis=0), np.arange(60) % 2
    oracle = sklearn.svm.SVC(tol=1e-8).fit(x, y).decision_function(FRESH)
    np.testing.assert_allclose(SVC().fit(x, y).decision_function(FRESH), oracle, atol=1e-3)


@pytest.mark.parametrize("cost", [1e-8, 1e-3, 1e3])
def test_extreme_costs(cost):
    oracle = sklearn.svm.SVC(C=cost, tol=1e-9).fit(X, LABEL).decision_function(FRESH)
    ours = SVC(cost).fit(X, LABEL).decision_function(FRESH)
    assert np.abs(ours - oracle).max() <= 1e-3 * max(1.0, np.abs(oracle).max())
    oracle = sklearn.svm.SVR(C=min(cost, 100.0), tol=1e-9).fit(X, TARGET).predict(FRESH)
    ours = SVR(min(cost, 100.0)).fit(X, TARGET).predict(FRESH)
    assert np.abs(ours - oracle).max() <= 1e-3 * max(1.0, np.abs(oracle).max())


def test_a_tube_without_width():
    oracle = sklearn.svm.SVR(C=2.0, epsilon=0.0, tol=1e-8).fit(X, TARGET).predict(FRESH)
    ours = SVR(2.0, epsilon=0.0).fit(X, TARGET).predict(FRESH)
    np.testing.assert_allclose(ours, oracle, atol=1e-3)
