"""Grid searches and learning curves against scikit-learn, which trains every model by itself."""

import itertools
import json
from dataclasses import asdict

import numpy as np
import pytest
import sklearn.svm
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import (
    GridSearchCV,
    KFold,
    PredefinedSplit,
    StratifiedKFold,
    learning_curve,
)
from stand_in import labelled, transitions
from support import seeded

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm import SVC, SVR, LearningCurve, doubling_sizes, grid_search, learning_values
from cgtorch.svm.cross_validation import plain_folds, stratified_folds

COSTS, WIDTHS = [0.5, 8.0, 128.0], [0.01, 0.1, 1.0]
SIZES = (20, 47, 160, 240)


def scaled(x):
    return (x - x.mean(0)) / np.where(x.std(0) > 0, x.std(0), 1)


def classification(count):
    x, y = labelled(count)
    order = np.random.default_rng(0).permutation(count)
    return scaled(x)[order], y[order]


def regression(count, outputs):
    p, u, q = transitions(count)
    x = np.concatenate([p, u[:, :2], np.sin(u[:, 2:]), np.cos(u[:, 2:])], 1)
    return scaled(x), scaled((q - p)[:, outputs])


def numbers_of(folds):
    """The number of the fold that holds out each row, of (train, test) pairs of rows."""
    numbers = np.zeros(sum(len(test) for _, test in folds))
    for number, (_, test) in enumerate(folds):
        numbers[test] = number
    return numbers


def test_classification_grids_equal_scikit_learn_in_every_cell():
    x, y = classification(300)
    found = grid_search(SVC(), x, y, C=COSTS, gamma=WIDTHS)
    split = PredefinedSplit(found.folds.numpy())
    grid = {"gamma": WIDTHS, "C": COSTS}
    oracle = GridSearchCV(sklearn.svm.SVC(tol=1e-6), grid, cv=split).fit(x, y)
    scores = oracle.cv_results_["mean_test_score"].reshape(3, 3).T
    np.testing.assert_allclose(found.mean[:, 0, :, 0], scores, atol=1e-12)
    assert found.best[0].score == pytest.approx(oracle.best_score_)
    assert float(found.gap.max()) < 0.01


def test_regression_grids_equal_scikit_learn_in_every_cell():
    x, y = regression(250, [0, 4])
    tubes = [0.02, 0.2]
    found = grid_search(SVR(), x, y, C=COSTS, gamma=WIDTHS, epsilon=tubes, folds=4)
    split = PredefinedSplit(found.folds.numpy())
    grid = {"epsilon": tubes, "gamma": WIDTHS, "C": COSTS}
    for output in range(2):
        oracle = GridSearchCV(sklearn.svm.SVR(tol=1e-5), grid, cv=split).fit(x, y[:, output])
        scores = oracle.cv_results_["mean_test_score"].reshape(3, 2, 3).transpose(2, 1, 0)
        np.testing.assert_allclose(found.mean[..., output], scores, atol=2e-3)
        best = found.best[output]
        assert best.score == pytest.approx(oracle.best_score_, abs=1e-3)
        same = sklearn.svm.SVR(C=best.C, gamma=best.gamma, epsilon=best.epsilon, tol=1e-5)
        rows = found.folds.numpy() == 1
        same.fit(x[~rows], y[~rows, output])
        cell = WIDTHS.index(best.gamma), tubes.index(best.epsilon), COSTS.index(best.C), output
        np.testing.assert_allclose(
            found.held_out[cell].numpy()[rows], same.predict(x[rows]), atol=0.01
        )


@pytest.mark.parametrize(("scale", "offset"), [(1e-8, 0.0), (1e6, 1e7)])
def test_unit_and_offset_of_the_targets_change_nothing(scale, offset):
    x, y = regression(150, [0, 4])
    grid = {"C": np.array([1.0, 16.0]), "epsilon": np.array([0.05]), "gamma": [0.05, 0.5]}
    plain = grid_search(SVR(), x, y, folds=4, **grid)
    grid |= {"C": grid["C"] * scale, "epsilon": grid["epsilon"] * scale}
    other = grid_search(SVR(), x, y * scale + offset, folds=plain.folds, **grid)
    np.testing.assert_allclose(other.mean, plain.mean, atol=1e-3)


def test_given_folds_are_used_and_seeds_repeat():
    x, y = classification(90)
    numbers = np.arange(90) % 3
    found = grid_search(SVC(), x, y, C=[1.0], gamma=[1.0], folds=numbers)
    assert found.folds.tolist() == numbers.tolist()
    again = [grid_search(SVC(), x, y, C=[1.0], gamma=[1.0], seed=s).folds for s in (1, 1, 2)]
    assert torch.equal(again[0], again[1])
    assert not torch.equal(again[0], again[2])


