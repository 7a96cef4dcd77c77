"""C of the tabletop: whether a grasp succeeds, from where the object stands and the table ends."""

import torch
from torch import Tensor

from cgtorch.domains.success import SuccessClassifier
from cgtorch.ground.errors import DataError
from cgtorch.native.structures import suits
from cgtorch.svm.compiled import Compiled
from cgtorch.tabletop.models.compiled import classifier_structure, successes
from cgtorch.tabletop.models.grasp_features import (
    FLAT,
    SIZES,
    compiled_features,
    grasp_features,
    used_features,
)

COSTS, GAMMAS = (100.0, 300.0), (0.5, 1.0, 2.0)
"""The hyper-parameters that cross-validation chooses from."""


class GraspClassifier(SuccessClassifier):
    """C: percept (..., D) -> probability (...) that a grasp succeeds, by `grasp_features`."""

    def forward(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.forward`."""
        compiled = self.compiled(percept)
        if compiled is not None:
            found = successes(compiled, percept.reshape(-1, percept.shape[-1]))
            if found is not None:
                return found.view(percept.shape[:-1])
        return self.predict_in_torch(percept)

    def compiled(self, percept: Tensor) -> Compiled | None:
        """C as compiled code knows it, where that can be asked about percepts (n, D)."""
        machine, mean, scale, platt = self.machine._machine, *self.tensors()[4:]
        suited = suits(percept, *self.tensors())
        if not suited or self.machine.kernel != "rbf" or not self.machine.fitted:
            return None
        if not compiled_features(percept.shape[-1], len(mean)):
            return None
        return classifier_structure(machine, mean, scale, platt)

    def tensors(self) -> tuple[Tensor, ...]:
        """Centres (m, F), weights (m, 1), bias (1,), γ (), mean (F,), scale (F,), Platt's (2,)."""
        return *self.machine._machine, self.mean, self.scale, self.machine.platt

    def raw_features(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.raw_features`: those that were worth learning from."""
        features, used = grasp_features(percept), len(self.mean)
        flat = used == FLAT and features.shape[-1] == FLAT + 1 and percept.shape[-1] in SIZES
        if features.shape[-1] != used and not flat:
            raise DataError(
                f"a percept has {percept.shape[-1]} coordinates, which make {features.shape[-1]} "
                f"features; the classifier was fitted on {used}"
            )
        return features[..., :used]

    def standardise(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.standardise`; all features have one scale.

        They are lengths and weighed so that they matter about as much, and what hardly varies is
        hardly more than noise, which a scale of its own would blow up.
        """
        features = grasp_features(percept)[:, : used_features(percept)]
        spread = features.var(0, correction=0).mean().sqrt()
        self.mean = features.mean(0)
        self.scale = torch.where(spread > 0, spread, 1.0).expand_as(self.mean).clone()
        return (features - self.mean) / self.scale
