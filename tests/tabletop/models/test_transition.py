"""Γ: the geometry it knows, what it learns, and what it does not."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from stand_in import DEPTH, WIDTH, transitions

from cgtorch.domains.transition import Grid, HeldOut
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.ground.errors import DataError
from cgtorch.tabletop.models import TableTransitionModel, geometry
from cgtorch.tabletop.models.transition import DECISIVE

GRID = Grid([2.0], [2.0, 6.0], [0.1], 400)


@pytest.fixture(scope="module")
def fitted():
    return fit_transition_model(TableTransitionModel(), *transitions(900, 1), grid=GRID)


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
    extents = geometry.loosely_turned(geometry.to_parts(p)[:, 2:4], u[:, 2])
    moved = geometry.move_rigidly(geometry.to_parts(p), u)
    loose = geometry.from_parts(torch.cat([moved[:, :2], extents, moved[:, 4:]], 1))
    assert np.allclose(report.baseline_error, (loose - q).abs().mean(0), rtol=0.15)


def test_the_sides_of_the_table_are_found(fitted):
    model, _ = fitted
    assert np.allclose(model.sides, [DEPTH, WIDTH], atol=0.005)
    yaw = torch.linspace(-3, 3, 40, dtype=torch.float64)
    for sides in ([0.5, 2.0], [0.7, 0.75]):
        exact = torch.tensor(sides, dtype=torch.float64)
        found = geometry.table_sides(geometry.turned_extents(yaw, exact))
        assert torch.allclose(found, exact, atol=1e-5)


def test_a_square_table_does_no_harm():
    square = torch.tensor([0.9, 0.9], dtype=torch.float64)
    yaw = torch.linspace(-3, 3, 40, dtype=torch.float64)
    extents = geometry.turned_extents(yaw, square)
    found = geometry.table_sides(extents)
    assert bool(torch.isfinite(found).all())
    parts = torch.cat([torch.zeros(40, 2), extents, torch.full((40, 3), 0.3)], 1)
    yaws = geometry.mirror_yaws(parts, found)
    assert bool(torch.isfinite(geometry.turned_extents(yaws[:, 0], found)).all())


@given(st.floats(-np.pi, np.pi), st.floats(0.3, 1.5), st.floats(1.05, 3.0))
def test_one_of_the_two_yaws_is_the_tables(yaw, short, ratio):
    sides = torch.tensor([short, short * ratio], dtype=torch.float64)
    extents = geometry.turned_extents(torch.tensor(yaw, dtype=torch.float64), sides)
    parts = torch.cat([extents.new_zeros(2), extents, extents.new_tensor([0.2, 0.1, 0.7])])
    yaws = geometry.mirror_yaws(parts, sides)
    for turn in (0.0, 0.4, 2.0):
        motion = torch.tensor([0.0, 0.0, turn], dtype=torch.float64)
        after = geometry.turned_extents(torch.tensor(yaw - turn, dtype=torch.float64), sides)
        error = (geometry.boxes_after(yaws, motion, sides) - after).norm(dim=-1)
        assert float(error.min()) < 1e-5


def test_noise_is_not_chased(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(50, 3), torch.float64)
    after = geometry.move_rigidly(geometry.to_parts(p), u)
    predicted = geometry.to_parts(model(p, u))
    assert torch.allclose(predicted[:, [0, 1, 4, 5, 6]], after[:, [0, 1, 4, 5, 6]], atol=1e-6)


def test_what_cannot_be_learnt_is_left_alone():
    p, u, q = transitions(200, 4)
    rng = np.random.default_rng(0)
    p[:, 4:6] = (p[:, [0, 2]] + p[:, [1, 3]]) / 2 + rng.uniform(-0.3, 0.3, (200, 2))  # anywhere
    model, report = fit_transition_model(
        TableTransitionModel(), p, u, q, dtype=torch.float64, grid=GRID
    )
    assert report.choice == (None,)
    assert not model.machine.weights.any()
    rows = _torch((p, u, q), torch.float64)
    features, tells = model.features(*rows[:2]), model.targets(*rows)[1]
    assert not model.machine.values(features).any()
    known = features[tells]
    assert len(model.machine.centres) == len(known)
    # Novelty is told by the centres that are left.
    again = deepcopy(model)
    again.measure_reach(known)
    assert float(model.reach) == pytest.approx(float(again.reach))


def test_errors_are_those_of_values_that_were_held_out(fitted):
    """With false ones, turning the box loosely is better."""
    p, u, q = _torch(transitions(300, 15), torch.float64)
    target, tells = fitted[0].targets(p, u, q)
    assert not tells.all()

    def settled(value, learnt=True):
        model = deepcopy(fitted[0]).double()
        held = HeldOut(tells, value[tells], target[tells], torch.tensor([learnt]))
        return *model.settle((p, u, q), held), float(model.trust)

    error, loose, trust = settled(target)
    assert trust == 1
    assert (error[:4] < 0.5 * loose[:4]).all()
    wrong, same, trust = settled(-target)
    assert trust == 0
    assert torch.equal(wrong, same)
    assert torch.equal(same, loose)
    unknown, nought = settled(target, learnt=False), settled(0 * target, learnt=False)
    assert torch.equal(unknown[0], nought[0])


def test_targets_say_which_of_the_two_yaws_was_right(fitted):
    model = deepcopy(fitted[0]).double()
    p, u, q = _torch(transitions(200, 16), torch.float64)
    scene, parts = model._scene(p, u), geometry.to_parts(q)
    first, second = geometry.boxes_after(scene.yaws, u, scene.sides).unbind(-2)
    between = first - second
    for extents, wanted in (
        (first, 1), (second, -1), ((first + second) / 2, 0), (first - 0.25 * between, 0.5),
        (first + between, 1), (second - between, -1),
    ):  # fmt: skip
        parts[:, geometry.EXTENTS] = extents
        target, tells = model.targets(p, u, geometry.from_parts(parts))
        assert target.shape == (200, 1)
        torch.testing.assert_close(target[tells], torch.full_like(target[tells], wanted))
        assert torch.equal(tells, between.norm(dim=1) > DECISIVE)
    assert 100 < int(tells.sum()) < 200
    yaw = torch.cat([p, torch.ones(200, 2)], 1), u, torch.cat([q, torch.ones(200, 2)], 1)
    target, tells = model.targets(*yaw)
    assert tells.all()
    assert not target.any()


def test_a_round_table_keeps_its_box():
    p, u, q = transitions(200, 5)
    for rows in (p, q):
        middle = (rows[:, [0, 2]] + rows[:, [1, 3]]) / 2
        noise = np.random.default_rng(1).normal(0, 0.005, (200, 4))
        rows[:, :4] = (middle[:, :, None] + [-0.5, 0.5]).reshape(200, 4) + noise
    model, report = fit_transition_model(TableTransitionModel(), p, u, q, grid=GRID)
    assert max(report.error[:4]) < 1.1 * max(report.baseline_error[:4])
    assert float(model.trust) in (0, 1)


def test_the_rigid_part_is_exact_without_noise():
    p, u, q = _torch(transitions(200, 4, noise=0.0), torch.float64)
    after = geometry.move_rigidly(geometry.to_parts(p), u)
    truth = geometry.to_parts(q)
    assert torch.allclose(after[:, [0, 1, 4, 5, 6]], truth[:, [0, 1, 4, 5, 6]], atol=1e-12)
    assert torch.allclose(geometry.from_parts(geometry.to_parts(p)), p)


def test_a_mirrored_scene_has_a_mirrored_future(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(50, 5), torch.float64)

    def mirrored(percept):
        return percept[:, [0, 1, 3, 2, 4, 5, 6]] * torch.tensor([1, 1, -1, -1, 1, -1, 1])

    back = u * torch.tensor([1, -1, -1])
    assert torch.allclose(model(mirrored(p), back), mirrored(model(p, u)), atol=1e-6)
    turned = u + torch.tensor([0, 0, 2 * torch.pi])
    assert torch.allclose(model(p, turned), model(p, u), atol=1e-6)


def test_gradients_equal_finite_differences():
    model = fit_transition_model(
        TableTransitionModel(), *transitions(200, 6), dtype=torch.float64, grid=GRID
    )[0]
    assert float(model.trust) == 1
    small = model.with_fewer_centres(24, *_torch(transitions(200, 6), torch.float64)[:2])
    for one in (model, small):
        p, u, _ = _torch(transitions(3, 7), torch.float64)
        assert torch.autograd.gradcheck(one, (p.requires_grad_(), u.requires_grad_()))
        assert torch.autograd.gradcheck(one.novelty, (p, u))
        far = (p + 3).detach().requires_grad_()
        assert torch.autograd.gradcheck(one.novelty, (far, u))


def test_novelty_tells_what_is_off_the_data(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(1000, 8))
    following, known = model.predict_with_novelty(p, u)
    assert torch.equal(following, model(p, u))
    assert float(known.median()) < 0.3
    assert 0 <= float(known.min()) <= float(known.max()) <= 1
    box = torch.tensor([-1.0, 1.0, -1.0, 1.0, 0, 0, 0])
    away = torch.tensor([2.0, 2.0, 0, 0, 2.0, 0, 0]) * p[:, 4:5].sign()
    off_table = torch.tensor([0, 0, 0, 0, 1.5, 1.5, 0])
    for strange, motion in (
        (p + box, u),
        (p + away, u),
        (p + off_table, u),
        (p, 3 * u * torch.tensor([1, 1, 0]) + torch.tensor([2.0, 0, 0])),
    ):
        novelty = model.novelty(strange, motion)
        assert float(novelty.median()) > 0.8
        assert float(novelty.quantile(0.1)) > float(known.quantile(0.9))


def test_a_row_is_answered_alike_in_every_batch(fitted):
    """Bit for bit, or a threshold on novelty could fall out otherwise beside other rows."""
    model, _ = fitted
    p, u, _ = _torch(transitions(300, 8))
    following, novelty = model.predict_with_novelty(p, u)
    for begin, rows in ((0, 1), (1, 2), (7, 3), (20, 13), (50, 31), (99, 64), (200, 100)):
        part = slice(begin, begin + rows)
        one, how = model.predict_with_novelty(p[part], u[part])
        assert torch.equal(one, following[part])
        assert torch.equal(how, novelty[part])


def test_what_was_learnt_on_is_no_longer_beyond_the_data():
    p, u, q = _torch(transitions(400, 1), torch.float64)
    start, _ = fit_transition_model(TableTransitionModel(), p, u, q, dtype=torch.float64, grid=GRID)
    far = 3 * u * torch.tensor([1.0, 1, 0])
    assert float(start.novelty(p, far).median()) > 0.8
    after = start.updated(torch.cat([p, p]), torch.cat([u, far]), torch.cat([q, start(p, far)]))
    assert float(after.novelty(p, far).median()) < 0.5
    assert (after.most >= start.most).all()


def test_a_compact_model_knows_its_own_rim(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(900, 1))
    for centres in (16, 64):
        small = model.with_fewer_centres(centres, p, u)
        assert float((small.novelty(p, u) <= 0.5).float().mean()) == pytest.approx(0.95, abs=0.02)


def test_novelty_costs_no_further_kernel_evaluation(fitted, monkeypatch):
    model, _ = fitted
    calls = []
    original = type(model.machine).values_and_distance
    monkeypatch.setattr(
        type(model.machine),
        "values_and_distance",
        lambda self, x: calls.append(len(x)) or original(self, x),
    )
    p, u, _ = _torch(transitions(20, 8))
    model.predict_in_torch(p, u)
    assert calls == [20]


def test_shapes_and_broadcasting(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(6, 9))
    assert model(p.reshape(2, 3, 7), u.reshape(2, 3, 3)).shape == (2, 3, 7)
    assert torch.allclose(model(p[0], u)[4], model(p[0], u[4]), atol=1e-5)
    with pytest.raises(DataError, match="a percept has 6 numbers; give 7"):
        model(p[:, :6], u)


def test_same_seed_same_model():
    data = transitions(120, 10)
    first, second = (
        fit_transition_model(TableTransitionModel(), *data, seed=3, grid=GRID)[0].state_dict()
        for _ in range(2)
    )
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_learning_on_reaches_the_fit_on_all_data(fitted):
    p, u, q = transitions(400, 11)
    start, _ = fit_transition_model(
        TableTransitionModel(), p[:60], u[:60], q[:60], dtype=torch.float64, grid=GRID
    )
    grown = start.updated(p, u, q)
    fresh_p, fresh_u, fresh_q = _torch(transitions(1500, 12), torch.float64)
    before = (start(fresh_p, fresh_u) - fresh_q)[:, :4].abs().mean()
    after = (grown(fresh_p, fresh_u) - fresh_q)[:, :4].abs().mean()
    assert float(after) < float(before)
    known = _torch((p[:60], u[:60], q[:60]), torch.float64)
    error = [float((m(*known[:2]) - known[2]).abs().mean()) for m in (start, grown)]
    assert error[1] < error[0] * 1.5
    with pytest.raises(DataError, match="do not begin with"):
        start.updated(p[:20], u[:20], q[:20])


def test_a_compact_model_loses_little(fitted):
    model, _ = fitted
    p, u, _ = _torch(transitions(900, 1))
    small = model.with_fewer_centres(128, p, u)
    assert len(small.machine.centres) == 128 < len(model.machine.centres)
    fresh = _torch(transitions(900, 13))[:2]

    def lost(compacted):
        """Of the machine's values and of the next percepts, on fresh transitions."""
        values = (one.machine.values(one.features(*fresh)) for one in (compacted, model))
        both = (*values, compacted(*fresh), model(*fresh))
        return [(a - b).abs().mean(0).detach() for a, b in zip(both[::2], both[1::2], strict=True)]

    value, metres = lost(small)
    assert max(metres[:4]) < 0.02
    assert max(metres[4:]) < 1e-6
    worse = lost(model.with_fewer_centres(16, p, u))
    assert worse[0].sum() > value.sum()
    assert worse[1].sum() > metres.sum()


