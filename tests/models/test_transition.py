"""Γ: the geometry it knows, what it learns, and what it does not."""

import numpy as np
import pytest
import torch
from tabletop import transitions

from cgtorch.errors import DataError
from cgtorch.models import (
    compact_transition_model,
    fit_transition_model,
    geometry,
    update_transition_model,
)

GRID = {"C": [4.0], "gamma": [0.1, 0.3], "grid_rows": 500}


@pytest.fixture(scope="module")
def fitted():
    return fit_transition_model(*transitions(900, 1), **GRID)


def _torch(arrays, dtype=torch.float32):
    return [torch.tensor(a, dtype=dtype) for a in arrays]


def test_it_beats_the_rigid_motion_where_there_is_something_to_learn(fitted):
    model, report = fitted
    p, u, q = _torch(transitions(2000, 2))
    error = (model(p, u) - q).abs().mean(0)
    rigid = geometry.from_parts(geometry.move_rigidly(geometry.to_parts(p), u))
    base = (rigid - q).abs().mean(0)
    assert bool((error[:4] < 0.5 * base[:4]).all())
    assert bool((error[4:] < 0.01).all())
    assert np.allclose(report.error, error, rtol=0.35)
    assert np.allclose(report.rigid_error, base, rtol=0.15)


def test_noise_is_not_chased(fitted):
    model, report = fitted
    assert [c is not None for c in report.choice] == [False, False, True, True] + [False] * 3
    p, u, _ = _torch(transitions(50, 3), torch.float64)
    assert torch.allclose(model(p, u)[:, 6], p[:, 6], atol=1e-7)


def test_the_rigid_part_is_exact_without_noise():
    p, u, q = _torch(transitions(200, 4, noise=0.0), torch.float64)
    after = geometry.move_rigidly(geometry.to_parts(p), u)
    truth = geometry.to_parts(q)
    assert torch.allclose(after[:, [0, 1, 4, 5, 6]], truth[:, [0, 1, 4, 5, 6]], atol=1e-12)
    assert torch.allclose(geometry.from_parts(geometry.to_parts(p)), p)


def test_features_respect_the_symmetries():
    p, u, _ = _torch(transitions(50, 5), torch.float64)
    parts = geometry.to_parts(p)
    features = geometry.turn_features(parts, u)
    mirrored, back = parts.clone(), u.clone()
    mirrored[:, [1, 5]] *= -1
    back[:, 1:] *= -1
    assert torch.allclose(geometry.turn_features(mirrored, back), features)
    turned = u.clone()
    turned[:, 2] += torch.pi
    assert torch.allclose(geometry.turn_features(parts, turned), features, atol=1e-12)


def test_gradients_equal_finite_differences(fitted):
    model = fit_transition_model(*transitions(150, 6), dtype=torch.float64, **GRID)[0]
    p, u, _ = _torch(transitions(3, 7), torch.float64)
    assert torch.autograd.gradcheck(model, (p.requires_grad_(), u.requires_grad_()))
    assert torch.autograd.gradcheck(model.novelty, (p, u))


def test_novelty_grows_away_from_the_data(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(1000, 8))
    following, known = model.predict_with_novelty(p, u)
    assert torch.equal(following, model(p, u))
    assert float(known.median()) < 0.3
    strange = p + torch.tensor([-1.0, 1.0, -1.0, 1.0, 0, 0, 0])
    assert float(model.novelty(strange, u).min()) > 0.9
    assert 0 <= float(known.min()) <= float(known.max()) <= 1


def test_shapes_and_broadcasting(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(6, 9))
    assert model(p.reshape(2, 3, 7), u.reshape(2, 3, 3)).shape == (2, 3, 7)
    assert torch.allclose(model(p[0], u)[4], model(p[0], u[4]), atol=1e-5)
    with pytest.raises(DataError, match=r"\(\.\.\., 7\)"):
        model(p[:, :6], u)


def test_same_seed_same_model():
    data = transitions(120, 10)
    first, second = (fit_transition_model(*data, seed=3, **GRID)[0].state_dict() for _ in range(2))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_learning_on_reaches_the_fit_on_all_data(fitted):
    p, u, q = transitions(400, 11)
    start, _ = fit_transition_model(p[:250], u[:250], q[:250], dtype=torch.float64, **GRID)
    grown = update_transition_model(start, p, u, q)
    fresh_p, fresh_u, fresh_q = _torch(transitions(1500, 12), torch.float64)
    before = (start(fresh_p, fresh_u) - fresh_q)[:, :4].abs().mean()
    after = (grown(fresh_p, fresh_u) - fresh_q)[:, :4].abs().mean()
    assert float(after) < float(before)
    known = _torch((p[:250], u[:250], q[:250]), torch.float64)
    error = [float((m(*known[:2]) - known[2]).abs().mean()) for m in (start, grown)]
    assert error[1] < error[0] * 1.5
    with pytest.raises(DataError, match="do not begin with"):
        update_transition_model(start, p[:20], u[:20], q[:20])


def test_a_compact_model_says_what_it_lost(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(900, 1))
    small, report = compact_transition_model(model, 128, p, u)
    assert report.centres == 128 == len(small.machine.centres)
    assert report.before == len(model.machine.centres)
    fresh = _torch(transitions(500, 13))[:2]
    difference = (small(*fresh) - model(*fresh)).abs().mean()
    assert float(difference) < 0.02
    _, more = compact_transition_model(model, 16, p, u)
    assert sum(more.mean_loss) > sum(report.mean_loss)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p, u, q: (p, u[:-1], q), "rows"),
        (lambda p, u, q: (p[:, :6], u, q), "7"),
        (lambda p, u, q: (p * np.nan, u, q), "NaN"),
        (lambda p, u, q: (p[:3], u[:3], q[:3]), "folds"),
    ],
)
def test_bad_data_are_refused(change, says):
    with pytest.raises(DataError, match=says):
        fit_transition_model(*change(*transitions(30)), **GRID)
