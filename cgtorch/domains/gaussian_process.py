"""Γ as a Gaussian process: the next percept of a step, with a standard deviation.

The process predicts how a percept changes. All numbers of the percept share one kernel, which is
the sum of two: a squared exponential kernel with a length scale for each feature, and a linear
kernel, which extrapolates straight lines. The hyperparameters maximise the likelihood of the data
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sections 2.2, 5.1 and
5.4.1), as in PILCO (Deisenroth and Rasmussen, ICML 2011).
"""

import math
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from cgtorch.domains.learned_model import mean_and_spread
from cgtorch.ground.errors import DataError
from cgtorch.svm import inputs

MOST_PIVOTS = 200
"""The maximum number of inducing rows, from which predictions are computed."""
MOST_ROWS = 300
"""The maximum number of rows on which the hyperparameters are fitted."""
STEPS, AGAIN = 60, 20
"""Steps of L-BFGS for the first fit, and for one that continues from an earlier fit."""
HISTORY = 20  # steps that L-BFGS remembers
IMPOSSIBLE = 1e10
"""The loss where the covariances of the rows cannot be factorised."""
LEAST_NOISE = 1e-3
"""The smallest standard deviation of the noise, in units of that of the changes."""


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Kernel:
    """The covariance of changes between standardised features.

    Attributes:
        length: (F,) length scales of the features.
        amplitude: Variance of the squared exponential part.
        slope: Variance of the linear part's weights.
        noise: Variance of the noise.
    """

    length: Tensor
    amplitude: Tensor
    slope: Tensor
    noise: Tensor

    @classmethod
    def of(cls, free: Tensor) -> Self:
        """The kernel of unconstrained parameters (F + 3,): logarithms of its attributes."""
        amplitude, slope, noise = free[-3:].exp().unbind()
        return cls(free[:-3].exp(), amplitude, slope, noise + LEAST_NOISE**2)

    def __call__(self, x: Tensor, other: Tensor) -> Tensor:
        """Covariances (n, m) of features (n, F) with others (m, F)."""
        a, b = x / self.length, other / self.length
        square = (b * b).sum(1) + (a * a).sum(1, keepdim=True) - 2 * a @ b.T
        smooth = self.amplitude * (-0.5 * square.clamp_min(0)).exp()
        return smooth + self.slope * (1 + x @ other.T)

    def alone(self, x: Tensor) -> Tensor:
        """Prior variances (n,) at features (n, F)."""
        return self.amplitude + self.slope * (1 + x.square().sum(1))


def first_guess(features: int) -> Tensor:
    """Unconstrained parameters (F + 3,) at which the first fit begins."""
    free = torch.full((features + 3,), math.log(3.0), dtype=torch.float64)
    free[-3:] = torch.tensor([1.0, 1.0, 1e-4]).log()
    return free


def fitted_parameters(free: Tensor, x: Tensor, y: Tensor, steps: int) -> Tensor:
    """Unconstrained parameters (F + 3,), fitted to changes y (n, D) at features x (n, F).

    The fit maximises the marginal likelihood (Rasmussen and Williams, eq. 5.8) by L-BFGS. A weak
    Gaussian prior around `first_guess` keeps what the data do not determine.
    """
    free = free.clone().requires_grad_()
    guess, eye = first_guess(x.shape[1]), torch.eye(len(x), dtype=x.dtype)
    best = torch.optim.LBFGS(
        [free], max_iter=steps, history_size=HISTORY, line_search_fn="strong_wolfe"
    )

    def loss() -> Tensor:
        best.zero_grad()
        kernel = Kernel.of(free)
        factor, failed = torch.linalg.cholesky_ex(kernel(x, x) + kernel.noise * eye)
        if failed:  # a step that was far too long, which the line search takes back
            return torch.tensor(IMPOSSIBLE, dtype=x.dtype)
        white = torch.linalg.solve_triangular(factor, y, upper=False)
        unlikely = 0.5 * white.square().sum() + y.shape[1] * factor.diagonal().log().sum()
        prior = ((free - guess) / 3).square().sum()
        value = (unlikely + prior) / len(x)
        value.backward()
        return value

    best.step(loss)
    return free.detach()


def inducing_rows(kernel: Kernel, x: Tensor) -> Tensor:
    """(m,) long, the inducing rows of features (n, F), at most `MOST_PIVOTS`.

    They are chosen greedily by a pivoted Cholesky decomposition: each next row has the largest
    variance given those before. The choice ends when no variance is larger than the noise.
    """
    left, columns, rows = kernel.alone(x), x.new_empty(len(x), 0), []
    for _ in range(min(MOST_PIVOTS, len(x))):
        row = int(left.argmax())
        if left[row] < kernel.noise:
            break
        column = kernel(x, x[row : row + 1])[:, 0] - columns @ columns[row]
        column /= left[row].sqrt()
        columns = torch.cat([columns, column[:, None]], 1)
        left = left - column.square()
        rows.append(row)
    return torch.tensor(rows)


