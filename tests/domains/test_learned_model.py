"""Γ and C of any domain learn on: from more data, from a coreset of them, with fewer centres."""

from copy import deepcopy
from typing import Any

import pytest
import torch
from rail import Cart, SeeingCart, driven
from support import models_of
from torch import Tensor

from cgtorch.domains.learned_model import mean_and_spread
from cgtorch.domains.success import SuccessClassifier, fit_success_classifier
from cgtorch.domains.transition import Grid, KernelTransitionModel, TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError
from cgtorch.ground.fields import named
from cgtorch.svm import fit_reduced_set

GRID: dict[str, Any] = {"C": [10.0], "gamma": [1.0]}
DATA = driven(300, 300, 0)
FRESH = driven(400, 400, 1)
MOVES = DATA.percept, DATA.control, DATA.next_percept
TESTS = DATA.tested, DATA.succeeded


def gamma_of(rows: int, domain: Cart | None = None, tube: float = 0.05) -> TransitionModel:
    model = models_of(domain or Cart())._transition_model()
    some = (a[:rows] for a in MOVES)
    return fit_transition_model(
        model, *some, grid=Grid([10.0], [1.0], [tube], 600), dtype=torch.float64
    )[0]


def classifier_of(rows: int, domain: Cart | None = None) -> SuccessClassifier:
    model = models_of(domain or Cart())._success_classifier()
    some = (a[:rows] for a in TESTS)
    return fit_success_classifier(model, *some, **GRID, dtype=torch.float64)[0]


def error(model: TransitionModel, data: Dataset = FRESH) -> float:
    with torch.no_grad():
        return float(model.errors(model(data.percept, data.control), data.next_percept).mean())


def wrong(model: SuccessClassifier, data: Dataset = FRESH) -> float:
    with torch.no_grad():
        return float((model(data.tested) - data.succeeded.float()).square().mean())


def state(model: torch.nn.Module) -> dict[str, Tensor]:
    return {name: value.clone() for name, value in model.state_dict().items()}


@pytest.mark.parametrize("domain", [Cart(), SeeingCart()])
def test_more_transitions_make_gamma_better(domain: Cart) -> None:
    start = gamma_of(60, domain)
    before = state(start)
    grown = start.updated(*MOVES)
    assert error(grown) < 0.85 * error(start)
    assert error(grown, DATA) < error(start, DATA)
    assert type(grown) is type(start)
    assert all(torch.equal(value, before[name]) for name, value in state(start).items())
    for name in ("mean", "scale", "shift", "spread", "learnt"):
        assert torch.equal(getattr(grown, name), getattr(start, name))
    assert (grown.most >= start.most).all()


def test_more_tests_make_c_better() -> None:
    start = classifier_of(60)
    before = state(start)
    grown = start.updated(*TESTS)
    assert wrong(grown) < wrong(start)
    assert torch.equal(grown.machine.platt, start.machine.platt)
    assert all(torch.equal(value, before[name]) for name, value in state(start).items())


def test_the_same_data_change_hardly_anything() -> None:
    gamma, classifier = gamma_of(200), classifier_of(200)
    again = gamma.updated(*(a[:200] for a in MOVES))
    off = again(FRESH.percept, FRESH.control) - gamma(FRESH.percept, FRESH.control)
    assert float(off.abs().mean()) < 0.02
    other = classifier.updated(*(a[:200] for a in TESTS))
    assert float((other(FRESH.tested) - classifier(FRESH.tested)).abs().mean()) < 0.02


def test_rows_that_were_there_have_to_come_first() -> None:
    with pytest.raises(DataError, match="do not begin with"):
        gamma_of(60).updated(*(a[:20] for a in MOVES))
    with pytest.raises(DataError, match="do not begin with"):
        classifier_of(60).updated(*(a[:20] for a in TESTS))


def test_few_rows_are_their_own_coreset() -> None:
    gamma, classifier = gamma_of(60), classifier_of(60)
    rows, start = gamma.coreset(*(a[:60] for a in MOVES), limit=60)
    assert rows.tolist() == [*range(60)]
    assert start is gamma
    rows, same = classifier.coreset(*(a[:60] for a in TESTS), limit=60)
    assert rows.tolist() == [*range(60)]
    assert same is classifier


