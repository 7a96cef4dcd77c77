"""Newton directions for given statuses: linear systems on the free coefficients."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from cgtorch.svm.gram import Gram
from cgtorch.svm.problems import Problems
from cgtorch.svm.smoothed_loss import on_bounds

_SMALLEST_PIVOT = 2e-5  # of the diagonal, below which a factor in float32 is not to be trusted

_SMALL = 16, 32, 64  # rows of systems that are solved together, padded with rows of zeros


def direction(
    gram: Gram,
    problems: Problems,
    h: Tensor,
    beta: Tensor,
    residual: Tensor,
    status: Tensor,
    free: Tensor,
    precise: list[bool],
) -> tuple[Tensor, Tensor, Tensor]:
    """Newton direction of the coefficients (P, n) and biases (P,), and its product with K (P, n).

    Coefficients on a bound go there; the free ones solve (K_FF + h) d + shift = right with
    coefficients that sum to 0.

    Args:
        gram: Kernel values.
        problems: P problems.
        h: Ridges (P,).
        beta: Coefficients (P, n).
        residual: z - K beta - bias (P, n).
        status: Statuses (P, n).
        free: Which coefficients are free by them (P, n), at least one in each problem.
        precise: Which problems need systems in float64; updated.
    """
    d = (on_bounds(problems, status) - beta).masked_fill_(free, 0.0)
    right = residual - h[:, None] * beta
    if bool(problems.epsilon.any()):
        right -= problems.epsilon[:, None] * status.sign()
    outer = gram.times(d)
    total = (beta + d).sum(1)
    u, v = solve_free(gram, free, h, right - outer, precise)
    shift = (u.sum(1) + total) / v.sum(1)
    inner = u - shift[:, None] * v
    return d + inner, shift, outer + gram.times(inner)


def with_pivot(
    problems: Problems, h: Tensor, residual: Tensor, clipped: Tensor, status: Tensor
) -> Tensor:
    """Statuses (P, n) with one coefficient freed in each problem that has no free one.

    Without a free coefficient the bias would have no equation. The sum of the coefficients says
    which way the bias has to go, and the first coefficient that leaves its bound on that way is
    the one to free.
    """
    empty = (status.abs() != 1).all(1).nonzero().flatten()
    if len(empty) == 0:
        return status
    part, h, r, old = problems.take(empty), h[empty, None], residual[empty], status[empty]
    width = part.epsilon[:, None]
    excess = clipped[empty].sum(1, keepdim=True) > 0
    down = torch.where(old == 2, r - width - h * part.upper, torch.inf)
    down = torch.where((old == 0) & (part.lower < 0), r + width, down)
    up = torch.where(old == -2, h * part.lower - width - r, torch.inf)
    up = torch.where((old == 0) & (part.upper > 0), width - r, up)
    pivot = torch.where(excess, down, up).clamp_min(0).argmin(1, keepdim=True)
    at = old.gather(1, pivot)
    side = torch.where(at == 0, 1 - 2 * excess.to(at), at.sign())
    status = status.clone()
    status[empty] = old.scatter(1, pivot, side)
    return status


def solve_free(
    gram: Gram, free: Tensor, h: Tensor, right: Tensor, precise: list[bool]
) -> tuple[Tensor, Tensor]:
    """Solve (K_FF + h I) u = right_F and (K_FF + h I) v = 1 for P free sets.

    Small systems are solved together in float64, large ones one by one.

    Args:
        gram: Kernel values.
        free: Free coefficients (P, n), at least one in each row.
        h: Ridges (P,).
        right: Right sides (P, n).
        precise: Which problems need float64; updated.

    Returns:
        u and v (P, n), 0 where not free.
    """
    u, v = torch.zeros_like(right), torch.zeros_like(right)
    counts, ridges = free.sum(1).tolist(), h.tolist()
    lists = free.nonzero()[:, 1].split(counts)
    large = set(range(len(h)))
    for most in _SMALL:
        few = [row for row in large if counts[row] <= most]
        if len(few) > 1:
            large.difference_update(few)
            large.update(_solve_together(gram, few, lists, h, right, u, v))
    for row in sorted(large):
        index = lists[row]
        columns = torch.ones(len(index), 2, dtype=right.dtype, device=right.device)
        columns[:, 0] = right[row, index]
        solved, precise[row] = _solve_one(gram, index, ridges[row], columns, precise[row])
        u[row, index], v[row, index] = solved[:, 0], solved[:, 1]
    return u, v


def _solve_together(
    gram: Gram,
    rows: list[int],
    lists: Sequence[Tensor],
    h: Tensor,
    right: Tensor,
    u: Tensor,
    v: Tensor,
) -> list[int]:
    """Write u and v (P, n) of problems `rows`, and say which are too near singular for that."""
    index = pad_sequence([lists[row] for row in rows], batch_first=True, padding_value=-1)
    real = index >= 0
    index, at = index.clamp_min(0), torch.tensor(rows, device=h.device)
    matrix = gram.matrix[index[:, :, None], index[:, None, :]]
    matrix *= (real[:, :, None] & real[:, None, :]).to(matrix)
    matrix.diagonal(dim1=1, dim2=2).add_(torch.where(real, h[at, None], 1.0))
    columns = torch.stack([right[at[:, None], index] * real, real.to(right)], 2)
    factor, info = torch.linalg.cholesky_ex(matrix)
    solved = torch.cholesky_solve(columns, factor)
    good = real & (info == 0)[:, None]
    place = at[:, None].expand_as(index)[good], index[good]
    u[place], v[place] = solved[..., 0][good], solved[..., 1][good]
    return [row for row, bad in zip(rows, info.tolist(), strict=True) if bad]


def _solve_one(
    gram: Gram, index: Tensor, ridge: float, columns: Tensor, precise: bool
) -> tuple[Tensor, bool]:
    """Solve (K_FF + ridge I) x = columns (f, 2), and say whether float64 was used.

    The factor is made in float32 and again in float64 where its smallest pivot says that
    rounding would show.
    """
    for exact in (True,) if precise else (False, True):
        matrix = gram.block(index, precise=exact)
        matrix.diagonal().add_(ridge)
        factor, info = torch.linalg.cholesky_ex(matrix)
        pivots = factor.diagonal()
        good = int(info) == 0 and (
            exact or float(pivots.min()) > _SMALLEST_PIVOT**0.5 * float(pivots.max())
        )
        if good:
            return torch.cholesky_solve(columns.to(factor.dtype), factor).to(columns.dtype), exact
    # Rounding made even the float64 matrix indefinite: a little more ridge is a shorter step.
    values, vectors = torch.linalg.eigh(matrix)
    values = values.clamp_min(float(values[-1]) * 1e-14 * len(index))
    return vectors @ ((vectors.T @ columns) / values[:, None]), True
