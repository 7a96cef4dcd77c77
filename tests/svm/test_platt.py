"""Platt's sigmoid by itself; its fit is compared with scikit-learn's in test_parity.py."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.svm.platt import fit_platt, probability

SLOPE, OFFSET = torch.tensor(-1.7), torch.tensor(0.2)


@given(first=st.integers(0, 499), count=st.integers(1, 100))
def test_a_decision_has_the_same_probability_in_every_batch(first, count):
    decision = torch.linspace(-9, 9, 600)
    part = slice(first, first + count)
    whole = probability(decision, SLOPE, OFFSET)
    assert torch.equal(probability(decision[part], SLOPE, OFFSET), whole[part])


def test_probability_is_the_formula_and_rises_with_the_decision():
    decision = torch.linspace(-40, 40, 81, dtype=torch.float64)
    chance = probability(decision, SLOPE.double(), OFFSET.double())
    right = 1 / (1 + torch.exp(SLOPE.double() * decision + OFFSET.double()))
    torch.testing.assert_close(chance, right)
    assert (chance.diff() >= 0).all()
    assert chance.isfinite().all()


@given(st.floats(0.3, 5), st.floats(-1, 1), st.integers(0, 20))
def test_the_fit_finds_the_curve_that_labels_were_drawn_from(slope, offset, seed):
    generator = torch.Generator().manual_seed(seed)
    decision = 4 * torch.rand(20_000, generator=generator) - 2
    chance = torch.rand(20_000, generator=generator)
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
