"""C of any domain: the probability of success, from a percept whose angles go round."""

from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rail import GEAR, LAMP, PLACE, Cart, SeeingCart, driven
from support import models_of, seeded

from cgtorch.domains import success
from cgtorch.domains.reports import SuccessReport
from cgtorch.domains.success import (
    FOLDS,
    SuccessClassifier,
    _cross_fitted,
    calibration,
    fit_success_classifier,
)
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError, ModelError
from cgtorch.svm import load_model, save_model
from cgtorch.svm.platt import fit_platt, probability

Fitted = tuple[SuccessClassifier, SuccessReport]
GRID: dict[str, Any] = {"C": [100.0], "gamma": [0.5]}


def experience(seed: int, count: int = 500) -> Dataset:
    return driven(40, count, seed)


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    return models_of(Cart()).fit_success(experience(0), 0)


def balanced(model: SuccessClassifier, fresh: Dataset) -> float:
    with torch.no_grad():
        right = (model(fresh.tested) > 0.5) == fresh.succeeded
    return float(
        (right[fresh.succeeded].float().mean() + right[~fresh.succeeded].float().mean()) / 2
    )


def test_it_is_right_on_fresh_percepts_and_says_how_often(fitted: Fitted) -> None:
    model, report = fitted
    accuracy = balanced(model, experience(1))
    assert accuracy > 0.85
    assert report.balanced_accuracy == pytest.approx(accuracy, abs=0.06)
    assert report.rows == sum(rows for _, _, rows in report.reliability) == 500
    assert report.positive == pytest.approx(float(experience(0).succeeded.float().mean()))
    assert report.brier < 0.1
    assert report.calibration_error < 0.1


@given(st.lists(st.tuples(*[st.floats(-9, 9, width=32)] * 4), min_size=1, max_size=5))
def test_every_answer_is_a_probability(fitted: Fitted, rows: list[tuple[float, ...]]) -> None:
    seen = torch.tensor(rows)
    chance = fitted[0](seen)
    assert chance.shape == (len(rows),)
    assert chance.dtype == torch.float32
    assert ((chance >= 0) & (chance <= 1)).all()
    value = fitted[0].decision_function(seen)
    assert (chance[value.argsort()].diff() >= 0).all()
    assert torch.equal(value[chance > 0.99] > 0, chance[chance > 0.99] > 0.99)
    turned = seen.double() + torch.tensor([0, 0, 2 * torch.pi, 0], dtype=torch.float64)
    assert torch.allclose(fitted[0](turned).float(), chance, atol=1e-3)


def test_angles_are_seen_by_sine_and_cosine() -> None:
    seen = experience(1).tested
    raw = SuccessClassifier(Cart.percept).raw_features(seen)
    lamp = seen[:, LAMP]
    wanted = torch.stack([seen[:, 0], seen[:, 1], seen[:, GEAR], lamp.sin(), lamp.cos()], 1)
    assert torch.equal(raw, wanted)
    assert torch.equal(SuccessClassifier().raw_features(seen), seen)


def test_features_are_standardised_and_one_that_never_differs_does_no_harm() -> None:
    model = SuccessClassifier(Cart.percept)
    rows = experience(2).tested.double()
    rows[:, GEAR] = 1
    features = model.standardise(rows)
    assert torch.allclose(features.mean(0), torch.zeros(5, dtype=torch.float64), atol=1e-9)
    spread = features.std(0, correction=0)
    assert torch.allclose(spread[[0, 1, 3, 4]], torch.ones(4, dtype=torch.float64))
    assert spread[2] == 0
    assert model.scale[2] == 1


def test_features_of_a_domains_own_are_seen_too() -> None:
    data, fresh = experience(3, 150), experience(1, 900)
    found = {}
    for made in (Cart(), SeeingCart()):
        model = models_of(made)._success_classifier()
        model, _ = fit_success_classifier(model, data.tested, data.succeeded, **GRID)
        found[type(made)] = balanced(model, fresh)
        size = model.features(data.tested).shape[1]
        assert size == (5 if type(made) is Cart else 6)
    assert torch.equal(model.raw_features(data.tested)[:, -1], data.tested[:, PLACE].abs())
    assert found[SeeingCart] > found[Cart]


def test_it_is_differentiable() -> None:
    data = experience(3, 120)
    model, _ = fit_success_classifier(
        SuccessClassifier(Cart.percept), data.tested, data.succeeded, **GRID, dtype=torch.float64
    )
    assert torch.autograd.gradcheck(model, (data.tested[:4].double().requires_grad_(),))


