"""Solving batches of the dual problems of C-SVC and epsilon-SVR, whatever they are like.

Both are one convex problem per column of targets (Chang & Lin 2011, eq. 2 and 10):

    min  1/2 beta' K beta - z' beta + epsilon |beta|_1   with  lower <= beta <= upper, 1' beta = 0

(C-SVC: z the signs, epsilon 0, box [0, C] or [-C, 0]; epsilon-SVR: z the targets, box [-C, C];
a row held out: box [0, 0]). The active set (`cgtorch.svm.active_set`) starts from a related
solution or from a quarter of the rows. Every answer carries its duality gap, and problems that do
not converge are handed to `cgtorch.svm.smo`, which always does.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.svm import smo
from cgtorch.svm.active_set import Active, active_set
from cgtorch.svm.gram import Gram
from cgtorch.svm.problems import Problems, inside
from cgtorch.svm.smoothed_loss import classify

Start = tuple[Tensor, Tensor, Tensor]
"""Coefficients (P, n), which may lie outside the boxes, biases (P,) and statuses (P, n)."""

FINAL_RIDGE = 1e-8
"""Last ridge of a final fit, in units of 1 / C: a relative duality gap of about 1e-7."""

START_RIDGE = 0.03
"""Last ridge of a solution that only starts others."""

_SMALLEST_SUBSET = 400


@dataclass(frozen=True)
class Solutions:
    """Answers to a batch of P problems over n rows.

    Attributes:
        beta: Coefficients (P, n).
        bias: Bias of the decision function (P,).
        product: Values K beta without the bias (P, n), held-out rows included.
        status: Active-set status of each coefficient (P, n), to start a related problem.
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


def first_rung(status: Tensor) -> Tensor:
    """First ridge (P,), in units of 1 / C, for a start with statuses (P, n).

    Where few coefficients are free, the bound ones carry the solution and a small ridge keeps
    the linear systems small; where most are free the path has to be followed from a larger one,
    and from the largest where nothing is known.
    """
    used = (status != 0).sum(1)
    share = (status.abs() == 1).sum(1) / used.clamp_min(1)
    rung = 0.03 + 0.07 * (share > 0.5) + 0.2 * (share > 0.9)
    return torch.where(used > 0, rung, 1.0).double()


def quarter_start(gram: Gram, problems: Problems, generator: torch.Generator) -> Start:
    """A start from nothing: the solution on a random quarter of the rows, each counting four times.

    The quarter starts from its own quarter, and so on; a few rows start from zero.
    """
    beta, bias = torch.zeros_like(problems.z), problems.z.median(1).values
    live = ((problems.upper > 0) | (problems.lower < 0)).any(0).nonzero().flatten()
    if len(live) <= _SMALLEST_SUBSET:
        return beta, bias, torch.zeros_like(beta)
    order = torch.randperm(len(live), generator=generator)[: len(live) // 4]
    rows = live[order.to(live.device)]
    part, fewer = gram.part(rows), problems.rows(rows, 4.0)
    quarter = descend(part, fewer, quarter_start(part, fewer, generator))
    beta[:, rows] = quarter.beta
    status = torch.zeros_like(beta)
    status[:, rows] = quarter.status
    return beta, quarter.bias, status


def descend(
    gram: Gram, problems: Problems, start: Start, last: float | Tensor = START_RIDGE
) -> Active:
    """The active set from a start down to ridges `last`, one or one per problem.

    Down to the default they are near enough to start related problems.
    """
    beta, bias, status = start
    lasts = torch.as_tensor(last).to(bias).expand(len(bias))
    return active_set(gram, problems, beta, bias, first_rung(status), last=lasts)


def solve(
    kernel: Gram | Tensor,
    problems: Problems,
    generator: torch.Generator,
    start: Start | None = None,
    *,
    last: float | Tensor = 1e-3,
    tolerance: float = 1e-3,
) -> Solutions:
    """Solve every problem, by the active set where it converges and by SMO elsewhere.

    Args:
        kernel: Kernel values among n rows, or their matrix (n, n), positive semidefinite.
        problems: P problems over its rows.
        generator: Source of the random quarter.
        start: Related solutions, or None.
        last: Last ridge of the ladder, in units of 1 / C, one or one per problem.
        tolerance: Optimality violation at which SMO stops (Fan, Chen & Lin 2005).

    Returns:
        Feasible solutions with their duality gaps.
    """
    gram = Gram(kernel) if isinstance(kernel, Tensor) else kernel
    found = descend(gram, problems, start or quarter_start(gram, problems, generator), last)
    beta, bias = inside(problems, found.beta), found.bias.clone()
    direct = found.done & _small_gap(problems, found, last)
    failed = (~direct).nonzero().flatten()
    for problem in failed.tolist():
        beta[problem], bias[problem] = smo.solve(
            gram.matrix,
            problems.z[problem],
            problems.lower[problem],
            problems.upper[problem],
            float(problems.epsilon[problem]),
            beta[problem],
            tolerance,
        )
    product = gram.times(beta)
    bias = middle_bias(problems, beta, bias, product)
    status = found.status.clone()
    if len(failed):
        status[failed] = classify(beta[failed], problems.lower[failed], problems.upper[failed])
    return Solutions(
        beta,
        bias,
        product,
        status,
        duality_gap(problems, beta, bias, product),
        dual_objective(problems, beta, product),
        direct,
    )


def _small_gap(problems: Problems, found: Active, last: float | Tensor) -> Tensor:
    """Whether the gap (P,) is what the last ridge and rounding explain, as a final check."""
    box = torch.maximum(problems.upper, -problems.lower)
    allowed = 0.5 * last / problems.cap * box.square().sum(1)
    allowed = allowed + 1e-6 * dual_objective(problems, found.beta, found.product).abs()
    gap = duality_gap(problems, found.beta, found.bias, found.product)
    return gap <= allowed + 1e-9 * box.sum(1)


def middle_bias(problems: Problems, beta: Tensor, bias: Tensor, product: Tensor) -> Tensor:
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
