"""Γ of any domain: it learns by how much each number changes, and knows what kind each is."""

from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rail import END, GEAR, LAMP, PLACE, WIND, Cart, SeeingCart, driven
from support import models_of, seeded
from torch import Tensor

from cgtorch import Field
from cgtorch.domains.reports import TransitionReport
from cgtorch.domains.transition import Grid, KernelTransitionModel, TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError, ModelError
from cgtorch.ground.fields import wrapped
from cgtorch.svm import load_model, save_model

Fitted = tuple[TransitionModel, TransitionReport]
GRID = Grid([10.0], [1.0], [0.05], 600)
NUMBER = st.floats(-20, 20, width=32)


def experience(seed: int, count: int = 400) -> Dataset:
    return driven(count, 60, seed)


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    return models_of(Cart()).fit_transition(experience(0), 0)


def errors(model: TransitionModel, fresh: Dataset) -> Tensor:
    """Mean absolute errors (4,), angles by the shorter way."""
    with torch.no_grad():
        off = model(fresh.percept, fresh.control) - fresh.next_percept
    off[:, LAMP] = wrapped(off[:, LAMP])
    return off.abs().mean(0)


def test_it_has_learned_what_the_world_does(fitted: Fitted) -> None:
    fresh = experience(1)
    found, still = errors(fitted[0], fresh), errors(Still(), fresh)
    assert (found[[PLACE, LAMP, GEAR]] < 0.35 * still[[PLACE, LAMP, GEAR]]).all()
    predicted = fitted[0](fresh.percept, fresh.control)
    assert float((predicted[:, GEAR] == fresh.next_percept[:, GEAR]).float().mean()) > 0.85


