"""How sure a counted share is, and whether a model may be replaced."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.statistics import Acceptance, accept_model, wilson


# From statsmodels.stats.proportion.proportion_confint(k, n, method="wilson").
@pytest.mark.parametrize(
    ("successes", "tried", "low", "high"),
    [
        (0, 10, 0.0, 0.277533),
        (1, 10, 0.017876, 0.404150),
        (10, 10, 0.722467, 1.0),
        (81, 263, 0.255297, 0.366210),  # Newcombe 1998, table I, method 3: 0.2553 to 0.3662
        (15, 148, 0.062386, 0.160508),  # … 0.0624 to 0.1605
        (0, 20, 0.0, 0.161125),  # … 0.0000 to 0.1611
        (1, 29, 0.006113, 0.171755),  # … 0.0061 to 0.1718
    ],
)
def test_the_interval_is_wilsons(successes: int, tried: int, low: float, high: float) -> None:
    interval = wilson(successes, tried, 0.95)
    assert interval == pytest.approx((low, high), abs=1e-4)
    assert interval[0] - 1e-9 <= successes / tried <= interval[1] + 1e-9
    assert wilson(0, 0, 0.95)[0] == 0


def test_better_and_equal_models_are_taken_and_worse_ones_refused() -> None:
    error = torch.rand(200, generator=seeded(0))
    noise = 0.01 * torch.randn(200, generator=seeded(1))
    assert accept_model(error, error).accepted
    assert accept_model(error, error - 0.1).accepted
    assert not accept_model(error, error + 0.01 + noise / 100).accepted
    assert accept_model(error, error + noise - noise.mean()).accepted
    worse = accept_model(error, error + 0.1)
    assert worse.reason.startswith("refused")
    assert f"{worse.after:.4f}" in worse.reason


def test_less_than_two_rows_say_nothing_against_a_model() -> None:
    assert accept_model(torch.zeros(0), torch.zeros(0)) == Acceptance(True, 0, 0, 0, 0)
    one = accept_model(torch.tensor([0.25]), torch.tensor([0.75]))
    assert one == Acceptance(True, 1, 0.25, 0.75, 0)
    assert one.reason == (
        "taken: error 0.7500 after 0.2500 on 1 earlier rows held out, tolerance 0.0000"
    )


@given(st.integers(2, 50), st.integers(0, 2**31), st.floats(-1, 1))
def test_the_tolerance_is_two_standard_errors(rows: int, seed: int, shift: float) -> None:
    before, after = torch.rand(2, rows, dtype=torch.float64, generator=seeded(seed))
    acceptance = accept_model(before, after + shift)
    loss = after + shift - before
    assert acceptance.accepted == bool(loss.mean() <= 2 * loss.std() / rows**0.5)
    assert acceptance.rows == rows
    assert acceptance.before == pytest.approx(float(before.mean()))
    assert acceptance.after == pytest.approx(float((after + shift).mean()))
    assert acceptance.tolerance == pytest.approx(2 * float(loss.std()) / rows**0.5)
