"""Products with a kernel matrix: compiled for sparse coefficients, the same as plain ones."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch import native
from cgtorch.svm.gram import gram


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**30),
    rows=st.integers(2, 1300),
    problems=st.integers(1, 6),
    share=st.sampled_from([0.0, 0.001, 0.1, 0.3, 0.49, 1.0]),
)
def test_products_are_those_of_matrices(seed: int, rows: int, problems: int, share: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(rows, 3, generator=generator, dtype=torch.float64)
    d = torch.randn(problems, rows, generator=generator, dtype=torch.float64)
    d *= torch.rand(problems, rows, generator=generator) < share
    kernel = gram("rbf", x, 0.5)
    found = kernel.times(d)
    torch.testing.assert_close(found, d @ kernel.matrix, atol=1e-11, rtol=1e-11)


def test_they_do_not_depend_on_the_number_of_threads() -> None:
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(1500, 3, generator=generator, dtype=torch.float64)
    d = torch.randn(4, 1500, generator=generator, dtype=torch.float64)
    d *= torch.rand(4, 1500, generator=generator) < 0.2
    kernel, found = gram("rbf", x, 0.5), []
    for threads in (1, 2, 5):
        before = native.use_threads(threads)
        try:
            found.append(kernel.times(d))
        finally:
            native.use_threads(before)
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


def test_only_few_columns_of_other_types_are_multiplied() -> None:
    x = torch.linspace(0, 1, 40, dtype=torch.float64)[:, None]
    kernel, d = gram("linear", x, 1.0), torch.zeros(2, 40, dtype=torch.float64)
    d[1, 7] = 3.0
    assert kernel.times(d)[0].abs().max() == 0
    assert float(kernel.times(d)[1, 8]) == pytest.approx(3 * float(x[7, 0] * x[8, 0]))
