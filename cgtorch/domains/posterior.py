"""The uncertainty of Γ: the posterior variance of a Gaussian process with the same kernel.

A kernel machine gives no variance of its predictions. A Gaussian process with the same kernel and
data does (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.26).
"""

import torch
from torch import Tensor

from cgtorch.domains.transition import KernelTransitionModel
from cgtorch.svm.gram import rbf
from cgtorch.svm.reduced_set import pivots

MOST_PIVOTS = 128
"""Maximum number of rows that represent all others, chosen by pivoted Cholesky decomposition."""
NUGGET = 1e-4
"""Variance of the noise, in units of the prior variance."""

PRIOR = 2.0
"""Standard deviation of the prior, in units of that of the targets of Γ."""


class Posterior:
    """Γ with variances of its predictions, from 0 at its data to 1 far away from them."""

    def __init__(self, gamma: KernelTransitionModel, percept: Tensor, control: Tensor) -> None:
        """Γ, fitted to transitions from percepts (n, D) with controls (n, U)."""
        self.gamma, self.width = gamma, float(gamma.machine.gamma_value)
        features = gamma.features(percept, control).double()
        self.pivots = features[pivots(features, self.width, MOST_PIVOTS)]
        gram = rbf(self.pivots, self.pivots, self.width)
        gram += NUGGET * torch.eye(len(gram)).to(gram)
        factor, one = torch.linalg.cholesky(gram), torch.eye(len(gram)).to(gram)
        self.whiten = torch.linalg.solve_triangular(factor, one, upper=False).T.to(percept)
        self.pivots = self.pivots.to(percept)

    def predict(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """Next percepts (n, D) and variances (n,), for percepts (n, D) and controls (n, U)."""
        features = self.gamma.features(percept, control)
        value = self.gamma.machine.values(features).to(percept)
        kernel = rbf(features.to(self.pivots), self.pivots, self.width)
        variance = (1 - (kernel @ self.whiten).square().sum(1)).clamp_min(0)
        return self.gamma.next_percept(percept, control, value), variance.to(percept)

    def deviation(self, variance: Tensor) -> Tensor:
        """Standard deviations (n,) of the predictions of Γ, in units of those of its targets."""
        return PRIOR * (variance - NUGGET).clamp_min(0).sqrt()
