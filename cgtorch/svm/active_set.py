"""A batched active-set method for the dual problems of C-SVC and epsilon-SVR.

A primal-dual active set is a semismooth Newton method (Hintermueller, Ito & Kunisch 2003) on the
optimality system with a ridge h on the diagonal of K, which rounds the primal's loss over a width
h C (`cgtorch.svm.smoothed_loss`). On each rung of a ladder of ridges, Newton steps with a line search
minimise the rounded primal, which converges from every start. When few statuses change, the ridge
falls, and one full step with the statuses of the rung before predicts the solution on the next; a
prediction that makes things worse is undone and tried again with a smaller fall.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.svm.gram import Gram
from cgtorch.svm.newton import direction, with_pivot
from cgtorch.svm.problems import Problems
from cgtorch.svm.smoothed_loss import line_search, slope, statuses

_LADDER = 0.3
_CALM = 0.3  # the ridge falls when at most this share of the free set changed
_HARDLY = 0.8
_MAX_STEPS = 200
_ACCURATE = 1e-3  # of the ridge: how well the free coefficients solve their equations
_EXACT = 1e-6  # of the ridge: the same at the end, as it shows in coefficients near their bounds
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Active:
    """Where each of P problems stands; also the answer.

    Attributes:
        beta: Coefficients (P, n).
        bias: Biases (P,).
        product: K beta (P, n).
        status: Statuses (P, n), as in `cgtorch.svm.smoothed_loss`.
        residual: z - K beta - bias (P, n).
        clipped: Slopes of the rounded loss (P, n).
        rung: Ridges in units of 1 / C (P,).
        former: Ridges before the last fall (P,).
        ratio: Factor of the next fall (P,).
        jump: Whether the next step predicts the solution on a new rung (P,).
        strict: Whether a prediction failed, so that the rung is finished before the next (P,).
        done: Whether the problem is solved on the last rung (P,).
    """

    beta: Tensor
    bias: Tensor
    product: Tensor
    status: Tensor
    residual: Tensor
    clipped: Tensor
    rung: Tensor
    former: Tensor
    ratio: Tensor
    jump: Tensor
    strict: Tensor
    done: Tensor

    def take(self, index: Tensor) -> "Active":
        """The problems of `index` (Q,)."""
        return Active(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def put(self, index: Tensor, other: "Active") -> None:
        """Write the problems of another one to `index` (Q,)."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[index] = getattr(other, name)


def active_set(
    gram: Gram, problems: Problems, beta: Tensor, bias: Tensor, first: Tensor, *, last: Tensor
) -> Active:
    """Run the active set down a ladder of ridges.

    Args:
        gram: Kernel values among n rows, positive semidefinite.
        problems: P problems over the rows.
        beta: Coefficients (P, n) to start from; they may lie outside the boxes.
        bias: Biases (P,) to start from.
        first: First ridges (P,), in units of 1 / C.
        last: Last ridges (P,), in units of 1 / C; the gap is at most about n last C / 4.

    Returns:
        The solutions, exact only where `done`.
    """
    found = _begin(gram, problems, beta, bias, torch.maximum(first, last))
    live = torch.arange(len(beta), device=beta.device)
    part, state, precise = problems, found.take(live), [False] * len(beta)
    for _ in range(_MAX_STEPS):
        state = _step(gram, part, state, last[live], precise)
        if bool(state.done.any()):
            state = _confirm(gram, part, state)
            found.put(live, state)
            rest = (~state.done).nonzero().flatten()
            if len(rest) == 0:
                break
            precise = [precise[row] for row in rest.tolist()]
            live, part, state = live[rest], part.take(rest), state.take(rest)
    else:
        found.put(live, state)
    return found


def _begin(gram: Gram, problems: Problems, beta: Tensor, bias: Tensor, rung: Tensor) -> Active:
    """The state at a start."""
    product = gram.times(beta)
    residual = problems.z - product - bias[:, None]
    value, clipped = slope(problems, rung / problems.cap, residual)
    no = torch.zeros_like(rung, dtype=torch.bool)
    return Active(
        beta.clone(),
        bias.clone(),
        product,
        statuses(value, clipped),
        residual,
        clipped,
        rung,
        rung.clone(),
        torch.full_like(rung, _LADDER),
        no,
        no.clone(),
        no.clone(),
    )


def _step(
    gram: Gram, problems: Problems, state: Active, last: Tensor, precise: list[bool]
) -> Active:
    """One Newton step of every problem; `done` are those that seem to be solved."""
    h = state.rung / problems.cap
    old = with_pivot(problems, h, state.residual, state.clipped, state.status)
    free = old.abs() == 1
    d, shift, move = direction(gram, problems, h, state.beta, state.residual, old, free, precise)
    to = _move(problems, h, state, d, shift, move)
    new = statuses(to.value, to.clipped)
    new = new * (old * new != -1)  # from one free side to the other only by way of zero
    flips, count = (new != old).sum(1), free.sum(1)
    full = to.t == 1
    back = state.jump & (to.worse | (flips > count)) & (flips > 0)
    settled = full & (flips == 0)
    calm = full & ~back & (settled | (~state.strict & (flips <= _CALM * count)))
    final = state.rung <= last * 1.0001
    after = Active(
        beta=torch.addcmul(state.beta, to.t[:, None], d),
        bias=state.bias + to.t * shift,
        product=torch.addcmul(state.product, to.t[:, None], move),
        status=new,
        residual=to.residual,
        clipped=to.clipped,
        done=final & settled,
        **_ladder(state, calm, back, settled, final, last),
    )
    after = _checked(problems, after, settled, state.rung, precise)
    rows = back.nonzero().flatten()
    if len(rows):
        for name in ("beta", "bias", "product", "residual"):
            getattr(after, name)[rows] = getattr(state, name)[rows]
    return _reclassified(problems, after, state.rung, full & ~back)


