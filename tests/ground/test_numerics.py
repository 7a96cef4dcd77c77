"""The logistic function, the angle of a vector and means, and that no neighbour changes them."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.numerics import atan2, exp2, row_means, sigmoid


def test_sigmoid_is_the_logistic_function() -> None:
    x = torch.linspace(-75, 75, 3001, dtype=torch.float64)
    torch.testing.assert_close(sigmoid(x), torch.sigmoid(x), rtol=1e-12, atol=0)
    ends = sigmoid(torch.tensor([-torch.inf, torch.inf]))
    assert ends[0] < 1e-30
    assert ends[1] == 1
    far = torch.tensor([-1e30, -100.0, 0.0, 100.0, 1e30], requires_grad=True)
    sigmoid(far).sum().backward()
    assert far.grad is not None
    assert far.grad.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@given(first=st.integers(0, 4999), count=st.integers(1, 100))
def test_no_neighbour_changes_a_number_or_an_angle(
    dtype: torch.dtype, first: int, count: int
) -> None:
    y, x = 9 * torch.randn(2, 5100, dtype=dtype, generator=seeded(0))
    part = slice(first, first + count)
    angle, share = atan2(y, x), sigmoid(x)
    torch.testing.assert_close(angle, torch.atan2(y, x))
    assert torch.equal(atan2(y[part], x[part]), angle[part])
    assert torch.equal(atan2(y[part][:, None], x[part][:, None])[:, 0], angle[part])
    assert torch.equal(sigmoid(x[part]), share[part])
    assert torch.equal(sigmoid(x[part].clone()), share[part])


@given(rows=st.integers(1, 9), columns=st.integers(0, 700), first=st.integers(0, 8))
def test_no_neighbour_changes_a_mean(rows: int, columns: int, first: int) -> None:
    x = torch.rand(rows, columns, generator=seeded(columns))
    found = row_means(x)
    torch.testing.assert_close(found, x.mean(1), rtol=1e-6, atol=0, equal_nan=True)
    part = slice(first, first + 2)
    assert torch.equal(row_means(x[part]).nan_to_num(), found[part].nan_to_num())


def test_powers_of_two_have_seven_digits() -> None:
    x = torch.linspace(-100, 100, 20_001)
    wanted = torch.exp2(x.double())
    assert float((exp2(x).double() / wanted - 1).abs().max()) < 2.5e-7
    whole = torch.arange(-100.0, 101.0)
    assert torch.equal(exp2(whole).double(), torch.exp2(whole.double()))
