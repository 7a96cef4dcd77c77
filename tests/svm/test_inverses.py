"""Inverses of kernel matrices, whole and factored, against dense ones in float64."""

import pytest
import torch

from cgtorch.svm.inverses import Factored, Whole, inverse, low_rank
from cgtorch.svm.kernels import kernel_matrix, make_kernel
from cgtorch.svm.pivoted_cholesky import pivoted_cholesky


def _matrix(gamma: float) -> torch.Tensor:
    x = torch.randn(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return kernel_matrix(make_kernel("rbf", gamma), x)


@pytest.mark.parametrize(("gamma", "kind"), [(0.01, Factored), (5.0, Whole)])
def test_both_kinds_add_the_projected_product(gamma: float, kind: type) -> None:
    matrix = _matrix(gamma)
    factor = low_rank(matrix)
    found = inverse(matrix, factor, 0.5)
    assert isinstance(found, kind)
    dense = torch.linalg.inv(matrix + 0.5 * torch.eye(200))
    rows = dense.sum(1)
    projected = 0.5 * (dense - torch.outer(rows, rows) / rows.sum())
    generator = torch.Generator().manual_seed(1)
    x, v = torch.randn(2, 4, 200, generator=generator)
    added = found.add(x, v)
    assert float((added - x - v @ projected.float()).abs().max()) < 0.02
    assert float((added - x).sum(1).abs().max()) < 1e-3
    torch.testing.assert_close(found.rows, rows, rtol=0, atol=0.05 * float(rows.abs().max()))
    torch.testing.assert_close(found.total, found.rows.sum(), rtol=1e-4, atol=0)


def test_pivoted_cholesky_leaves_the_trace_that_it_says() -> None:
    matrix = _matrix(0.05)
    factor, chosen, rest = pivoted_cholesky(matrix.diagonal(), matrix.__getitem__, 100, 1e-2)
    missing = matrix - factor.T @ factor
    assert len(chosen) == len(factor) == len(set(chosen)) < 100
    assert float(missing.trace()) == pytest.approx(rest, abs=1e-9)
    assert rest <= 1e-2
    assert float(torch.linalg.eigvalsh(missing).min()) > -1e-9


def test_pivoted_cholesky_stops_where_the_rank_would_be_too_large() -> None:
    matrix = _matrix(50.0)
    factor, _, rest = pivoted_cholesky(matrix.diagonal(), matrix.__getitem__, 80, 1e-2)
    assert len(factor) == 20
    assert rest > 1.0
