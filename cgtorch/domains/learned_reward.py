"""Rewards and ends of episodes, learned from steps in a world.

What a step gives is a Gaussian process of the percept and the control. Ends can give something of
their own, such as 100 at a flag: each gives what the nearest end that was seen gave beyond the
Gaussian process.

Whether a step ends its episode is seen in the next percept. Most often a number leaves its range,
such as the angle of a pole, and then a single end tells much. So that is believed until it
contradicts what was seen: thresholds of single numbers, as few as separate all ends from all other
percepts. If there are none, a support vector machine with hardly any tolerance separates them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from cgtorch.domains.gaussian_process import (
    AGAIN,
    MOST_ROWS,
    STEPS,
    Folded,
    Kernel,
    first_guess,
    fitted_parameters,
    inducing_rows,
    projected,
)
from cgtorch.domains.learned_model import mean_and_spread
from cgtorch.improvement.played import Steps
from cgtorch.svm import SVC

SAME = 1e-6  # the largest spread of rewards that are all the same, as a share of the largest
COST, WIDTH = 1e4, 0.1  # of the machine; the width is that for all numbers of a percept together


class LearnedReward:
    """A `Reward` of n steps: see `cgtorch.domains.rewarded_model.Reward`.

    Attributes:
        free: (F + 3,) the parameters of the Gaussian process, with which a later fit can begin.
    """

    def __init__(
        self, steps: Steps, free: Tensor | None = None, starts: Tensor | None = None
    ) -> None:
        """Fit at least one step, which has percepts (n, D) and controls (n, U).

        Episodes begin at `starts` (b, D), so there they do not end.
        """
        going = ~steps.ended
        some = steps.rows(going) if bool(going.any()) else steps
        self._usual = Usual(_inputs(some.percept, some.control), some.reward.double(), free)
        self.free = self._usual.free
        self._mean, self._scale = mean_and_spread(steps.after.double())
        begun = steps.percept if starts is None else starts
        every = torch.cat([steps.percept, steps.after, begun]).double()
        self._range = every.amin(0), every.amax(0)
        self._ends: Callable[[Tensor], Tensor] | None = None
        if not bool(steps.ended.any()):
            return
        last = steps.rows(steps.ended)
        self._last = self._standardised(last.after)
        usual = self._usual(_inputs(last.percept, last.control))
        self._bonus = last.reward.double() - usual
        if bool(going.any()):
            rows = self._standardised(steps.after)
            self._ends = Thresholds.found(rows[going], self._last) or Margin(rows, steps.ended)

    def __call__(self, before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
        """Rewards (n,) and (n,) bool ends of steps with percepts (n, D) and controls (n, U)."""
        gain = self._usual(_inputs(before, control))
        ended = torch.zeros(len(gain), dtype=torch.bool)
        if self._ends is not None:
            rows = self._standardised(after)
            ended = self._ends(rows)
            if bool(ended.any()):
                nearest = torch.cdist(rows[ended], self._last).argmin(1)
                gain[ended] += self._bonus[nearest]
        return gain.to(before), ended

    def doubt(self, before: Tensor, control: Tensor) -> Tensor:
        """How little is known (n,) of what steps give.

        It is the standard deviation of rewards, in units of that of all rewards, or if that is
        more, by how much a percept is out of the range of those that were seen, as a share of its
        width, as there may be an end.
        """
        low, high = self._range
        width = torch.where(high > low, high - low, 1.0)
        beyond = torch.maximum(low - before, before - high) / width
        deviation = self._usual.deviation(_inputs(before, control))
        return torch.maximum(deviation, beyond.amax(1).clamp_min(0))

    def _standardised(self, percept: Tensor) -> Tensor:
        return (percept.double() - self._mean) / self._scale


@dataclass(frozen=True)
class Thresholds:
    """Ends where one of some numbers is beyond its threshold.

    Attributes:
        limits: The place of a number, 1 if it ends above and -1 if it ends below, and the threshold
            times that sign.
    """

    limits: tuple[tuple[int, int, float], ...]

    @classmethod
    def found(cls, going: Tensor, ended: Tensor) -> Self | None:
        """The fewest thresholds beyond which all of the `ended` rows (m, D) are.

        None of the others (n, D) is there. None if there are no such thresholds.
        """
        limits, left = list[tuple[int, int, float]](), ended
        while len(left):
            signed = [(going * sign, left * sign, sign) for sign in (1, -1)]
            edges = torch.stack([others.amax(0) for others, _, _ in signed])
            beyond = torch.stack(
                [own > edge for (_, own, _), edge in zip(signed, edges, strict=True)]
            )
            side, place = divmod(int(beyond.sum(1).argmax()), going.shape[1])
            met = beyond[side, :, place]
            if not bool(met.any()):
                return None
            _, own, sign = signed[side]
            middle = (edges[side, place] + own[met, place].min()) / 2
            limits.append((place, sign, float(middle)))
            left = left[~met]
        return cls(tuple(limits))

    def __call__(self, rows: Tensor) -> Tensor:
        """(n,) bool, which of the rows (n, D) are ends."""
        beyond = [sign * rows[:, place] > threshold for place, sign, threshold in self.limits]
        return torch.stack(beyond).any(0)


class Margin:
    """Ends on one side of a support vector machine's boundary."""

    def __init__(self, rows: Tensor, ended: Tensor) -> None:
        """Separate rows (n, D) by `ended` (n,) bool, of both kinds."""
        self._machine = SVC(C=COST, gamma=WIDTH / rows.shape[1]).fit(rows, ended)

    def __call__(self, rows: Tensor) -> Tensor:
        """(n,) bool, which of the rows (n, D) are ends."""
        return self._machine.values(rows)[:, 0] > 0


