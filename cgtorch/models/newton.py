"""The linear systems of a Newton step on the free coefficients, and products with the kernel."""

import torch
from torch import Tensor

_SMALL = 160  # free coefficients up to which systems are factored as one padded batch
_BATCH_ELEMENTS = 2**22


def times_kernel(d: Tensor, kernel: Tensor) -> Tensor:
    """D K (P, n) for a direction d (P, n) of which often few columns are not zero."""
    columns = d.any(0).nonzero().flatten()
    if 2 * len(columns) > len(kernel):
        return d @ kernel
    return d[:, columns] @ kernel[columns]


def solve_free(
    kernel: Tensor, single: Tensor, free: Tensor, h: Tensor, right: Tensor, precise: list[bool]
) -> tuple[Tensor, Tensor]:
    """Solve (K_FF + h I) u = right_F and (K_FF + h I) v = 1 for P free sets.

    Small systems are padded with the identity and factored together in float64, which saves the
    overhead of one call each; large ones are factored one by one, in float32 where that is enough.

    Args:
        kernel: Kernel matrix (n, n), float64.
        single: The same in float32.
        free: Free coefficients (P, n), at least one in each row.
        h: Ridges (P,).
        right: Right sides (P, n).
        precise: Which problems need float64; updated.

    Returns:
        u and v (P, n), 0 where not free.
    """
    u, v = torch.zeros_like(right), torch.zeros_like(right)
    count = free.sum(1)
    small = (count <= _SMALL).nonzero().flatten()
    size = int(count[small].max()) if len(small) else 0
    alone = (count > _SMALL).nonzero().flatten().tolist()
    for part in small.split(max(1, _BATCH_ELEMENTS // max(1, size * size))):
        good = _solve_small(kernel, free[part], h[part], right[part], size)
        u[part], v[part] = good[0], good[1]
        alone += part[good[2] != 0].tolist()
    for row in alone:
        index = free[row].nonzero().flatten()
        u[row, index], v[row, index], precise[row] = _solve_one(
            kernel, single, index, float(h[row]), right[row, index], precise[row]
        )
    return u, v


def _solve_small(
    kernel: Tensor, free: Tensor, h: Tensor, right: Tensor, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """`solve_free` for systems of at most `size` in one batch, and LAPACK's info (P,)."""
    index = free.byte().argsort(dim=1, descending=True, stable=True)[:, :size]
    real = free.gather(1, index).to(right)
    matrix = kernel[index[:, :, None], index[:, None, :]]
    matrix = matrix * real[:, :, None] * real[:, None, :]
    matrix.diagonal(dim1=1, dim2=2).add_(h[:, None] * real + (1 - real))
    columns = torch.stack([right.gather(1, index) * real, real], dim=2)
    factor, info = torch.linalg.cholesky_ex(matrix)
    solved = torch.cholesky_solve(columns, factor)
    solved = torch.where((info == 0)[:, None, None], solved, 0.0)
    u, v = torch.zeros_like(right), torch.zeros_like(right)
    return u.scatter(1, index, solved[:, :, 0]), v.scatter(1, index, solved[:, :, 1]), info


def _solve_one(
    kernel: Tensor, single: Tensor, free: Tensor, ridge: float, right: Tensor, precise: bool
) -> tuple[Tensor, Tensor, bool]:
    """Solve (K_FF + ridge I) x = [right, 1] and return both columns and whether float64 was used.

    The factor is made in float32 and again in float64 where its smallest pivot says that
    rounding would show.
    """
    columns = torch.stack([right, torch.ones_like(right)], dim=1)
    for source in (kernel,) if precise else (single, kernel):
        matrix = source.index_select(0, free).index_select(1, free)
        matrix.diagonal().add_(ridge)
        scale = float(matrix.diagonal().max())
        factor, info = torch.linalg.cholesky_ex(matrix)
        smallest = float(factor.diagonal().min()) ** 2 / scale
        if int(info) == 0 and (source is kernel or smallest > 2e-5):
            solved = torch.cholesky_solve(columns.to(source.dtype), factor).to(kernel.dtype)
            return solved[:, 0], solved[:, 1], source is kernel
    # Rounding made even the float64 matrix indefinite: a little more ridge is a shorter step.
    values, vectors = torch.linalg.eigh(matrix)
    values = values.clamp_min(scale * 1e-14 * len(free))
    solved = vectors @ ((vectors.T @ columns) / values[:, None])
    return solved[:, 0], solved[:, 1], True