@pytest.mark.parametrize("kind", [Cart, SeeingCart])
def test_it_goes_through_a_file(kind: type[Cart], tmp_path: Path) -> None:
    data = experience(3, 100)
    model = models_of(kind())._success_classifier()
    model, report = fit_success_classifier(model, data.tested, data.succeeded, **GRID)
    save_model(tmp_path / "c", model, report)
    again = load_model(tmp_path / "c", models_of(kind()).unfitted())
    assert torch.equal(again(data.tested), model(data.tested))
    if kind is SeeingCart:
        other = load_model(tmp_path / "c", models_of(Cart()).unfitted())
        with pytest.raises(DataError, match=r"4 coordinates, which make 5 .*was fitted on 6"):
            other(data.tested)


def test_bad_data_are_refused() -> None:
    data = experience(3, 60)
    rows, labels = data.tested, data.succeeded
    for bad, said, message in (
        (rows, torch.ones(60), "1 classes"),
        (rows, labels[:-1], "59"),
        (rows * torch.nan, labels, "NaN"),
        (rows[:22], torch.arange(22) < 1, "one class has 1 rows, fewer than the 2 folds"),
    ):
        with pytest.raises(DataError, match=message):
            fit_success_classifier(SuccessClassifier(Cart.percept), bad, said, **GRID)
    with pytest.raises(ModelError, match="fitted"):
        SuccessClassifier(Cart.percept)(rows)


@pytest.mark.parametrize("rarer", [3, 4, 5, 6, 9])
@pytest.mark.parametrize("met", [True, False])
def test_few_rows_of_one_class_are_shared_by_fewer_folds(
    rarer: int, met: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each fold has a row of either class to be judged by, and all rows are judged once."""
    asked: list[int] = []

    def watched(name: str) -> None:
        plain = getattr(success, name)

        def spy(*rows: Any, folds: Any, **how: Any) -> Any:
            asked.append(folds if isinstance(folds, int) else len(folds.unique()))
            return plain(*rows, folds=folds, **how)

        monkeypatch.setattr(success, name, spy)

    for name in ("grid_search", "learning_values"):
        watched(name)
    data = experience(3, 60)
    rare, rest = data.tested[data.succeeded == met], data.tested[data.succeeded != met]
    rows = torch.cat([rare[:rarer], rest[:30]])
    labels = (torch.arange(len(rows)) < rarer) == met
    model, report = fit_success_classifier(SuccessClassifier(Cart.percept), rows, labels, **GRID)
    assert asked == [min(FOLDS, rarer)] * 2
    assert sum(count for _, _, count in report.reliability) == report.rows == len(rows)
    assert report.positive == pytest.approx(float(labels.float().mean()))
    assert model(rows).isfinite().all()


@given(st.integers(2, 7), st.integers(2, 12), st.integers(0, 99), st.integers(5, 40))
@settings(max_examples=25)
def test_any_few_rows_of_either_class_can_be_learned_from(
    met: int, missed: int, seed: int, grid_rows: int
) -> None:
    """No fold, and no sample for the grid, is without one of the classes."""
    data = experience(3, 60)
    rows = torch.cat([data.tested[data.succeeded][:met], data.tested[~data.succeeded][:missed]])
    labels, model = torch.arange(met + missed) < met, SuccessClassifier(Cart.percept)
    model, _ = fit_success_classifier(
        model, rows, labels, **GRID, seed=seed, grid_rows=max(grid_rows, 2 * min(met, missed))
    )
    assert model(rows).isfinite().all()


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_calibration_is_what_it_is_defined_as(rows: list[tuple[float, bool]]) -> None:
    chance = torch.tensor([c for c, _ in rows], dtype=torch.float64)
    truth = torch.tensor([float(t) for _, t in rows], dtype=torch.float64)
    error, curve = calibration(chance, truth)
    bins: dict[int, list[tuple[float, bool]]] = {}
    for c, t in rows:
        bins.setdefault(min(int(c * 10), 9), []).append((c, t))
    assert [n for _, _, n in curve] == [len(bins[i]) for i in sorted(bins)]
    gaps = [abs(sum(c for c, _ in b) - sum(t for _, t in b)) for b in bins.values()]
    assert error == pytest.approx(sum(gaps) / len(rows), abs=1e-9)
    assert 0 <= error <= 1


def test_a_held_out_probability_is_by_a_curve_that_has_not_seen_it() -> None:
    value = torch.randn(60, generator=seeded(0), dtype=torch.float64)
    noise = torch.randn(60, generator=seeded(1), dtype=torch.float64)
    signs, folds = (value + noise).sign(), torch.arange(60) % 3
    before = _cross_fitted(value, signs, folds)
    after = _cross_fitted(value, torch.where(folds == 1, -signs, signs), folds)
    same = before == after
    assert same[folds == 1].all()
    assert not same[folds != 1].any()
    slope, offset = fit_platt(value[folds != 1], signs[folds != 1])
    assert torch.equal(before[folds == 1], probability(value[folds == 1], slope, offset))
