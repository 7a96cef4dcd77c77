"""A batched active-set solver for the dual problem of C-SVC and epsilon-SVR.

Both are one convex problem per column of targets (Chang & Lin 2011, eq. 2 and 10):

    min  1/2 beta' K beta - z' beta + epsilon |beta|_1   with  lower <= beta <= upper, 1' beta = 0

(C-SVC: z the signs, epsilon 0, box [0, C] or [-C, 0]; epsilon-SVR: z the targets, box [-C, C];
a row held out: box [0, 0]). The solver is a primal-dual active set, a semismooth Newton method
(Hintermueller, Ito & Kunisch 2003) on the optimality system with a ridge h on the diagonal of K,
which is the dual of rounding the loss's corners over a width h (Chapelle 2007). The ridge falls
along a ladder, each rung starting from the last one's statuses. Every answer carries its duality
gap, and problems that do not converge are handed to `cgtorch.models.smo`, which always does.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.models import smo
from cgtorch.models.newton import solve_free, times_kernel
from cgtorch.models.problems import Problems

# Status of a coefficient: on a bound (-2 lower, 0 zero, 2 upper) or free (-1 below, 1 above zero).
_LOWER, _NEGATIVE, _ZERO, _POSITIVE, _UPPER = -2, -1, 0, 1, 2

FINAL_RIDGE = 1e-7
"""Last ridge of a final fit, in units of 1 / C: a relative duality gap of about 1e-6."""

_FIRST_RIDGE = 1.0
_LADDER = 0.3
_CALM = 0.1  # the ridge falls when at most this share of the free set changed
_MAX_STEPS = 200
_SMALLEST_SUBSET = 200
_ACCURATE = 1e-3  # of the ridge: how well the free coefficients solve their equations
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Solutions:
    """Answers to a batch of P problems over n rows.

    Attributes:
        beta: Coefficients (P, n).
        bias: Bias of the decision function (P,).
        product: Values K beta without the bias (P, n), held-out rows included.
        status: Active-set status of each coefficient (P, n), int8, to start a related problem.
        gap: Duality gap (P,).
        objective: Dual objective, the minimum above with its sign (P,).
        direct: True where the active set converged, False where SMO had to finish (P,).
    """

    beta: Tensor
    bias: Tensor
    product: Tensor
    status: Tensor
    gap: Tensor
    objective: Tensor
    direct: Tensor

    def take(self, index: Tensor) -> "Solutions":
        """The solutions of `index` (Q,)."""
        return Solutions(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def soft(x: Tensor, width: Tensor) -> Tensor:
    """Soft threshold: x moved towards 0 by `width`, and 0 within it."""
    return x.sign() * (x.abs() - width).clamp_min(0)


def classify(value: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Status (P, n) of unclipped coefficients `value` (P, n)."""
    status = torch.zeros_like(value, dtype=torch.int8)
    status = status.masked_fill((value > 0) & (upper > 0), _POSITIVE)
    status = status.masked_fill((value < 0) & (lower < 0), _NEGATIVE)
    status = status.masked_fill((value >= upper) & (upper > 0), _UPPER)
    return status.masked_fill((value <= lower) & (lower < 0), _LOWER)


def duality_gap(problems: Problems, beta: Tensor, bias: Tensor, product: Tensor) -> Tensor:
    """Primal minus dual objective (P,) at feasible `beta` (P, n).

    It is a sum of one non-negative term per row, u max(0, r - e) - l max(0, -r - e) - r b + e |b|
    with residual r = z - K beta - bias, so it shows where a solution is not optimal.
    """
    residual = problems.z - product - bias[:, None]
    width = problems.epsilon[:, None]
    loss = problems.upper * (residual - width).clamp_min(0)
    loss = loss - problems.lower * (-residual - width).clamp_min(0)
    return (loss - residual * beta + width * beta.abs()).sum(1)


def dual_objective(problems: Problems, beta: Tensor, product: Tensor) -> Tensor:
    """The minimised function (P,) at `beta` (P, n) with `product` = K beta."""
    linear = (0.5 * product - problems.z) * beta + problems.epsilon[:, None] * beta.abs()
    return linear.sum(1)


def _on_bounds(problems: Problems, value: Tensor, status: Tensor) -> Tensor:
    """`value` with every coefficient that is not free moved to the bound of its status."""
    value = torch.where(status == _UPPER, problems.upper, value)
    value = torch.where(status == _LOWER, problems.lower, value)
    return value.masked_fill(status == _ZERO, 0.0)


