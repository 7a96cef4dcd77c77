"""C of the tabletop: whether a grasp succeeds, given the object and the sides of the table."""

from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.success import SuccessClassifier
from cgtorch.ground.errors import DataError
from cgtorch.native import alike, constants, function, structure
from cgtorch.svm.machine import KernelMachine
from cgtorch.svm.rbf import machine_structure, threads_for
from cgtorch.tabletop.world.percepts import parts_of

FLAT = 7  # features of box percepts, without the height, where all tables are as high
SAME_HEIGHT = 0.02  # m, a standard deviation of heights that is hardly more than noise
NEAR = 0.5  # m over which a side of the table stops to matter
STRETCH = 4.0  # weight of the object's distance, in which success changes over centimetres
TURN = 2.0  # weight of its direction
RISE = 3.0  # weight of its height, with which the reach of the arms changes
EDGES = 2  # that matter, those that the robot stands farthest in front of
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


def grasp_features(percept: Tensor) -> Tensor:
    """Features (..., F) of tabletop percepts (..., D); for errors see `parts_of`.

    An arm reaches a ring about its shoulder, so the object is given by its distance, the two
    numbers of its direction, and its height. Arms reach over obstacles, so these are left out. For
    box percepts, F = 8: the four sides of the table's box come first, each saturated at `NEAR`,
    since what lies beyond the arms changes nothing; the height is last. If the percept contains the
    table's yaw, F = 10: the two edges in front of which the robot is farthest out (`edges`) are
    last.
    """
    seen = parts_of(percept)
    placed = seen.object
    distance = placed.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    polar = torch.cat([STRETCH * distance, TURN * placed / distance], -1)
    height = RISE * seen.height
    if seen.side.shape[-1]:
        return torch.cat([polar, height, edges(seen.table, placed)], -1)
    return torch.cat([NEAR * torch.tanh(seen.box / NEAR), polar, height], -1)


def edges(table: Tensor, placed: Tensor) -> Tensor:
    """(..., 6), the two edges of tables (..., 5) in front of which the robot is farthest out.

    These are the robot's distances in front of them, saturated at `NEAR`; the distances of the
    object (..., 2) from them (m); and the outward direction of the first, of length `NEAR`.
    """
    c, s = table[..., 2].cos(), table[..., 2].sin()
    outward = torch.stack([c, s, -c, -s, -s, c, s, -c], -1).unflatten(-1, (4, 2))
    half = table[..., [3, 3, 4, 4]] / 2
    ahead = -(outward * table[..., None, :2]).sum(-1) - half
    inset = half - (outward * (placed - table[..., :2])[..., None, :]).sum(-1)
    order = ahead.argsort(-1, descending=True)[..., :EDGES]
    first = outward.gather(-2, order[..., :1, None].expand(*order.shape[:-1], 1, 2))[..., 0, :]
    ahead = NEAR * torch.tanh(ahead.gather(-1, order) / NEAR)
    return torch.cat([ahead, inset.gather(-1, order), NEAR * first], -1)


def used_features(percept: Tensor) -> int:
    """The number of features of percepts (n, D), from the first, that are informative.

    These are all, except the height of box percepts if all tables have the same height.
    """
    seen = parts_of(percept)
    if seen.side.shape[-1]:
        return FLAT + 3
    return FLAT + int(bool(seen.height.std(correction=0) > SAME_HEIGHT))


def compiled_machine(machine: KernelMachine, percept: Tensor, *more: Tensor) -> Any:
    """A machine with one output, or None if C does not support percepts (n, D) and the rest."""
    if not alike(percept, *machine.tensors, *more) or not machine.fitted:
        return None
    made = machine_structure(*machine.tensors)
    if made is None or made.k != 1:
        return None
    most = constants("engine_limits", percept.dtype)["MOST_PERCEPT"]
    return made if percept.shape[-1] <= most else None
