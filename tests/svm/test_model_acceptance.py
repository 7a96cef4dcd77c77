"""Whether a model may be replaced."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.statistics import accept_model


def test_better_and_equal_models_are_taken_and_worse_ones_refused():
    error = torch.rand(200, generator=seeded(0))
    noise = 0.01 * torch.randn(200, generator=seeded(1))
    assert accept_model(error, error).accepted
    assert accept_model(error, error - 0.1).accepted
    assert not accept_model(error, error + 0.01 + noise / 100).accepted
    assert accept_model(error, error + noise - noise.mean()).accepted
    worse = accept_model(error, error + 0.1)
    assert worse.reason.startswith("refused")
    assert f"{worse.after:.4f}" in worse.reason


def test_without_data_there_is_no_reason_to_refuse():
    assert accept_model(torch.zeros(0), torch.zeros(0)).accepted


@given(st.integers(2, 50), st.integers(0, 2**31), st.floats(-1, 1))
def test_the_tolerance_is_two_standard_errors(rows, seed, shift):
    before, after = torch.rand(2, rows, dtype=torch.float64, generator=seeded(seed))
    acceptance = accept_model(before, after + shift)
    loss = after + shift - before
    assert acceptance.accepted == bool(loss.mean() <= 2 * loss.std() / rows**0.5)
    assert acceptance.rows == rows
