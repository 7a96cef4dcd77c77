"""Smaller machines: which centres and which training rows they keep, and what that loses."""

from itertools import combinations

import pytest
import torch
from dual_problems import rows
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.errors import ModelError, SettingsError
from cgtorch.svm import SVR, fit_reduced_set
from cgtorch.svm.rbf import rbf
from cgtorch.svm.reduced_set import _least_squares, coreset, pivots, shrink_to_coreset


def test_each_centre_is_the_row_that_those_before_explain_least() -> None:
    x = rows(0, 200)[:, :3]
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
    assert len(pivots(rows(0, 10)[torch.arange(60) % 10], 0.5, 60)) == 10


def test_more_centres_lose_less() -> None:
    x = rows(0, 400)[:, :3]
    machine = SVR(5.0, gamma=0.3, epsilon=0.01).fit(x[:300], (2 * x[:300, 0]).sin())
    losses = []
    for centres in (10, 30, 90):
        small = fit_reduced_set(machine, centres, x)
        assert len(small.centres) == centres
        losses.append(float((small.predict(x) - machine.predict(x)).abs()[3::4].mean()))
    assert losses == sorted(losses, reverse=True)
    with pytest.raises(SettingsError, match="8 rows"):
        fit_reduced_set(machine, 4, x[:7])


@given(st.integers(1, 4), st.sampled_from([1e-6, 0.01, 1.0]), st.integers(0, 2**31))
def test_weights_are_those_of_ridge_regression_with_a_free_bias(
    outputs: int, ridge: float, seed: int
) -> None:
    draw = torch.randn(30, 5 + outputs, dtype=torch.float64, generator=seeded(seed))
    design, truth = torch.nn.functional.pad(draw[:, :5], (0, 1), value=1.0), draw[:, 5:] + 3
    penalty = ridge**2 * 30 * torch.eye(6, dtype=torch.float64)
    penalty[5, 5] = 0
    wanted = torch.linalg.solve(design.T @ design + penalty, design.T @ truth)
    torch.testing.assert_close(_least_squares(design, truth, ridge), wanted, rtol=1e-6, atol=1e-8)


def test_a_reduced_machine_is_no_solution_and_keeps_what_it_is_made_of() -> None:
    x = rows(0, 60)[:, :2]
    machine = SVR(5.0, gamma=0.3, epsilon=0.01).fit(x, (2 * x[:, 0]).sin())
    small = fit_reduced_set(machine, 7, x)
    picked = pivots(machine.centres, 0.3, 7)
    assert torch.equal(small.centres, machine.centres[picked])
    assert torch.equal(small.support, machine.support[picked])
    assert small.gap.tolist() == [torch.inf]
    assert float(small.gamma_value) == float(machine.gamma_value)
    assert machine.gap.isfinite().all()
    # Every centre, and a ridge that is nearly none, give the machine itself.
    whole = fit_reduced_set(machine, 1000, x)
    assert len(whole.centres) == len(pivots(machine.centres, 0.3, 1000))
    torch.testing.assert_close(whole.predict(x), machine.predict(x), rtol=0, atol=1e-3)
    fit_reduced_set(machine, 1, x[:8])
    for centres, count in ((0, 60), (1, 7)):
        with pytest.raises(SettingsError, match=f"not {centres} and {count}"):
            fit_reduced_set(machine, centres, x[:count])
    with pytest.raises(ModelError, match="has not been fitted"):
        fit_reduced_set(SVR(), 3, x)


def test_a_shrunken_machine_has_the_kept_centres_at_their_new_places() -> None:
    x = rows(1, 50)[:, :2]
    machine = SVR(5.0, gamma=0.3, epsilon=0.3).fit(x, (2 * x[:, 0]).sin())
    support, weights = machine.support.clone(), machine.weights.clone()
    assert 8 < len(support) < 50
    for limit in (len(support) + 3, 8):
        chosen = shrink_to_coreset(machine, x, limit)
        assert len(chosen) == limit
        x = x[chosen]
        torch.testing.assert_close(machine.centres, x[machine.support])
        kept = torch.isin(weights, machine.weights).squeeze(1)
        assert torch.equal(machine.weights, weights[kept])
        assert len(machine.support) == min(limit, len(support))


@given(st.integers(1, 40), st.integers(1, 45), st.integers(0, 2**31))
def test_which_rows_stay(count: int, limit: int, seed: int) -> None:
    x = torch.randn(count, 3, generator=seeded(seed))
    keep = torch.rand(count, generator=seeded(seed)) < 0.3
    chosen = coreset(x, keep, limit).tolist()
    assert chosen == sorted(set(chosen))
    assert len(chosen) == min(count, limit)
    wanted = set(keep.nonzero().flatten().tolist())
    assert wanted <= set(chosen) or set(chosen) <= wanted


@given(st.integers(2, 9), st.integers(1, 3), st.integers(0, 2**31))
def test_no_row_is_left_farther_out_than_twice_the_best_choice(
    count: int, limit: int, seed: int
) -> None:
    x = torch.randn(count, 2, dtype=torch.float64, generator=seeded(seed))

    def radius(kept: tuple[int, ...] | list[int]) -> float:
        return float(torch.cdist(x, x[list(kept)]).amin(1).max())

    best = min(radius(kept) for kept in combinations(range(count), min(limit, count)))
    chosen = coreset(x, torch.zeros(count, dtype=torch.bool), limit).tolist()
    assert radius(chosen) <= 2 * best + 1e-12


def test_a_limit_below_one_is_refused() -> None:
    with pytest.raises(SettingsError, match="limit is 0"):
        coreset(torch.zeros(3, 2), torch.zeros(3, dtype=torch.bool), 0)
