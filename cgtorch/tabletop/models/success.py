"""C of the tabletop: whether a grasp succeeds, given the object and the sides of the table."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.success import SuccessClassifier
from cgtorch.ground.errors import DataError
from cgtorch.native import function, structure
from cgtorch.svm.compiled import threads_for
from cgtorch.tabletop.models.compiled_machine import compiled_machine
from cgtorch.tabletop.models.grasp_features import FLAT, grasp_features, used_features
from cgtorch.tabletop.world.percepts import parts_of

COSTS, GAMMAS = (100.0, 300.0), (0.5, 1.0, 2.0)
"""The grid of hyper-parameters for cross-validation."""


class GraspClassifier(SuccessClassifier):
    """C: percept (..., D) -> probability (...) that a grasp succeeds, by `grasp_features`."""

    def forward(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.forward`."""
        compiled = self.compiled(percept) if percept.is_cpu else None
        if compiled is None:
            return self.predict_in_torch(percept)
        rows = percept.reshape(-1, percept.shape[-1]).contiguous()
        chance, (n, size) = rows.new_empty(len(rows)), rows.shape
        call, threads = function("successes", rows.dtype), threads_for(n, compiled.machine.m)
        call(compiled, size, rows, n, chance, threads)
        return chance.view(percept.shape[:-1])

    def compiled(self, percept: Tensor) -> Any:
        """C in the form of compiled code, if that supports percepts (n, D).

        Results equal torch's except for the last digits. A row's result does not depend on others.
        """
        mean, scale, platt = self.mean, self.scale, self.machine.platt
        known = (FLAT + 3,) if parts_of(percept).side.shape[-1] else (FLAT, FLAT + 1)
        made = compiled_machine(self.machine, percept, mean, scale, platt)
        if made is None or len(mean) not in known or not bool(platt.isfinite().all()):
            return None
        slope, offset = platt.tolist()
        classifier = structure("Classifier", mean.dtype)
        return classifier(machine=made, mean=mean, scale=scale, slope=slope, offset=offset)

    def raw_features(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.raw_features`: the informative ones."""
        features, used = grasp_features(percept), len(self.mean)
        flat = used == FLAT and features.shape[-1] == FLAT + 1
        if features.shape[-1] != used and not flat:
            raise DataError(
                f"a percept has {percept.shape[-1]} coordinates, which make {features.shape[-1]} "
                f"features; the classifier was fitted on {used}"
            )
        return features[..., :used]

    def standardise(self, percept: Tensor) -> Tensor:
        """See `SuccessClassifier.standardise`; all features have one scale.

        They are lengths with weights that make them about equally important. A feature that hardly
        varies is mostly noise, which a scale of its own would amplify.
        """
        features = grasp_features(percept)[:, : used_features(percept)]
        spread = features.var(0, correction=0).mean().sqrt()
        self.mean = features.mean(0)
        self.scale = torch.where(spread > 0, spread, 1.0).expand_as(self.mean).clone()
        return (features - self.mean) / self.scale
