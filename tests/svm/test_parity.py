"""SVC, SVR and Platt's sigmoid against scikit-learn, on public data sets and on the tabletop."""

import warnings

import numpy as np
import pytest
import sklearn.svm
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.calibration import CalibratedClassifierCV
from sklearn.datasets import (
    load_breast_cancer,
    load_diabetes,
    load_digits,
    load_iris,
    load_linnerud,
    load_wine,
)
from sklearn.model_selection import StratifiedKFold
from stand_in import labelled, transitions
from support import seeded

from cgtorch.svm import SVC, SVR
from cgtorch.svm.platt import fit_platt, probability

SLOPE, OFFSET = torch.tensor(-1.7), torch.tensor(0.2)


def _scaled(x):
    return (x - x.mean(0)) / np.where(x.std(0) > 0, x.std(0), 1)


def _split(x, y, count):
    """Rows to train on, and 1,000 or more others: those held out, and shaken copies of all."""
    rng = np.random.default_rng(0)
    order = rng.permutation(len(x))
    train, fresh = order[:count], order[count:]
    copies = x[rng.integers(0, len(x), 1000)]
    shaken = copies + 0.3 * x.std(0) * rng.standard_normal(copies.shape)
    return x[train], y[train], np.concatenate([x[fresh], shaken])


def _classification(name):
    if name == "digits":
        x, y = load_digits(return_X_y=True)
        keep = np.isin(y, [3, 5, 8])
        return _split(x[keep] / 16, (y[keep] == 8).astype(int), 300)
    if name == "tabletop":
        x, y = labelled(900)
    elif name == "breast cancer":
        x, y = load_breast_cancer(return_X_y=True)
    else:
        x, y = {"wine": load_wine, "iris": load_iris}[name](return_X_y=True)
        y = (y == 1).astype(int)
    return _split(_scaled(x), y, 120 if name in ("wine", "iris") else 400)


def _regression(name):
    if name == "diabetes":
        return _split(*map(_scaled, load_diabetes(return_X_y=True)), 300)
    if name == "digits":
        x, y = load_digits(return_X_y=True)
        return _split(x[:600] / 16, y[:600] / 9.0, 300)
    p, u, q = transitions(600)
    x = np.concatenate([p, u[:, :2], np.sin(u[:, 2:]), np.cos(u[:, 2:])], 1)
    return _split(_scaled(x), _scaled(q[:, 0]), 400)


def _platt(model, x, y, folds):
    """Platt parameters by the decision values of held-out rows."""
    value = np.zeros(len(x))
    for train, test in folds:
        value[test] = model.fit(x[train], y[train]).decision_function(x[test])
    return torch.stack(fit_platt(torch.tensor(value), torch.tensor(y) - 0.5))


def _coefficients(model, rows):
    """The dual coefficients of a fitted scikit-learn or cgtorch model."""
    beta = np.zeros(rows)
    if isinstance(model, SVC | SVR):
        beta[model.support] = model.weights[:, 0]
    else:
        beta[model.support_] = np.ravel(model.dual_coef_)
    return beta


def _objective(model, gram, z, epsilon):
    """The dual function, without its sign, of a fitted scikit-learn or cgtorch model."""
    beta = _coefficients(model, len(gram))
    return 0.5 * beta @ gram @ beta - z @ beta + epsilon * np.abs(beta).sum()


def _gram(x, gamma):
    return np.exp(-gamma * ((x[:, None] - x[None]) ** 2).sum(-1))


def _violation(model, gram, z, C):
    """How far a classifier is from the optimality conditions, computed in double precision.

    libsvm keeps its kernel values in single precision, so that it is about 1e-6 away from them,
    whatever tolerance it is given.
    """
    beta = _coefficients(model, len(gram))
    residual = z - gram @ beta
    can_rise = beta < np.where(z > 0, C, 0) - 1e-9 * C
    can_fall = beta > np.where(z < 0, -C, 0) + 1e-9 * C
    return residual[can_rise].max() - residual[can_fall].min()


