"""C of the tabletop: whether a grasp succeeds, from where the object stands and the table ends."""

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
"""The hyper-parameters that cross-validation chooses from."""


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
        """C as compiled code knows it, where that can be asked about percepts (n, D).

        The same numbers as torch's but for the last digits; a row's do not depend on the others.
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
        """See `SuccessClassifier.raw_features`: those that were worth learning from."""
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

        They are lengths and weighed so that they matter about as much, and what hardly varies is
        hardly more than noise, which a scale of its own would blow up.
        """
        features = grasp_features(percept)[:, : used_features(percept)]
        spread = features.var(0, correction=0).mean().sqrt()
        self.mean = features.mean(0)
        self.scale = torch.where(spread > 0, spread, 1.0).expand_as(self.mean).clone()
        return (features - self.mean) / self.scale