@pytest.mark.parametrize(("limit", "worse"), [(40, 3), (150, 1.5), (290, 1.15)])
def test_a_coreset_is_small_and_knows_what_it_stands_for(limit: int, worse: float) -> None:
    gamma = gamma_of(300)
    rows, start = gamma.coreset(*MOVES, limit=limit)
    assert len(rows) == limit
    assert torch.equal(rows, rows.unique())
    smaller = start.updated(*(a[rows] for a in MOVES))
    assert error(smaller) < worse * error(gamma)
    classifier = classifier_of(300)
    rows, first = classifier.coreset(*TESTS, limit=limit)
    assert len(rows) == limit
    assert torch.equal(rows, rows.unique())
    less = first.updated(*(a[rows] for a in TESTS))
    assert wrong(less) < worse * wrong(classifier)


def test_what_is_compact_says_nearly_the_same() -> None:
    gamma, classifier = gamma_of(300), classifier_of(300)
    small = gamma.with_fewer_centres(100, *MOVES[:2])
    assert len(small.machine.centres) == 100 < len(gamma.machine.centres)
    assert error(small) < 1.3 * error(gamma)
    tiny = gamma.with_fewer_centres(12, *MOVES[:2])
    known = float((tiny.novelty(*MOVES[:2]) <= 0.5).float().mean())
    assert known == pytest.approx(0.95, abs=0.03)  # whatever few centres there are
    lost = []
    for centres in (20, 100, 300):
        less = deepcopy(classifier)
        less.machine = fit_reduced_set(classifier.machine, centres, classifier.features(TESTS[0]))
        assert len(less.machine.centres) <= centres
        lost.append(float((less(FRESH.tested) - classifier(FRESH.tested)).abs().mean()))
    assert lost == sorted(lost, reverse=True)
    assert lost[-1] < 1e-6  # it keeps all that there are


def test_rows_that_are_no_support_vectors_change_nothing() -> None:
    """They may be left out, and the rows left out are predicted no worse."""
    gamma = gamma_of(300, tube=0.5)
    kept, start = gamma.coreset(*MOVES, limit=len(gamma.machine.centres) + 5)
    assert len(kept) < 300
    asked = FRESH.percept, FRESH.control
    torch.testing.assert_close(start(*asked), gamma(*asked), atol=1e-9, rtol=0)  # it has them all
    after = start.updated(*(a[kept] for a in MOVES))
    assert error(after) < 1.02 * error(gamma)
    out = torch.ones(300, dtype=torch.bool).index_fill(0, kept, False)
    left = Dataset(*(a[out] for a in MOVES), *TESTS)
    assert error(after, left) < error(gamma, left) + 0.01


@pytest.mark.parametrize("unit", [1e-12, 1e9])
def test_gamma_learns_the_same_in_any_unit(unit: float) -> None:
    """A number that only changes by rounding stays as it was."""
    x = torch.randn(150, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    x[:, 2] = 0.3
    push = torch.randn(150, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    after = x + 0.2 * torch.cat([x[:, 1:2].sin(), push, 0 * push], 1)
    after[:, 2] = (after[:, 2] / 3) * 3 + 1e-17
    fields = named("place", "speed", "height"), named("push")

    def predicted(unit: float) -> Tensor:
        model = KernelTransitionModel(*fields)
        about = unit * x, push, unit * after
        grid = Grid([10.0], [0.3], [0.02], 600)
        model = fit_transition_model(model, *about, grid=grid, dtype=torch.float64)[0]
        return model(unit * x[:50], push[:50]) / unit

    plain = predicted(1.0)
    assert float((plain - after[:50])[:, :2].abs().max()) < 0.2
    torch.testing.assert_close(predicted(unit), plain, atol=1e-4, rtol=0)


def test_rounding_is_no_change() -> None:
    near = torch.tensor([[1000.0], [2000.0], [3000.0]], dtype=torch.float64)
    error = torch.tensor([[0.0], [1.1e-13], [-1.1e-13]], dtype=torch.float64)
    assert float(mean_and_spread(error, near)[1]) == 1
    assert float(mean_and_spread(error, 1e-9 * near)[1]) < 1e-12
    assert float(mean_and_spread(1e-3 * error)[1]) == 1
    assert float(mean_and_spread(near + error - near + 7)[1]) == 1