@pytest.mark.parametrize("C", [0.3, 10.0])
@pytest.mark.parametrize("name", ["breast cancer", "wine", "iris", "digits", "tabletop"])
def test_classifier_matches_libsvm(name, C):
    x, y, fresh = _classification(name)
    gamma = 1 / (x.shape[1] * x.var())
    folds = list(StratifiedKFold(5, shuffle=True, random_state=0).split(x, y))
    theirs = sklearn.svm.SVC(C=C, gamma=gamma, tol=1e-8).fit(x, y)
    ours = SVC(C).fit(x, y)
    ours.platt = _platt(SVC(C, gamma=gamma), x, y, folds)

    gram, z = _gram(x, gamma), np.where(y > 0, 1.0, -1.0)
    best = _objective(theirs, gram, z, 0.0)
    assert abs(_objective(ours, gram, z, 0.0) - best) <= 1e-4 * abs(best)
    assert float(ours.gap) <= 1e-4 * abs(best)
    decision = theirs.decision_function(fresh)
    assert len(fresh) >= 1000
    assert np.abs(ours.decision_function(fresh) - decision).max() <= 1e-3 * np.abs(decision).max()
    assert np.mean(ours.predict(fresh) == theirs.predict(fresh)) >= 0.999

    base = sklearn.svm.SVC(C=C, gamma=gamma, tol=1e-8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        oracle = CalibratedClassifierCV(base, ensemble=False, cv=folds).fit(x, y)
    chance = oracle.predict_proba(fresh)
    own_error = _violation(theirs, gram, z, C)
    assert _violation(ours, gram, z, C) <= 1e-6 * C
    mine = ours(torch.tensor(fresh)).numpy()
    assert np.abs(mine - chance[:, 1]).max() <= 1e-6 + own_error
    assert np.ptp(chance[:, 1]) > 0.5  # otherwise the comparison would say nothing


@pytest.mark.parametrize("C", [0.3, 10.0])
@pytest.mark.parametrize("name", ["diabetes", "digits", "tabletop"])
def test_regression_matches_libsvm(name, C):
    x, y, fresh = _regression(name)
    gamma = 1 / (x.shape[1] * x.var())
    theirs = sklearn.svm.SVR(C=C, epsilon=0.05, tol=1e-6).fit(x, y)
    ours = SVR(C, epsilon=0.05).fit(x, y)
    gram = _gram(x, gamma)
    best = _objective(theirs, gram, y, 0.05)
    assert abs(_objective(ours, gram, y, 0.05) - best) <= 1e-4 * abs(best)
    assert float(ours.gap) <= 1e-4 * abs(best)
    value = theirs.predict(fresh)
    assert len(fresh) >= 1000
    assert np.abs(ours.predict(fresh) - value).max() <= 1e-3 * np.ptp(value)


@pytest.mark.parametrize("name", ["linnerud", "iris", "tabletop"])
def test_several_outputs_match_one_libsvm_each(name):
    if name == "linnerud":
        x, y, fresh = _split(*map(_scaled, load_linnerud(return_X_y=True)), 15)
    elif name == "iris":  # two measures of a flower from the two others
        x = _scaled(load_iris(return_X_y=True)[0])
        x, y, fresh = _split(x[:, :2], x[:, 2:], 100)
    else:
        p, u, q = transitions(400)
        x, y, fresh = _split(_scaled(np.concatenate([p, u], 1)), _scaled(q[:, :6]), 300)
    value = SVR(2.0, epsilon=0.1).fit(x, y).predict(fresh)
    for k, target in enumerate(y.T):
        oracle = sklearn.svm.SVR(C=2.0, epsilon=0.1, tol=1e-7).fit(x, target).predict(fresh)
        assert np.abs(value[:, k] - oracle).max() <= 1e-3 * np.ptp(oracle)


def test_outputs_share_centres_and_each_is_its_own_machine():
    p, u, q = transitions(200)
    x, y = _scaled(np.concatenate([p, u], 1)), _scaled(q)
    together = SVR([1.0, 2.0, 4.0], epsilon=[0.1, 0.2, 0.4]).fit(x, y[:, :3])
    value = together.predict(x)
    for k, (cap, tube) in enumerate([(1.0, 0.1), (2.0, 0.2), (4.0, 0.4)]):
        alone = SVR(cap, epsilon=tube).fit(x, y[:, k])
        assert np.abs(alone.predict(x) - value[:, k]).max() < 1e-5
        assert set(alone.support.tolist()) <= set(together.support.tolist())


@given(first=st.integers(0, 499), count=st.integers(1, 100))
def test_a_decision_has_the_same_probability_in_every_batch(first, count):
    decision = torch.linspace(-9, 9, 600)
    part = slice(first, first + count)
    whole = probability(decision, SLOPE, OFFSET)
    assert torch.equal(probability(decision[part], SLOPE, OFFSET), whole[part])


def test_probability_is_the_formula_and_rises_with_the_decision():
    decision = torch.linspace(-40, 40, 81, dtype=torch.float64)
    chance = probability(decision, SLOPE.double(), OFFSET.double())
    torch.testing.assert_close(chance, 1 / (1 + torch.exp(SLOPE * decision + OFFSET)))
    assert (chance.diff() >= 0).all()


@given(st.floats(0.3, 5), st.floats(-1, 1), st.integers(0, 20))
@settings(max_examples=20)
def test_the_fit_finds_the_curve_that_labels_were_drawn_from(slope, offset, seed):
    decision, chance = torch.rand(2, 20_000, generator=seeded(seed))
    decision = 4 * decision - 2
    signs = torch.where(chance < torch.sigmoid(slope * decision - offset), 1.0, -1.0)
    found, shift = fit_platt(decision, signs)
    assert abs(float(found) + slope) < 0.3
    assert abs(float(shift) - offset) < 0.15


def test_separable_decisions_give_finite_parameters():
    signs = torch.tensor([-1.0] * 5 + [1.0] * 5)
    slope, offset = fit_platt(signs * 1e6, signs)
    chance = probability(signs * 1e6, slope, offset)
    assert torch.isfinite(torch.stack([slope, offset])).all()
    assert (chance[:5] < 0.2).all()
    assert (chance[5:] > 0.8).all()
