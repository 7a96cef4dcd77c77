"""Compiled values of RBF machines and kernel matrices: of the definition, for all sizes apart."""

import pytest
import torch
from support import seeded

from cgtorch.native import available, function
from cgtorch.svm.rbf import machine_values

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

FLOATS = [torch.float32, torch.float64]
SIZES = [(1, 4), (1, 7), (1, 8), (1, 5), (7, 10), (7, 9), (2, 5), (3, 4), (16, 64)]
"""Numbers of outputs and features, of which some have code of their own."""


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize(("outputs", "features"), SIZES)
def test_values_are_those_of_the_definition(
    outputs: int, features: int, dtype: torch.dtype
) -> None:
    """Whether rows are alone, come by twos and fours, or are left over."""
    g = seeded(outputs + features)
    x, centres, weights, bias = (
        torch.randn(shape, generator=g, dtype=torch.float64)
        for shape in ((11, features), (19, features), (19, outputs), (outputs,))
    )
    gamma = 0.4 / features
    exponent = gamma * (x[:, None] - centres).square().sum(2)
    machine = (
        *(each.to(dtype) for each in (centres, weights, bias)),
        torch.tensor(gamma, dtype=torch.float64),
    )
    digits = 2e-5 if dtype == torch.float32 else 1e-8
    for count in (1, 2, 3, 4, 5, 7, 8, 11):
        found = machine_values(x[:count].to(dtype), *machine)
        assert found is not None
        values, nearest = found
        wanted = (-exponent[:count]).exp() @ weights + bias
        torch.testing.assert_close(values.double(), wanted, atol=digits, rtol=digits)
        least = exponent[:count].amin(1) / torch.tensor(2.0).double().log()
        torch.testing.assert_close(nearest.double(), least, atol=digits, rtol=digits)
        alone = machine_values(x[count - 1 : count].to(dtype), *machine)
        assert alone is not None
        assert torch.equal(alone[0], values[-1:])
        assert torch.equal(alone[1], nearest[-1:])


@pytest.mark.parametrize("wrong", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("outputs", [1, 2, 3])
def test_a_row_that_is_not_finite_has_no_values_and_leaves_the_others_theirs(
    outputs: int, wrong: float
) -> None:
    x, weights = torch.ones(6, 3), torch.ones(5, outputs)
    machine = torch.arange(15.0).view(5, 3), weights, torch.zeros(outputs), torch.tensor(0.1)
    wanted = machine_values(x, *machine)
    for place in range(3):
        x[4, place] = wrong
        found = machine_values(x, *machine)
        assert wanted is not None
        assert found is not None
        rest = torch.arange(6) != 4
        for one, other in zip(found, wanted, strict=True):
            assert bool(one[4].isnan().all())
            assert torch.equal(one[rest], other[rest])
        x[4, place] = 1.0


@pytest.mark.parametrize("dtype", FLOATS)
def test_faint_values_of_a_matrix_are_zero(dtype: torch.dtype) -> None:
    """Of two rows that are so far apart that their value is 2^-square."""
    call, zero = function("rbf_gram", dtype), torch.zeros(16, dtype=dtype)
    for gap, there in (((0, 0), True), ((6, 1.99), True), ((6, 2), False), ((40, 20), False)):
        columns = torch.zeros(2, 16, dtype=torch.float64)
        columns[:, 1] = torch.tensor(gap)
        matrix = torch.full((2, 16), 7.0, dtype=dtype)
        assert call is not None
        call(columns, 2, 2, 16, matrix, 1)
        wanted = zero + 1
        wanted[1] = 2.0 ** -(gap[0] ** 2 + gap[1] ** 2) if there else 0
        torch.testing.assert_close(matrix[0], wanted, rtol=3e-6, atol=0)
        torch.testing.assert_close(matrix[1, :2], wanted[:2].flip(0), rtol=3e-6, atol=0)
