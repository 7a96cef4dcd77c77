"""Machines and their searches in detail: what a fit leaves, distances, folds, scores and ties."""

import numpy as np
import pytest
import sklearn.metrics
import torch
from dual_problems import rows
from support import seeded

from cgtorch.ground.errors import DataError
from cgtorch.svm import SVC, SVR, grid_search, learning_values
from cgtorch.svm.cross_validation import SCORES
from cgtorch.svm.rbf import chunk_rows, predict_rbf

X = rows(0, 40)[:, :2]
WAVE = (2 * X[:, 0]).sin()
LABEL = (X[:, 1] > 0).double()


@pytest.mark.parametrize("compiled", [True, False])
def test_distances_are_those_to_the_nearest_centre(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a centre it is 0, and never less; with gradients as well."""
    if not compiled:
        monkeypatch.setattr("cgtorch.svm.machine.suits", lambda *_: False)
    machine = SVR(5.0, gamma=3.0).fit(X, WAVE)
    x = torch.cat([rows(1, 10)[:, :2], 0.01 + machine.centres, machine.centres])
    values, distance = machine.values_and_distance(x.view(-1, 2, 2))
    wanted = torch.cdist(x, machine.centres).square().amin(1)
    assert distance.shape == values.shape[:2] == (len(x) // 2, 2)
    torch.testing.assert_close(distance.flatten(), wanted, atol=1e-12, rtol=1e-9)
    assert bool((distance >= 0).all())
    known = values.clone(), distance.clone()
    again = machine.values_and_distance(x.requires_grad_().view(-1, 2, 2))
    torch.testing.assert_close(again, known, atol=1e-9, rtol=1e-9)


def test_with_gradients_the_nearest_centre_is_the_same_one() -> None:
    machine = X[:7], rows(3, 7)[:, :3], torch.zeros(3).double(), torch.tensor(0.3).double()
    x = rows(2, 9)[:, :2]
    plain = predict_rbf(x, *machine)
    torch.testing.assert_close(predict_rbf(x.requires_grad_(), *machine), plain)


def test_a_fit_leaves_its_parameters_and_how_exact_it_is() -> None:
    targets = torch.stack([WAVE, 100 * WAVE], 1)
    machine = SVR([2.0, 300.0], gamma=0.7, epsilon=[0.05, 3.0]).fit(X, targets)
    assert machine.cost.tolist() == pytest.approx([2.0, 300.0])
    assert machine.tube.tolist() == [0.05, 3.0]
    assert float(machine.gamma_value) == pytest.approx(0.7)
    assert not bool(machine.squeeze)
    assert machine(X).shape == (40, 2)
    assert torch.equal(machine.centres, X[machine.support])
    # The gap is the primal objective less the dual one, in the unit of the targets.
    kernel = torch.exp(-0.7 * torch.cdist(X, machine.centres).square())
    square = 0.5 * (machine.weights * (kernel[machine.support] @ machine.weights)).sum(0)
    loss = ((targets - machine(X)).abs() - machine.tube).clamp_min(0).sum(0)
    own, size = targets[machine.support] * machine.weights, machine.tube * machine.weights.abs()
    gap = 2 * square + machine.cost * loss - (own - size).sum(0)
    torch.testing.assert_close(machine.gap, gap, atol=1e-9, rtol=1e-3)


def test_where_all_targets_are_in_the_tube_a_row_tells_the_number_of_features() -> None:
    flat = SVR(epsilon=9.0).fit(X, WAVE)
    assert flat.support.tolist() == [0]
    assert torch.equal(flat.centres, X[:1])
    assert flat.weights.tolist() == [[0.0]]


def test_a_warm_fit_begins_with_all_rows_of_the_last_one() -> None:
    machine = SVR(5.0, gamma=3.0, epsilon=0.0).fit(X, WAVE)
    last = int(machine.support.max())
    assert last > 10
    two = torch.stack([WAVE, WAVE], 1)
    for x, y, outputs in ((X[:last], WAVE[:last], 1), (X, two, 2)):
        with pytest.raises(DataError, match=f"{len(x)} rows with {outputs} outputs do not begin"):
            SVR(5.0, gamma=3.0, epsilon=0.0).fit(X, WAVE).fit(x, y, warm=True)
    again = machine.fit(X[: last + 1], WAVE[: last + 1], warm=True)
    torch.testing.assert_close(again.predict(X[:5]), WAVE[:5], atol=0.5, rtol=0)


def test_a_decision_of_zero_is_for_the_first_class() -> None:
    machine = SVC().fit(X, LABEL)
    machine.weights.zero_()
    machine.bias.zero_()
    assert set(machine.predict(X).tolist()) == {0.0}
    machine.bias.fill_(1e-9)
    assert set(machine.predict(X).tolist()) == {1.0}


def test_errors_tell_rows_folds_and_the_first_classes() -> None:
    grid = {"C": 1.0, "gamma": 1.0}
    with pytest.raises(DataError, match="5 rows cannot make 6 folds; use fewer folds or more rows"):
        grid_search(SVR(), X[:5], WAVE[:5], folds=6, **grid)
    assert len(grid_search(SVR(), X[:5], WAVE[:5], folds=5, **grid).folds.unique()) == 5
    with pytest.raises(DataError, match=r"y has 40 classes \(0, 1, 2, 3, 4\); a classifier needs"):
        SVC().fit(X, torch.arange(40))
    with pytest.raises(DataError, match=r"y has 3 classes \(0, 1, 2\)"):
        SVC().fit(X, torch.arange(40) % 3)


def test_chunks_are_as_large_as_stays_fast() -> None:
    assert chunk_rows(16, 4) == 1008  # whole 48s of at most 1024
    assert chunk_rows(1024, 4) == 240  # a mebibyte of 4 kiB each
    assert chunk_rows(10**5, 4) == 96  # at least 128, in whole 48s
    assert chunk_rows(10**8, 4) == 48


def test_a_search_sorts_costs_and_takes_the_smallest_of_equally_good_ones() -> None:
    x = torch.cat([X - 9, X + 9])
    y = torch.arange(80) // 40
    found = grid_search(SVC(), x, y, C=[8.0, 0.5, 2.0], gamma=[0.2, 0.1], folds=4)
    assert found.C.tolist() == [0.5, 2.0, 8.0]
    assert found.gamma.tolist() == [0.2, 0.1]
    assert found.epsilon.tolist() == [0.0]
    assert bool((found.scores == 1).all())
    (best,) = found.best
    assert (best.C, best.gamma, best.epsilon, best.score) == (0.5, 0.2, 0.0, 1.0)


def test_given_folds_are_numbered_in_their_order() -> None:
    given = torch.tensor([7, 0, 3, 7, 0]).repeat(8)
    found = grid_search(SVR(), X, WAVE, C=1.0, gamma=1.0, folds=given)
    assert found.folds.tolist() == [2, 0, 1, 2, 0] * 8
    assert found.scores.shape[-1] == 3


def test_a_generator_goes_on_as_far_as_ever() -> None:
    """By the folds, and a number of 62 bits for each width."""
    used, wanted = seeded(3), seeded(3)
    found = grid_search(SVR(), X, WAVE, C=1.0, gamma=[0.1, 1.0, 9.0], seed=used)
    order = torch.randperm(40, generator=wanted)
    torch.randint(2**62, (3,), generator=wanted)
    assert torch.equal(used.get_state(), wanted.get_state())
    assert torch.equal(found.folds, order % 5)


def test_the_largest_models_of_a_learning_curve_are_those_of_a_search() -> None:
    folds = torch.arange(40) % 4
    targets = torch.stack([WAVE, LABEL], 1)
    curve = learning_values(SVR(2.0, gamma=0.5), X, targets, sizes=(16, 30), folds=folds)
    found = grid_search(SVR(), X, targets, C=2.0, gamma=0.5, folds=folds)
    torch.testing.assert_close(curve.held_out, found.held_out[0, 0, 0], atol=5e-3, rtol=0)
    assert curve.used.sum(-1).tolist() == [[16] * 4, [30] * 4]
    assert not bool(curve.used[:, folds, torch.arange(40)].any())


def test_scores_are_those_of_scikit_learn_also_without_one_of_the_classes() -> None:
    value = torch.tensor([-1.0, 0.0, 2.0, 3.0, -0.5]).double()
    for truth in ([-1, 1, 1, -1, -1], [-1, -1, 1, 1, 1], [1, 1, -1, 1, -1]):
        signs, said = np.array(truth), np.where(value > 0, 1, -1)
        wanted = sklearn.metrics.accuracy_score(signs, said)
        assert float(SCORES["accuracy"](value, torch.tensor(truth))) == pytest.approx(wanted)
        wanted = sklearn.metrics.balanced_accuracy_score(signs, said)
        assert float(SCORES["balanced_accuracy"](value, torch.tensor(truth))) == pytest.approx(
            wanted
        )
    for only in (-1, 1):  # the other class has no right row
        right = float(((value > 0) == (only > 0)).double().mean())
        alone = torch.full((5,), only)
        assert float(SCORES["balanced_accuracy"](value, alone)) == pytest.approx(right / 2)
    truth = torch.tensor([1.0, 2.0, 4.0, 3.0, -1.0]).double()
    for name, theirs in (
        ("r2", sklearn.metrics.r2_score(truth, value)),
        ("neg_mean_absolute_error", -sklearn.metrics.mean_absolute_error(truth, value)),
    ):
        assert float(SCORES[name](value, truth)) == pytest.approx(theirs)
    assert float(SCORES["r2"](truth, truth)) == 1
    assert float(SCORES["r2"](0 * truth, 0 * truth)) == 1