@dataclass(frozen=True)
class _Move:
    """Where a step of length t (P,) leads: residuals, slopes before and after clipping (P, n).

    `worse` (P,) says that the primal rises more steeply at the end of a whole step than it fell at
    its beginning.
    """

    t: Tensor
    residual: Tensor
    value: Tensor
    clipped: Tensor
    worse: Tensor


def _move(
    problems: Problems, h: Tensor, state: Active, d: Tensor, shift: Tensor, move: Tensor
) -> _Move:
    """The step along directions d (P, n), shift (P,) with the product `move` = d K (P, n).

    A step that still falls at its end, or not much more steeply upwards, is taken whole, and so is
    a prediction.
    """
    change = move + shift[:, None]
    linear, square = (state.product * d).sum(1), (move * d).sum(1)
    residual = state.residual - change
    value, clipped = slope(problems, h, residual)
    begin = linear - (state.clipped * change).sum(1)
    end = linear + square - (clipped * change).sum(1)
    noise = 1e-13 * problems.cap * state.residual.norm(dim=1) * change.norm(dim=1)
    full = (end <= 0.5 * begin.abs() + noise) | (begin >= 0) | state.jump
    t = torch.ones_like(h)
    some = (~full).nonzero().flatten()
    if len(some):
        part, hs, change, r = problems.take(some), h[some], change[some], state.residual[some]
        t[some] = line_search(part, hs, r, change, linear[some], square[some], begin[some])
        residual[some] = r - t[some, None] * change
        value[some], clipped[some] = slope(part, hs, residual[some])
    return _Move(t, residual, value, clipped, end > begin.abs() + noise)


def _checked(
    problems: Problems, state: Active, settled: Tensor, rung: Tensor, precise: list[bool]
) -> Active:
    """`state` with `done` only where it is exact; settled ones that are not accurate are `precise`.

    Between the two, one more step with the same statuses refines the solution.
    """
    rows = settled.nonzero().flatten()
    if len(rows):
        part, at = problems.take(rows), state.take(rows)
        wrong = _wrong(part, rung[rows] / part.cap, at.beta, at.residual, at.status) / rung[rows]
        state.done[rows] &= wrong <= (_ROUNDING / rung[rows]).clamp_min(_EXACT)
        for row in rows[wrong > (_ROUNDING / rung[rows]).clamp_min(_ACCURATE)].tolist():
            precise[row] = True
    return state


def _wrong(problems: Problems, h: Tensor, beta: Tensor, residual: Tensor, status: Tensor) -> Tensor:
    """The largest error (P,) of the equations that the free coefficients have to solve."""
    wrong = residual - problems.epsilon[:, None] * status.sign() - h[:, None] * beta
    return (wrong * (status.abs() == 1)).abs().amax(1)


def _ladder(
    state: Active, calm: Tensor, back: Tensor, settled: Tensor, final: Tensor, last: Tensor
) -> dict[str, Tensor]:
    """The next rung of each problem and how it is reached."""
    step = torch.where(state.jump, (state.ratio**1.5).clamp_min(_LADDER), state.ratio)
    step = torch.where(settled & ~state.strict, step**2, step).clamp_min(_LADDER**3)
    ratio = torch.where(back, state.ratio.sqrt(), step)
    tried = (
        ratio > _HARDLY
    )  # where even small falls are predicted badly, a fall needs no prediction
    ratio = torch.where(tried & calm, _LADDER, ratio)
    lower = torch.maximum(state.rung * ratio, last)
    return {
        "rung": torch.where(calm, lower, torch.where(back, state.former, state.rung)),
        "former": torch.where(calm, state.rung, state.former),
        "ratio": ratio,
        "jump": calm & ~final & ~tried,
        "strict": torch.where(state.jump, back, state.strict),
    }


def _reclassified(problems: Problems, state: Active, rung: Tensor, whole: Tensor) -> Active:
    """The state with slopes and statuses of its own rung, where they were made for `rung` (P,).

    A prediction keeps the statuses, and so does whoever stays on a rung after a whole step.
    """
    changed = (~whole | (state.rung != rung)).nonzero().flatten()
    if len(changed):
        part = problems.take(changed)
        value, clipped = slope(part, state.rung[changed] / part.cap, state.residual[changed])
        state.clipped[changed] = clipped
        keep = state.jump[changed, None]
        state.status[changed] = torch.where(keep, state.status[changed], statuses(value, clipped))
    return state


def _confirm(gram: Gram, problems: Problems, state: Active) -> Active:
    """`state` with exact products where it is done.

    Who is not as accurate with these as it seemed is not done and takes a whole step with the
    statuses it has, which with a small ridge would not survive the error in the residuals.
    """
    rows = state.done.nonzero().flatten()
    part, at = problems.take(rows), state.take(rows)
    h = at.rung / part.cap
    product = gram.times(at.beta)
    residual = part.z - product - at.bias[:, None]
    value, clipped = slope(part, h, residual)
    wrong = _wrong(part, h, at.beta, residual, at.status)
    fine = (wrong <= (_EXACT * at.rung).clamp_min(_ROUNDING)) & (
        statuses(value, clipped) == at.status
    ).all(1)
    state.product[rows], state.residual[rows], state.clipped[rows] = product, residual, clipped
    again = rows[~fine]
    state.done[again], state.jump[again], state.former[again] = False, True, state.rung[again]
    return state