def test_the_learning_curve_falls(fitted):
    _, report = fitted
    curve = report.learning_curve
    test = np.mean(curve.test_scores, axis=1)
    assert test[-1] > test[0] + 0.05
    assert -report.grid_scores[0][0][0][0] < 1


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
        fit_transition_model(TableTransitionModel(), *change(*transitions(30)), grid=GRID)


def test_what_features_are_scaled_by_is_known_as_it_is_stored():
    """In float32, also while learning in float64."""
    p, u, q = _torch(transitions(60, 14), torch.float64)
    rounded, exact = TableTransitionModel(), TableTransitionModel()
    rounded.standardise(p, u, q, torch.float32)
    exact.standardise(p, u, q, torch.float64)
    for name in ("mean", "scale", "sides", "most"):
        value, whole = getattr(rounded, name), getattr(exact, name)
        assert value.dtype == whole.dtype == torch.float64
        assert torch.equal(value, whole.float().double())
        assert not torch.equal(value, whole)


def test_features_have_one_scale_and_the_largest_extremes_are_kept():
    p, u, q = _torch(transitions(60, 14), torch.float64)
    model = TableTransitionModel()
    model.standardise(p, u, q, torch.float64)
    x = model.features(p, u)
    assert x.mean(0).abs().max() < 1e-9
    assert float(x.square().mean()) == pytest.approx(1)
    assert len(model.scale.unique()) == 1
    torch.testing.assert_close(model.most, model.extremes(p, u).amax(0))
    wide = geometry.to_parts(torch.cat([p, q]))[:, geometry.EXTENTS]
    torch.testing.assert_close(model.sides, geometry.table_sides(wide))
    still = p[:1].expand(9, -1)
    model.standardise(still, 0 * u[:9], still, torch.float64)
    assert model.scale.tolist() == [1.0] * 4
    assert model.most[1:3].tolist() == [1e-3] * 2
