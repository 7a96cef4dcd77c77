"""Learning curves against scikit-learn's, which trains every model by itself."""

import itertools
import json
from dataclasses import asdict

import numpy as np
import pytest
import sklearn.svm
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import KFold, StratifiedKFold
from sklearn.model_selection import learning_curve as oracle
from stand_in import labelled, transitions

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm import SVC, SVR, LearningCurve, doubling_sizes, learning_values
from cgtorch.svm.folds import plain_folds, stratified_folds

SIZES = (20, 47, 160, 240)


def classification():
    x, y = labelled(300)
    order = np.random.default_rng(0).permutation(300)
    return (x[order] - x.mean(0)) / x.std(), y[order]


def regression():
    p, u, q = transitions(300)
    x = np.concatenate([p, u], 1)
    return (x - x.mean(0)) / x.std(0), (q - p)[:, :3]


def numbers_of(folds):
    """The number of the fold that holds out each row, of (train, test) pairs of rows."""
    numbers = np.zeros(sum(len(test) for _, test in folds))
    for number, (_, test) in enumerate(folds):
        numbers[test] = number
    return numbers


@pytest.mark.parametrize("scoring", ["accuracy", "balanced_accuracy"])
def test_classifier_scores_are_those_of_scikit_learn(scoring):
    x, y = classification()
    folds = list(StratifiedKFold(5).split(x, y))
    theirs = sklearn.svm.SVC(C=8.0, gamma=0.3, tol=1e-8)
    sizes, train, test = oracle(theirs, x, y, train_sizes=SIZES, cv=folds, scoring=scoring)
    model = SVC(8.0, gamma=0.3)
    numbers = numbers_of(folds)
    ours = learning_values(model, x, y, sizes=SIZES, folds=numbers).scored(scoring)
    assert ours.sizes == tuple(sizes.tolist()) == SIZES
    np.testing.assert_allclose(ours.train_scores, train, rtol=0, atol=1e-6)
    np.testing.assert_allclose(ours.test_scores, test, rtol=0, atol=1e-6)
    assert not model.fitted


@pytest.mark.parametrize("scoring", ["r2", "neg_mean_absolute_error"])
def test_regression_scores_are_those_of_scikit_learn_on_average(scoring):
    x, y = regression()
    folds = list(KFold(5).split(x))
    wanted = []
    for k, C in enumerate((1.0, 5.0, 20.0)):
        theirs = sklearn.svm.SVR(C=C, gamma=0.2, epsilon=0.05, tol=1e-8)
        wanted.append(oracle(theirs, x, y[:, k], train_sizes=SIZES, cv=folds, scoring=scoring)[1:])
    train, test = np.mean(wanted, 0)
    model = SVR((1.0, 5.0, 20.0), gamma=0.2, epsilon=0.05)
    numbers = numbers_of(folds)
    ours = learning_values(model, x, y, sizes=SIZES, folds=numbers).scored(scoring)
    np.testing.assert_allclose(ours.train_scores, train, rtol=0, atol=2e-6)
    np.testing.assert_allclose(ours.test_scores, test, rtol=0, atol=2e-6)


def test_more_rows_help():
    x, y = classification()
    curve = learning_values(SVC(8.0, gamma=0.3), x, y, sizes=SIZES).scored("accuracy")
    assert np.shape(curve.train_scores) == np.shape(curve.test_scores) == (4, 5)
    assert np.mean(curve.test_scores[-1]) > np.mean(curve.test_scores[0]) + 0.02


def test_the_seed_decides_and_a_report_can_hold_the_curve():
    x, y = classification()
    one, same, other = (
        learning_values(SVC(8.0, gamma=0.3), x, y, sizes=(60, 120), seed=s).scored("accuracy")
        for s in (1, 1, 2)
    )
    assert one == same != other
    plain = json.loads(json.dumps(asdict(one)))
    again = LearningCurve(
        tuple(plain["sizes"]),
        tuple(map(tuple, plain["train_scores"])),
        tuple(map(tuple, plain["test_scores"])),
    )
    assert again == one


@pytest.mark.parametrize("sizes", [(), (0,), (30, 241), (0.5,)])
def test_sizes_that_cannot_be_had(sizes):
    x, y = classification()
    with pytest.raises(SettingsError, match="rows from 1 to 240"):
        learning_values(SVC(), x, y, sizes=sizes)


def test_bad_data_and_scores():
    x, y = classification()
    with pytest.raises(SettingsError, match="scoring is 'auc'"):
        learning_values(SVC(), x, y, sizes=(20,)).scored("auc")
    with pytest.raises(DataError, match="one class only"):
        learning_values(SVC(), x, np.sort(y), sizes=(20,))
    with pytest.raises(DataError, match="NaN"):
        learning_values(SVR(), x * np.nan, x[:, 0], sizes=(20,))


@given(st.integers(60, 10_000), st.integers(2, 10), st.integers(1, 8))
def test_sizes_double_up_to_what_the_folds_leave(rows, folds, count):
    sizes = doubling_sizes(rows, folds, count)
    assert 1 <= len(sizes) <= count
    signs = torch.arange(rows) % 3 - 0.5
    generator = torch.Generator().manual_seed(rows)
    for numbers in (
        stratified_folds(signs.sign(), folds, generator),
        plain_folds(rows, folds, generator),
    ):
        left = rows - int(numbers.bincount().max())
        assert left - 2 <= sizes[-1] <= left
    assert all(b // a == 2 for a, b in itertools.pairwise(sizes))