def projected(kernel: Kernel, pivots: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Weights w (m, D) and v (m, m) that predict changes from inducing rows `pivots` (m, F).

    They are fitted to changes y (n, D) at features x (n, F). A feature with covariances k (m,) to
    the inducing rows changes by k w in the mean, and its variance is the prior one less |k v|².
    """
    deviation, one = kernel.noise.sqrt(), torch.eye(len(pivots), dtype=x.dtype)
    gram = kernel(pivots, pivots) + 1e-3 * kernel.noise * one
    factor = torch.linalg.cholesky(gram)
    white = torch.linalg.solve_triangular(factor.T, one, upper=True)  # gram⁻¹ = white whiteᵀ
    q, r = torch.linalg.qr(torch.cat([kernel(x, pivots) @ white / deviation, one]))
    inverse = torch.linalg.solve_triangular(r, one, upper=True)
    weights = white @ (inverse @ (q[: len(x)].T @ (y / deviation)))
    share, turned = torch.linalg.eigh(one - inverse @ inverse.T)
    return weights, white @ turned * share.clamp_min(0).sqrt()


@dataclass(frozen=True, eq=False)  # as tensors have no single truth value
class Folded:
    """Sums over inducing rows, with scaling and the linear part folded into few products.

    These products are what a step of imagined episodes costs.

    Attributes:
        near: (F + 1, F) maps features and a 1 to standardised ones, in units of length scales.
        centres: (F, m) the inducing rows in these units.
        about: (m,) the part of the exponent that depends on inducing rows only.
        columns: (m, C) what is summed, times the covariances with inducing rows.
        straight: (F + 1, C) the linear part of these sums.
    """

    near: Tensor
    centres: Tensor
    about: Tensor
    columns: Tensor
    straight: Tensor

    @classmethod
    def of(
        cls, kernel: Kernel, pivots: Tensor, mean: Tensor, scale: Tensor, columns: Tensor
    ) -> Self:
        """Sums of `columns` (m, C) at features that `mean` and `scale` (F,) standardise."""
        unit, ones = affine(mean, scale), pivots.new_ones(len(pivots), 1)
        last = torch.eye(len(unit), dtype=unit.dtype)[:, -1:]
        weights = kernel.slope * torch.cat([pivots, ones], 1).T @ columns
        scaled = pivots / kernel.length
        about = -0.5 * (scaled * scaled).sum(1) + kernel.amplitude.log()
        straight = torch.cat([unit, last], 1) @ weights
        return cls(unit / kernel.length, scaled.T.contiguous(), about, columns, straight)

    def __call__(self, x: Tensor) -> Tensor:
        """(n, C) sums at features and a 1 (n, F + 1)."""
        near = x @ self.near
        exponent = torch.addmm(self.about, near, self.centres)
        exponent -= 0.5 * (near * near).sum(1, keepdim=True)
        return torch.addmm(x @ self.straight, exponent.exp_(), self.columns)


def affine(mean: Tensor, scale: Tensor) -> Tensor:
    """(F + 1, F) what standardises features and a 1 by means and scales (F,)."""
    return torch.cat([torch.diag(1 / scale), -(mean / scale)[None]])


class GaussianProcess:
    """Γ from percepts (n, D) and controls (n, U) to next percepts and their standard deviations.

    All rows are fitted, and predictions are computed from few of them, the inducing rows (projected
    process approximation; Rasmussen and Williams, section 8.3.4). A subclass can have other
    `features`, and say what is `expected` without it.
    """

    def __init__(
        self, percept: Tensor, control: Tensor, after: Tensor, free: Tensor | None = None
    ) -> None:
        """Fit transitions (n, D), (n, U) and (n, D).

        The hyperparameters continue from `free`, if it is given. Raises DataError for wrong shapes,
        NaN, or no rows.
        """
        p, u, q = (inputs.as_rows(rows, "transitions") for rows in (percept, control, after))
        if not len(p) == len(u) == len(q) or q.shape[1] != p.shape[1]:
            raise DataError(
                f"percept, control and next percept are {tuple(p.shape)}, {tuple(u.shape)} and "
                f"{tuple(q.shape)}; pass (n, D), (n, U) and (n, D)"
            )
        self.control_size = u.shape[1]
        raw, usual = self.features(p, u), self.expected(p, u)
        self.mean, self.scale = mean_and_spread(raw)
        self.shift, self.spread = mean_and_spread(q - usual, p)
        x, y = (raw - self.mean) / self.scale, (q - usual - self.shift) / self.spread
        generator = torch.Generator().manual_seed(len(x))
        some = torch.randperm(len(x), generator=generator)[:MOST_ROWS]
        steps = STEPS if free is None else AGAIN
        guess = first_guess(x.shape[1]) if free is None else free
        self.free = fitted_parameters(guess, x[some], y[some], steps)
        self.kernel = Kernel.of(self.free)
        self.pivots = x[inducing_rows(self.kernel, x)]
        weights, known = projected(self.kernel, self.pivots, x, y)
        about = self.kernel, self.pivots, self.mean, self.scale
        self._folded = Folded.of(*about, torch.cat([weights * self.spread, known], 1))
        (f, d), unit = (len(self.mean), len(self.shift)), affine(self.mean, self.scale)
        self._folded.straight[:, :d] += self.folded(f + 1, d)
        self._folded.straight[-1, :d] += self.shift
        last = torch.eye(f + 1, dtype=x.dtype)[:, -1:]
        self._slope = torch.cat([unit, last], 1) * self.kernel.slope.sqrt()

    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """The features (n, F) of percepts (n, D) and controls (n, U): by default, these."""
        return torch.cat([percept, control], 1)

    def expected(self, percept: Tensor, control: Tensor) -> Tensor:
        """Next percepts (n, D) from which those that happen are learned to differ: by default p."""
        return percept

    def folded(self, f: int, d: int) -> Tensor:
        """(f, d) maps features and a 1 to what is `expected` of them, which then costs nothing."""
        return torch.eye(f, d, dtype=torch.float64)

    def predict(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """Next percepts (n, D), and standard deviations (n,) in units of `spread`, all float64."""
        d, raw = len(self.shift), self.features(percept.double(), control.double())
        x = torch.cat([raw, raw.new_ones(len(raw), 1)], 1)
        out, slope = self._folded(x), x @ self._slope
        after, known = out[:, :d], out[:, d:]
        variance = self.kernel.amplitude + (slope * slope).sum(1) - (known * known).sum(1)
        return after, variance.clamp_min(0).sqrt()
