"""Which centres a smaller machine keeps, and what it says of its loss."""

import pytest
import torch

from cgtorch.ground.errors import SettingsError
from cgtorch.svm import SVR, fit_reduced_set
from cgtorch.svm.gram import rbf
from cgtorch.svm.reduced_set import pivots


def _rows(count: int) -> torch.Tensor:
    return torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def test_each_centre_is_the_row_that_those_before_explain_least() -> None:
    x = _rows(200)
    matrix = rbf(x, x, 0.05)
    chosen = pivots(x, 0.05, 40).tolist()
    assert len(set(chosen)) == 40
    for count in range(1, 40):
        some = matrix[chosen[:count]]
        rest = matrix - some.T @ torch.linalg.solve(some[:, chosen[:count]], some)
        left = rest.diagonal()
        assert float(left[chosen[count]]) >= float(left.max()) - 1e-9
        assert float(torch.linalg.eigvalsh(rest).min()) > -1e-9


def test_what_is_explained_already_is_not_chosen() -> None:
    x = _rows(10)[torch.arange(60) % 10]
    assert len(pivots(x, 0.5, 60)) == 10


def test_more_centres_lose_less() -> None:
    x = _rows(400)
    machine = SVR(5.0, gamma=0.3, epsilon=0.01).fit(x[:300], (2 * x[:300, 0]).sin())
    losses = []
    for centres in (10, 30, 90):
        small = fit_reduced_set(machine, centres, x)
        assert len(small.centres) == centres
        error = (small.predict(x) - machine.predict(x)).abs()
        losses.append(float(error[3::4].mean()))
    assert losses == sorted(losses, reverse=True)
    with pytest.raises(SettingsError, match="8 rows"):
        fit_reduced_set(machine, 4, x[:7])
