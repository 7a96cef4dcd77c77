"""Grid search against GridSearchCV, cell by cell."""

import numpy as np
import pytest
import sklearn.svm
import torch
from sklearn.model_selection import GridSearchCV, PredefinedSplit
from stand_in import labelled, transitions

from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.svm import SVC, SVR, grid_search, solver

COSTS, WIDTHS = [0.5, 8.0, 128.0], [0.01, 0.1, 1.0]


def _scaled(x):
    return (x - x.mean(0)) / np.where(x.std(0) > 0, x.std(0), 1)


def test_classification_scores_equal_scikit_learn_in_every_cell():
    x, y = labelled(300)
    x = _scaled(x)
    found = grid_search(SVC(), x, y, C=COSTS, gamma=WIDTHS)
    split = PredefinedSplit(found.folds.numpy())
    grid = {"gamma": WIDTHS, "C": COSTS}
    oracle = GridSearchCV(sklearn.svm.SVC(tol=1e-6), grid, cv=split).fit(x, y)
    scores = oracle.cv_results_["mean_test_score"].reshape(3, 3).T
    np.testing.assert_allclose(found.mean[:, 0, :, 0], scores, atol=1e-12)
    assert found.best[0].score == pytest.approx(oracle.best_score_)
    assert float(found.gap.max()) < 0.01


def test_regression_scores_equal_scikit_learn_in_every_cell():
    p, u, q = transitions(250)
    x = _scaled(np.concatenate([p, u[:, :2], np.sin(u[:, 2:]), np.cos(u[:, 2:])], 1))
    y = _scaled(q[:, [0, 4]])
    found = grid_search(SVR(), x, y, C=COSTS, gamma=WIDTHS, epsilon=[0.02, 0.2], folds=4)
    split = PredefinedSplit(found.folds.numpy())
    grid = {"epsilon": [0.02, 0.2], "gamma": WIDTHS, "C": COSTS}
    for output in range(2):
        oracle = GridSearchCV(sklearn.svm.SVR(tol=1e-5), grid, cv=split).fit(x, y[:, output])
        scores = oracle.cv_results_["mean_test_score"].reshape(3, 2, 3).transpose(2, 1, 0)
        np.testing.assert_allclose(found.mean[..., output], scores, atol=2e-3)
        best = found.best[output]
        assert best.score == pytest.approx(oracle.best_score_, abs=1e-3)
        same = sklearn.svm.SVR(C=best.C, gamma=best.gamma, epsilon=best.epsilon, tol=1e-5)
        rows = found.folds.numpy() == 1
        same.fit(x[~rows], y[~rows, output])
        g, e = WIDTHS.index(best.gamma), [0.02, 0.2].index(best.epsilon)
        held = found.held_out[g, e, COSTS.index(best.C), output].numpy()[rows]
        np.testing.assert_allclose(held, same.predict(x[rows]), atol=0.01)


@pytest.mark.parametrize("turns", [0, 1])
def test_what_exact_steps_leave_is_solved_without_them(monkeypatch, turns):
    x, y = labelled(200)
    grid = {"C": [0.5, 128.0], "gamma": [0.1, 1.0]}
    plain = grid_search(SVC(), _scaled(x), y, **grid)
    monkeypatch.setattr(solver, "_TURNS", turns)
    monkeypatch.setattr(solver, "_WORTH", (0.0, 0.0))
    monkeypatch.setattr(solver, "polish", lambda *_: None)
    other = grid_search(SVC(), _scaled(x), y, folds=plain.folds, **grid)
    np.testing.assert_allclose(other.held_out, plain.held_out, atol=5e-3)


def test_given_folds_are_used_and_seeds_repeat():
    x, y = labelled(90)
    numbers = np.arange(90) % 3
    found = grid_search(SVC(), x, y, C=[1.0], gamma=[1.0], folds=numbers)
    assert found.folds.tolist() == numbers.tolist()
    again = [grid_search(SVC(), x, y, C=[1.0], gamma=[1.0], seed=s).folds for s in (1, 1, 2)]
    assert torch.equal(again[0], again[1])
    assert not torch.equal(again[0], again[2])


def test_a_cost_that_needs_no_bound_is_as_exact_as_the_largest():
    """Its solution is taken for every larger cost, so its gap counts with theirs."""
    x, y = labelled(300)
    found = grid_search(SVC(), _scaled(x), y, C=[8.0, 2048.0], gamma=[2.0])
    alone = grid_search(SVC(), _scaled(x), y, C=[2048.0], gamma=[2.0], folds=found.folds)
    np.testing.assert_allclose(found.held_out[0, 0, 1, 0], alone.held_out[0, 0, 0, 0], atol=1e-3)
    assert float(found.gap[0, 0, 1, 0]) <= 2 * float(alone.gap[0, 0, 0, 0])


@pytest.mark.parametrize(("scale", "offset"), [(1e-8, 0.0), (1e6, 1e7)])
def test_unit_and_offset_of_the_targets_change_nothing(scale, offset):
    p, u, q = transitions(150)
    x, y = _scaled(np.concatenate([p, u], 1)), _scaled(q[:, [0, 4]])
    grid = {"C": np.array([1.0, 16.0]), "epsilon": np.array([0.05]), "gamma": [0.05, 0.5]}
    plain = grid_search(SVR(), x, y, folds=4, **grid)
    grid |= {"C": grid["C"] * scale, "epsilon": grid["epsilon"] * scale}
    other = grid_search(SVR(), x, y * scale + offset, folds=plain.folds, **grid)
    np.testing.assert_allclose(other.mean, plain.mean, atol=1e-3)


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


def test_the_number_of_processes_changes_no_score():
    x, y = labelled(120)
    grid = {"C": [1.0, 8.0], "gamma": [0.1, 0.5, 2.0]}
    found = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        try:
            found.append(grid_search(SVC(), x, y, **grid))
        finally:
            torch.set_num_threads(1)
    assert torch.equal(found[0].held_out, found[1].held_out)
    assert torch.equal(found[0].scores, found[1].scores)