@pytest.mark.parametrize(
    ("settings", "error", "says"),
    [
        ({"C": []}, SettingsError, "no value of C"),
        ({"C": [-1.0]}, SettingsError, "C is -1"),
        ({"scoring": "beauty"}, SettingsError, "beauty"),
        ({"folds": 40}, DataError, "40 folds"),
        ({"folds": 1}, SettingsError, "folds is 1"),
        ({"folds": np.zeros(60)}, DataError, "given folds"),
        ({"folds": 2.5}, DataError, "given folds"),
        ({"folds": np.arange(60) / 7}, DataError, "given folds"),
        ({"folds": np.arange(60) - 1}, DataError, "given folds"),
        ({"folds": "five"}, DataError, "folds is not an array"),
        ({"folds": [(0, [99])]}, DataError, "folds is not an array"),
        ({"folds": (labelled(60)[1] > 0).astype(int)}, DataError, "one class only"),
        ({"folds": 30}, DataError, "fewer than the 30 folds"),
        ({"seed": "x"}, SettingsError, "seed is 'x'"),
        ({"seed": 2**70}, SettingsError, "63 bits"),
    ],
)
def test_what_cannot_be_searched_is_refused(settings, error, says):
    x, y = labelled(60)
    with pytest.raises(error, match=says):
        grid_search(SVC(), x, y, **({"C": [1.0], "gamma": [1.0]} | settings))


def test_the_number_of_processes_changes_no_score_and_torch_is_left_as_it_was():
    x, y = classification(120)
    found, before = [], torch.get_rng_state()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        found.append(grid_search(SVC(), x, y, C=[1.0, 8.0], gamma=[0.1, 0.5, 2.0]))
        assert torch.get_num_threads() == threads
    assert torch.equal(found[0].held_out, found[1].held_out)
    assert torch.equal(found[0].scores, found[1].scores)
    assert torch.equal(before, torch.get_rng_state())
    assert torch.get_default_dtype() == torch.float32


@pytest.mark.parametrize("scoring", ["accuracy", "balanced_accuracy"])
def test_classifier_curves_are_those_of_scikit_learn(scoring):
    x, y = classification(300)
    folds = list(StratifiedKFold(5).split(x, y))
    theirs = sklearn.svm.SVC(C=8.0, gamma=0.3, tol=1e-8)
    wanted = learning_curve(theirs, x, y, train_sizes=SIZES, cv=folds, scoring=scoring)
    model = SVC(8.0, gamma=0.3)
    ours = learning_values(model, x, y, sizes=SIZES, folds=numbers_of(folds)).scored(scoring)
    assert ours.sizes == tuple(wanted[0].tolist()) == SIZES
    np.testing.assert_allclose(ours.train_scores, wanted[1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(ours.test_scores, wanted[2], rtol=0, atol=1e-6)
    assert not model.fitted
    assert np.mean(ours.test_scores[-1]) > np.mean(ours.test_scores[0]) + 0.02


@pytest.mark.parametrize("scoring", ["r2", "neg_mean_absolute_error"])
def test_regression_curves_are_those_of_scikit_learn_on_average(scoring):
    x, y = regression(300, [0, 1, 2])
    folds, costs = list(KFold(5).split(x)), (1.0, 5.0, 20.0)
    wanted = []
    for k, C in enumerate(costs):
        theirs = sklearn.svm.SVR(C=C, gamma=0.2, epsilon=0.05, tol=1e-8)
        found = learning_curve(theirs, x, y[:, k], train_sizes=SIZES, cv=folds, scoring=scoring)
        wanted.append(found[1:])
    train, test = np.mean(wanted, 0)
    model = SVR(costs, gamma=0.2, epsilon=0.05)
    ours = learning_values(model, x, y, sizes=SIZES, folds=numbers_of(folds)).scored(scoring)
    np.testing.assert_allclose(ours.train_scores, train, rtol=0, atol=2e-6)
    np.testing.assert_allclose(ours.test_scores, test, rtol=0, atol=2e-6)


def test_the_seed_decides_and_a_report_can_hold_the_curve():
    x, y = classification(200)
    one, same, other = (
        learning_values(SVC(8.0, gamma=0.3), x, y, sizes=(60, 120), seed=s).scored("accuracy")
        for s in (1, 1, 2)
    )
    assert one == same != other
    plain = json.loads(json.dumps(asdict(one)))
    sizes, *scores = plain["sizes"], plain["train_scores"], plain["test_scores"]
    assert LearningCurve(tuple(sizes), *(tuple(map(tuple, each)) for each in scores)) == one


@pytest.mark.parametrize("sizes", [(), (0,), (30, 241), (0.5,)])
def test_sizes_that_cannot_be_had(sizes):
    x, y = classification(300)
    with pytest.raises(SettingsError, match="rows from 1 to 240"):
        learning_values(SVC(), x, y, sizes=sizes)


def test_bad_data_and_scores():
    x, y = classification(100)
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
    signs = (torch.arange(rows) % 3 - 0.5).sign()
    for numbers in (
        stratified_folds(signs, folds, seeded(rows)),
        plain_folds(rows, folds, seeded(rows)),
    ):
        left = rows - int(numbers.bincount().max())
        assert left - 2 <= sizes[-1] <= left
    assert all(b // a == 2 for a, b in itertools.pairwise(sizes))


@pytest.mark.parametrize(
    ("rows", "count", "sizes"),
    [
        (82, 5, (16, 32, 64)),
        (81, 5, (31, 63)),
        (82, 2, (32, 64)),
        (20, 5, (14,)),
        (3000, 1, (2398,)),
    ],
)
def test_no_size_is_below_sixteen_unless_there_is_no_other(rows, count, sizes):
    assert doubling_sizes(rows, 5, count) == sizes