class Usual:
    """A Gaussian process of one number, from features (n, F)."""

    def __init__(self, x: Tensor, y: Tensor, free: Tensor | None) -> None:
        """Fit numbers y (n,) at features x (n, F); hyperparameters continue from `free`."""
        self.mean, self.scale = mean_and_spread(x)
        self.free = first_guess(x.shape[1]) if free is None else free
        self.shift, self.spread = float(y.mean()), float(y.std(correction=0))
        self.constant = self.spread <= SAME * float(y.abs().max())
        if self.constant:
            return
        x, y = (x - self.mean) / self.scale, ((y - self.shift) / self.spread)[:, None]
        some = torch.randperm(len(x), generator=torch.Generator().manual_seed(len(x)))[:MOST_ROWS]
        steps = STEPS if free is None else AGAIN
        self.free = fitted_parameters(self.free, x[some], y[some], steps)
        self.kernel = Kernel.of(self.free)
        self.pivots = x[inducing_rows(self.kernel, x)]
        weights, self._known = projected(self.kernel, self.pivots, x, y)
        about = self.kernel, self.pivots, self.mean, self.scale
        self._folded = Folded.of(*about, self.spread * weights)

    def __call__(self, x: Tensor) -> Tensor:
        """Expected numbers (n,) at features (n, F)."""
        if self.constant:
            return x.new_full((len(x),), self.shift)
        rows = torch.cat([x, x.new_ones(len(x), 1)], 1)
        return self.shift + self._folded(rows)[:, 0]

    def deviation(self, x: Tensor) -> Tensor:
        """Standard deviations (n,) at features (n, F), in units of that of all numbers."""
        if self.constant:
            return x.new_zeros(len(x))
        rows = (x - self.mean) / self.scale
        known = (self.kernel(rows, self.pivots) @ self._known).square().sum(1)
        return (self.kernel.alone(rows) - known).clamp_min(0).sqrt()


def _inputs(percept: Tensor, control: Tensor) -> Tensor:
    """(n, 2 (D + U)) float64: all numbers and their squares, which are the costs of many tasks."""
    numbers = torch.cat([percept, control], 1).double()
    return torch.cat([numbers, numbers.square()], 1)
