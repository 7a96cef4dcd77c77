"""How sure a counted share is."""

import pytest

from cgtorch.ground.statistics import wilson


# From statsmodels.stats.proportion.proportion_confint(k, n, method="wilson").
@pytest.mark.parametrize(
    ("successes", "tried", "low", "high"),
    [
        (0, 10, 0.0, 0.277533),
        (1, 10, 0.017876, 0.404150),
        (5, 10, 0.236593, 0.763407),
        (10, 10, 0.722467, 1.0),
        (34, 40, 0.709250, 0.929433),
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


def test_nothing_tried() -> None:
    assert wilson(0, 0, 0.95)[0] == 0