class Still(KernelTransitionModel):
    """That nothing ever changes."""

    def __init__(self) -> None:
        super().__init__(Cart.percept, Cart.control)

    def predict_in_torch(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        return percept, percept[..., 0]


def test_each_prediction_has_an_error_of_its_own(fitted: Fitted) -> None:
    seen = experience(1).next_percept[:3]
    predicted = seen.clone()
    predicted[1:, PLACE] += torch.tensor([1.0, -2.0])
    first, second, third = fitted[0].errors(predicted, seen).tolist()
    assert (first, third) == (0, pytest.approx(2 * second))
    assert second > 0


def test_its_report_says_how_well(fitted: Fitted) -> None:
    _, report = fitted
    assert report.coordinates == ("place", "wind", "lamp", "gear")
    assert report.units == ("m", "m", "rad", "")
    assert report.rows == report.informative == 400
    assert all(report.error[i] < report.baseline_error[i] for i in (PLACE, LAMP, GEAR))
    assert len(report.choice) == 4
    assert report.choice[PLACE] is not None
    curve = report.learning_curve
    assert curve is not None
    assert len(curve.sizes) == len(curve.test_scores) > 1
    assert sum(curve.test_scores[0]) < sum(curve.test_scores[-1]) < 0  # minus an error
    scores = torch.tensor(report.grid_scores)
    sizes = [len(x) for x in (report.grid_gamma, report.grid_epsilon, report.grid_cost)]
    assert list(scores.shape) == [*sizes, len(report.gap)]
    for number, choice in enumerate(report.choice):
        if choice is not None:
            g, e = (
                report.grid_gamma.index(choice.gamma),
                report.grid_epsilon.index(choice.epsilon),
            )
            assert choice.score == pytest.approx(float(scores[g, e, :, number].max()))
            c = report.grid_cost.index(choice.C)
            assert choice.score == pytest.approx(float(scores[g, e, c, number]))
    g, e = divmod(int(scores.amax(2).mean(-1).argmax()), sizes[1])
    assert {(c.gamma, c.epsilon) for c in report.choice if c} == {
        (report.grid_gamma[g], report.grid_epsilon[e])
    }


def test_what_never_changes_stays_as_it_is(fitted: Fitted) -> None:
    model, report = fitted
    fresh = experience(1)
    assert report.choice[WIND] is None
    assert report.error[WIND] == 0
    predicted = model(fresh.percept, fresh.control)
    assert torch.equal(predicted[:, WIND], fresh.percept[:, WIND])


def test_a_number_that_is_all_noise_changes_by_its_mean() -> None:
    data = experience(2, 200)
    after = data.next_percept.clone()
    after[:, WIND] = data.percept[:, WIND] + 0.5 + torch.randn(200, generator=seeded(3))
    model, report = fit_transition_model(
        KernelTransitionModel(Cart.percept, Cart.control),
        data.percept,
        data.control,
        after,
        grid=GRID,
    )
    assert report.choice[WIND] is None
    mean = float((after - data.percept)[:, WIND].mean())
    change = (model(data.percept, data.control) - data.percept)[:, WIND]
    assert torch.allclose(change, torch.full_like(change, mean), atol=1e-5)
    assert report.error[WIND] == pytest.approx(report.baseline_error[WIND])


@given(
    percept=st.lists(st.tuples(*[NUMBER] * 4), min_size=1, max_size=5),
    control=st.tuples(*[NUMBER] * 3),
)
def test_every_answer_is_a_percept(
    fitted: Fitted, percept: list[tuple[float, ...]], control: tuple[float, ...]
) -> None:
    seen, pushed = torch.tensor(percept), torch.tensor([control] * len(percept))
    after, novelty = fitted[0].predict_with_novelty(seen, pushed)
    assert after.shape == seen.shape
    assert after.dtype == seen.dtype
    assert (after[:, PLACE].abs() <= END).all()
    assert ((after[:, LAMP] >= -torch.pi - 1e-6) & (after[:, LAMP] < torch.pi + 1e-6)).all()
    assert set(after[:, GEAR].tolist()) <= {0, 1, 2}
    assert ((novelty >= 0) & (novelty <= 1)).all()
    alone, one = fitted[0].predict_with_novelty(seen[:1], pushed[:1])
    assert torch.allclose(alone[0], after[0], atol=1e-4)
    assert torch.allclose(one[0], novelty[0], atol=1e-4)


def test_a_whole_turn_makes_no_difference(fitted: Fitted) -> None:
    fresh = experience(1)
    turned, twisted = fresh.percept.double(), fresh.control.double()
    wanted, novelty = fitted[0].predict_with_novelty(turned, twisted)
    for rows, column in ((turned, LAMP), (twisted, 1)):
        rows[:, column] += 2 * torch.pi
        found, again = fitted[0].predict_with_novelty(turned, twisted)
        numbers = [PLACE, WIND]
        assert torch.allclose(found[:, numbers], wanted[:, numbers], atol=1e-4)
        assert wrapped(found[:, LAMP] - wanted[:, LAMP]).abs().max() < 1e-4
        assert torch.allclose(again, novelty, atol=1e-4)


def test_an_angle_with_bounds_goes_round_within_them() -> None:
    """A wheel that turns by 0.5 rad is always ahead of where it was, also across its zero."""
    for low, high in ((0.0, 2 * torch.pi), (-torch.pi, torch.pi)):
        wheel = (Field("wheel", "rad", low, high, "angle"),)
        angle = low + 2 * torch.pi * torch.rand(120, 1, generator=seeded(0))
        control = torch.rand(120, 1, generator=seeded(1))
        after = low + torch.remainder(angle + 0.5 + control - low, 2 * torch.pi)
        model = KernelTransitionModel(wheel, (Field("push", low=0, high=1),))
        model, _ = fit_transition_model(model, angle, control, after, grid=GRID)
        found = model(angle, control)
        assert ((found >= low - 1e-5) & (found <= high + 1e-5)).all()
        assert wrapped(found - after).abs().max() < 0.2
        assert (found < angle).any()


def test_controls_beyond_their_bounds_are_those_at_the_bounds(fitted: Fitted) -> None:
    fresh = experience(1, 50)
    bound, beyond = fresh.control.clone(), fresh.control.clone()
    bound[:, 0], beyond[:, 0] = 1, 7
    bound[:, 2], beyond[:, 2] = -1, -3
    for one, other in zip(
        fitted[0].predict_with_novelty(fresh.percept, bound),
        fitted[0].predict_with_novelty(fresh.percept, beyond),
        strict=True,
    ):
        assert torch.equal(one, other)


def test_novelty_tells_what_is_off_the_data(fitted: Fitted) -> None:
    model, fresh = fitted[0], experience(1)
    known = model.novelty(fresh.percept, fresh.control)
    windy = fresh.percept + torch.tensor([0, 2.0, 0, 0])
    assert float(known.median()) < 0.5 < 0.95 < float(model.novelty(windy, fresh.control).min())
    trained = experience(0)
    assert float(model.novelty(trained.percept, trained.control).quantile(0.9)) < 0.5


def test_features_of_a_domains_own_are_seen_too(fitted: Fitted) -> None:
    """How far a push leads is a product, which one who is told it need not find out."""
    data, fresh = experience(0), experience(1)
    rows = data.percept, data.control, data.next_percept
    blind, seeing = (
        fit_transition_model(models_of(made)._transition_model(), *rows, grid=GRID)[0]
        for made in (Cart(), SeeingCart())
    )
    numbers = len(Cart.percept) + 1 + len(Cart.control) + 1  # two angles
    assert blind.features(*rows[:2]).shape[1] == numbers
    raw = seeing.raw_features(*rows[:2])
    assert raw.shape[1] == numbers + 1
    assert torch.equal(raw[:, -1], data.percept[:, GEAR] * data.control[:, 0])
    assert errors(seeing, fresh)[PLACE] < 0.9 * errors(blind, fresh)[PLACE]


def test_it_is_differentiable() -> None:
    data = experience(4, 80)
    rows = data.percept, data.control, data.next_percept
    model = KernelTransitionModel(Cart.percept[:3], Cart.control)
    model, _ = fit_transition_model(
        model, rows[0][:, :3], rows[1], rows[2][:, :3], grid=GRID, dtype=torch.float64
    )
    percept, control = data.percept[:3, :3].double() / 4, data.control[:3].double() / 4
    assert torch.autograd.gradcheck(model, (percept.requires_grad_(), control.requires_grad_()))


@pytest.mark.parametrize("kind", [Cart, SeeingCart])
def test_it_goes_through_a_file(kind: type[Cart], tmp_path: Path) -> None:
    data = experience(5, 60)
    rows = data.percept, data.control, data.next_percept
    model, _ = fit_transition_model(models_of(kind())._transition_model(), *rows, grid=GRID)
    save_model(tmp_path / "gamma", model)
    again: Any = load_model(tmp_path / "gamma", models_of(kind()).unfitted())
    for one, other in zip(
        model.predict_with_novelty(*rows[:2]), again.predict_with_novelty(*rows[:2]), strict=True
    ):
        assert torch.equal(one, other)
    if kind is SeeingCart:
        other = load_model(tmp_path / "gamma", models_of(Cart()).unfitted())
        with pytest.raises(DataError, match=r"make 9 features; .* was fitted on 10"):
            other(*rows[:2])


def test_same_seed_same_model() -> None:
    data = experience(6, 60)
    rows = data.percept, data.control, data.next_percept
    one, other = (
        fit_transition_model(models_of(Cart())._transition_model(), *rows, seed=3, grid=GRID)[
            0
        ].state_dict()
        for _ in range(2)
    )
    assert all(torch.equal(value, other[name]) for name, value in one.items())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p, u, q: (p, u[:-1], q), "60, 59 and 60 rows"),
        (lambda p, u, q: (p, u, q[:, :3]), "of 4, 3 and 3; pass equally many of D, U and D"),
        (lambda p, u, q: (p * torch.nan, u, q), "NaN"),
        (lambda p, u, q: (p[:3], u[:3], q[:3]), "folds"),
        (lambda p, u, q: (p[:, :3], u, q[:, :3]), r"pass \(..., 4\) and \(..., 3\)|3.*4"),
        (lambda p, u, q: (p, u[:, :2], q), r"pass \(..., 4\) and \(..., 3\)"),
    ],
)
def test_bad_data_are_refused(change: Any, says: str) -> None:
    data = experience(6, 60)
    rows = change(data.percept, data.control, data.next_percept)
    with pytest.raises(DataError, match=says):
        fit_transition_model(models_of(Cart())._transition_model(), *rows, grid=GRID)


def test_an_unfitted_model_says_so() -> None:
    data = experience(6, 10)
    with pytest.raises(ModelError, match="fitted"):
        models_of(Cart())._transition_model()(data.percept, data.control)