def _slope(problems: Problems, h: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
    """Derivative of the rounded loss, the coefficients (P, n) that `residual` asks for, and h."""
    value = soft(residual, problems.epsilon[:, None]) / h[:, None]
    return value, torch.minimum(torch.maximum(value, problems.lower), problems.upper)


def _rounded_primal(
    problems: Problems, h: Tensor, beta: Tensor, product: Tensor, residual: Tensor
) -> Tensor:
    """The primal objective (P,) with the corners of its loss rounded over a width h C."""
    slope = _slope(problems, h, residual)[1]
    loss = (residual - 0.5 * h[:, None] * slope) * slope - problems.epsilon[:, None] * slope.abs()
    return (0.5 * beta * product + loss).sum(1)


def _line_search(
    problems: Problems,
    h: Tensor,
    residual: Tensor,
    change: Tensor,
    linear: Tensor,
    square: Tensor,
) -> Tensor:
    """Steps (P,) at most 1 that minimise the rounded primal along a Newton direction.

    The derivative along the step t is linear + t square - slope(residual - t change)' change, which
    only grows with t, so bisection finds its zero.

    Args:
        problems: The problems.
        h: Ridges (P,).
        residual: Residuals at t = 0 (P, n).
        change: Fall of the residuals at t = 1 (P, n).
        linear: beta' K d of the direction d (P,).
        square: d' K d (P,).
    """

    def derivative(t: Tensor) -> Tensor:
        slope = _slope(problems, h, residual - t[:, None] * change)[1]
        return linear + t * square - (slope * change).sum(1)

    low, high = torch.zeros_like(h), torch.ones_like(h)
    noise = 1e-13 * (residual.abs() * problems.cap[:, None] * change.abs()).sum(1)
    full = derivative(high) <= 0.5 * derivative(low).abs() + noise
    full = full | (derivative(low) >= 0)
    if bool(full.all()):
        return high
    for _ in range(12):
        middle = (low + high) / 2
        before = derivative(middle) < 0
        low, high = torch.where(before, middle, low), torch.where(before, high, middle)
    return torch.where(full, 1.0, high)


def first_rung(status: Tensor, boxes: Tensor) -> Tensor:
    """First ridge (P,), in units of 1 / C, for a start with statuses (P, n).

    Where few coefficients are free, the bound ones carry the solution and a small ridge keeps
    the linear systems small; where most are free the path has to be followed from a large one.

    Args:
        status: Statuses of the start (P, n).
        boxes: Whether a coefficient may move at all (P, n).
    """
    share = (status.abs() == 1).sum(1) / boxes.sum(1).clamp_min(1)
    rung = torch.full_like(share, _FIRST_RIDGE)
    rung = rung.masked_fill(share < 0.5, 0.1)
    return rung.double()


def _first_point(
    kernel: Tensor, problems: Problems, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients (P, n), bias (P,) and first ridge (P,) from a random quarter with 4 C."""
    beta, bias = torch.zeros_like(problems.z), problems.z.median(1).values
    boxes = (problems.upper > 0) | (problems.lower < 0)
    live = boxes.any(0).nonzero().flatten()
    if len(live) <= _SMALLEST_SUBSET:
        return beta, bias, torch.full_like(bias, _FIRST_RIDGE)
    order = torch.randperm(len(live), generator=generator)[: len(live) // 4]
    part = live[order.to(live.device)]
    sub = kernel.index_select(0, part).index_select(1, part)
    quarter = active_set(sub, problems.rows(part, 4.0), None, generator, last=0.03)
    beta[:, part], bias = quarter.beta, quarter.bias
    return beta, bias, first_rung(quarter.status, boxes[:, part])


def _with_pivot(part: Problems, h: Tensor, residual: Tensor, status: Tensor) -> Tensor:
    """Statuses (P, n) with one coefficient freed in each problem that has no free one.

    Without a free coefficient the bias would have no equation. The sum of the coefficients says
    which way the bias has to go, and the first coefficient that leaves its bound on that way is
    the one to free.
    """
    empty = (status.abs() != 1).all(1).nonzero().flatten()
    if len(empty) == 0:
        return status
    part, h, r, status_of = part.take(empty), h[empty, None], residual[empty], status[empty]
    width = part.epsilon[:, None]
    excess = _slope(part, h[:, 0], r)[1].sum(1, keepdim=True) > 0
    down = torch.where(status_of == _UPPER, r - width - h * part.upper, torch.inf)
    down = torch.where((status_of == _ZERO) & (part.lower < 0), r + width, down)
    up = torch.where(status_of == _LOWER, h * part.lower - width - r, torch.inf)
    up = torch.where((status_of == _ZERO) & (part.upper > 0), width - r, up)
    pivot = torch.where(excess, down, up).clamp_min(0).argmin(1)
    old = status_of.gather(1, pivot[:, None])
    side = torch.where(old == _ZERO, torch.where(excess, _NEGATIVE, _POSITIVE), old.sign())
    status = status.clone()
    status[empty, pivot] = side[:, 0].to(status.dtype)
    return status


def _direction(
    kernel: Tensor,
    single: Tensor,
    part: Problems,
    h: Tensor,
    point: tuple[Tensor, Tensor, Tensor],
    status: Tensor,
    precise: list[bool],
) -> tuple[Tensor, Tensor]:
    """Newton direction of the coefficients (P, n) and biases (P,) for given statuses.

    Coefficients on a bound go there; the free ones solve (K_FF + h) d + shift = right with
    coefficients that sum to 0. `precise` is updated with who needed float64.
    """
    beta, bias, product = point
    residual = part.z - product - bias[:, None]
    free = status.abs() == 1
    d = (_on_bounds(part, beta, status) - beta).masked_fill(free, 0.0)
    right = residual - part.epsilon[:, None] * status.sign() - h[:, None] * beta
    right = right - times_kernel(d, kernel)
    total = (beta + d).sum(1)
    u, v = solve_free(kernel, single, free, h, right, precise)
    shift = (u.sum(1) + total) / v.sum(1)
    return d + u - shift[:, None] * v, shift


def active_set(
    kernel: Tensor,
    problems: Problems,
    start: tuple[Tensor, Tensor, Tensor] | None,
    generator: torch.Generator,
    *,
    last: float = 1e-3,
) -> Solutions:
    """Run the active set down a ladder of ridges that ends at `last` / C.

    On each rung, Newton steps with a line search minimise the primal with its corners rounded,
    which converges from every start. When few statuses change, the ridge falls and one full step
    with the statuses of the rung before predicts the solution on the next; a prediction that
    makes things worse is undone and tried again with a smaller fall.

    Args:
        kernel: Positive semidefinite kernel matrix (n, n), float64.
        problems: P problems over its rows.
        start: Coefficients (P, n), biases (P,) and statuses (P, n) to start from, or None to
            begin on a quarter of the rows.
        generator: Source of the random quarter.
        last: Last ridge, in units of 1 / C; the gap is at most about n last C / 4.

    Returns:
        The solutions, exact only where `direct`.
    """
    if start is None:
        beta, bias, first = _first_point(kernel, problems, generator)
        status = torch.zeros_like(beta, dtype=torch.int8)
    else:
        beta, bias, status = (tensor.clone() for tensor in start)
        boxes = (problems.upper > 0) | (problems.lower < 0)
        first = first_rung(status, boxes)
    product = beta @ kernel
    single = kernel.float()
    known = torch.full_like(bias, start is not None, dtype=torch.bool)  # statuses to be kept
    jump = known.clone()  # this step predicts the solution on a new rung
    strict = torch.zeros_like(known)  # a prediction failed: finish the rung before the next one
    done = torch.zeros_like(known)
    level = first.to(bias).clamp_min(last)
    former = level.clone()
    ratio = torch.full_like(bias, _LADDER)
    precise = [False] * len(beta)
    for _ in range(_MAX_STEPS):
        live = (~done).nonzero().flatten()
        if len(live) == 0:
            break
        part = problems.take(live)
        x0, b0, g0, rung = beta[live], bias[live], product[live], level[live]
        h, jumped = rung / part.cap, jump[live]
        residual = part.z - g0 - b0[:, None]
        old = classify(_slope(part, h, residual)[0], part.lower, part.upper)
        old = torch.where(known[live][:, None], status[live], old)
        old = _with_pivot(part, h, residual, old)
        exact = [precise[problem] for problem in live.tolist()]
        d, shift = _direction(kernel, single, part, h, (x0, b0, g0), old, exact)
        move = times_kernel(d, kernel)
        linear, square = (g0 * d).sum(1), (move * d).sum(1)
        t = _line_search(part, h, residual, move + shift[:, None], linear, square)
        t = torch.where(jumped, 1.0, t)
        x, b, g = x0 + t[:, None] * d, b0 + t * shift, g0 + t[:, None] * move

        before = _rounded_primal(part, h, x0, g0, residual)
        residual = part.z - g - b[:, None]
        full = t == 1
        free = old.abs() == 1
        value = torch.where(free & full[:, None], x, _slope(part, h, residual)[0])
        new = classify(value, part.lower, part.upper)
        new = torch.where((old * new == -1), torch.zeros_like(new), new)
        flips = (new != old).sum(1)
        wrong = (residual - part.epsilon[:, None] * old.sign() - h[:, None] * x) * free
        accurate = wrong.abs().amax(1) <= (_ACCURATE * rung).clamp_min(_ROUNDING)
        worse = _rounded_primal(part, h, x, g, residual) > before
        back = jumped & (worse | (flips > free.sum(1))) & (flips > 0)
        settled = full & (flips == 0)
        calm = full & ~back & (settled | (~strict[live] & (flips <= _CALM * free.sum(1))))
        final = rung <= last * 1.0001

        for row, problem in enumerate(live.tolist()):
            precise[problem] = exact[row] or bool(settled[row] and not accurate[row])
        done[live] = final & settled & accurate
        keep = back[:, None]
        beta[live], product[live] = torch.where(keep, x0, x), torch.where(keep, g0, g)
        bias[live] = torch.where(back, b0, b)
        status[live] = torch.where(keep, status[live], new)
        step = torch.where(jumped, (ratio[live] ** 1.5).clamp_min(_LADDER), ratio[live])
        step = torch.where(settled & ~strict[live], step**2, step).clamp_min(_LADDER**3)
        ratio[live] = torch.where(back, ratio[live].sqrt(), step)
        strict[live] = torch.where(jumped, back, strict[live])
        jump[live] = calm & ~final
        known[live] = full & ~back
        lower = (rung * ratio[live]).clamp_min(last)
        level[live] = torch.where(calm, lower, torch.where(back, former[live], rung))
        former[live] = torch.where(calm, rung, former[live])
    gap = duality_gap(problems, beta, bias, product)
    objective = dual_objective(problems, beta, product)
    return Solutions(beta, bias, product, status, gap, objective, done)


def solve(
    kernel: Tensor,
    problems: Problems,
    generator: torch.Generator,
    start: tuple[Tensor, Tensor, Tensor] | None = None,
    *,
    last: float = 1e-3,
    tolerance: float = 1e-3,
) -> Solutions:
    """Solve every problem, by the active set where it converges and by SMO elsewhere.

    Args:
        kernel: Positive semidefinite kernel matrix (n, n), float64.
        problems: P problems over its rows.
        generator: Source of the random quarter.
        start: Coefficients, biases and statuses of related solutions, or None.
        last: Last ridge of the ladder, in units of 1 / C.
        tolerance: Optimality violation at which SMO stops (Fan, Chen & Lin 2005).

    Returns:
        Feasible solutions with their duality gaps.
    """
    found = active_set(kernel, problems, start, generator, last=last)
    beta = torch.minimum(torch.maximum(found.beta, problems.lower), problems.upper)
    bias = found.bias.clone()
    direct = found.direct & _small_gap(problems, found, last)
    failed = (~direct).nonzero().flatten()
    for problem in failed.tolist():
        beta[problem], bias[problem] = smo.solve(
            kernel,
            problems.z[problem],
            problems.lower[problem],
            problems.upper[problem],
            float(problems.epsilon[problem]),
            beta[problem],
            tolerance,
        )
    product = beta @ kernel
    bias = _middle_bias(problems, beta, bias, product)
    status = found.status.clone()
    if len(failed):
        status[failed] = _status_of(problems.take(failed), beta[failed])
    return Solutions(
        beta,
        bias,
        product,
        status,
        duality_gap(problems, beta, bias, product),
        dual_objective(problems, beta, product),
        direct,
    )


def _small_gap(problems: Problems, found: Solutions, last: float) -> Tensor:
    """Whether the gap (P,) is what the last ridge and rounding explain, as a final check."""
    box = torch.maximum(problems.upper, -problems.lower)
    allowed = 0.5 * last / problems.cap * box.square().sum(1) + 1e-6 * found.objective.abs()
    return found.gap <= allowed + 1e-9 * box.sum(1)


def _middle_bias(problems: Problems, beta: Tensor, bias: Tensor, product: Tensor) -> Tensor:
    """Biases (P,), in the middle of what is optimal where no free coefficient fixes them.

    That is libsvm's rule (Chang & Lin 2011, section 4.1.5).
    """
    box = torch.maximum(problems.upper, -problems.lower) * 1e-9
    inside = (beta < problems.upper - box) & (beta > problems.lower + box) & (beta.abs() > box)
    width = problems.epsilon[:, None]
    gradient = problems.z - product
    rise = gradient - torch.where(beta >= -box, width, -width)
    fall = gradient - torch.where(beta > box, width, -width)
    low = rise.masked_fill(beta >= problems.upper - box, -torch.inf).amax(1)
    high = fall.masked_fill(beta <= problems.lower + box, torch.inf).amin(1)
    middle = (low + high) / 2
    return torch.where(inside.any(1) | ~torch.isfinite(middle), bias, middle)


def _status_of(problems: Problems, beta: Tensor) -> Tensor:
    """Statuses (P, n) that feasible coefficients show; those on a bound are taken to stay."""
    return classify(beta, problems.lower, problems.upper)
