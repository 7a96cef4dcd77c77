"""Γ of the tabletop: the next percept from a percept and a motion.

Most of the prediction is geometry (`cgtorch.tabletop.models.geometry`). The box that is seen does
not show to which side the table is turned. Support vector regression learns this from the place
that the object would have on the table. If the percept contains the yaw, there is nothing to learn.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.transition import Grid, HeldOut, TransitionModel
from cgtorch.ground.fields import Field
from cgtorch.native import alike, function, structure
from cgtorch.simulation import CompiledModels, ModelEnvironment
from cgtorch.svm import SVR, grid_search
from cgtorch.svm.rbf import LOG2E, threads_for
from cgtorch.tabletop.models import geometry
from cgtorch.tabletop.models.success import GraspClassifier, compiled_machine
from cgtorch.tabletop.world.clear_motion import ClearMotion, body_structure
from cgtorch.tabletop.world.percepts import parts_of, percept_fields

DECISIVE = 0.03
"""The difference (m) between the boxes of the two yaws from which a transition distinguishes them:
three times the noise of a transition."""
_QUIET_CENTRES = 256


class TableTransitionModel(TransitionModel):
    """Γ: (percept (..., D), motion (..., 3)) -> next percept (..., D), m and rad.

    D is the length of any percept of the tabletop (`cgtorch.tabletop.world.percepts`). It is
    differentiable in both arguments. The machine's only output, in [-1, 1], selects one of the two
    yaws that the box allows: 1 the first, -1 the second. Additional buffers are the table's `sides`
    (2,), and `trust` (), 1 if turning the table beats turning its box loosely, else 0. `most` (4,)
    contains the largest extremes of the data: distance, drive, turn and misfit.
    """

    sides: Tensor
    trust: Tensor
    grid = Grid((1.0, 4.0), (2.0, 4.0, 8.0), (0.1,), 800)

    def __init__(self) -> None:
        super().__init__()
        for name, size in (("mean", 4), ("scale", 4), ("sides", 2), ("most", 4)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        self.register_buffer("trust", torch.ones((), dtype=torch.float64))

    def fields(self, size: int) -> Sequence[Field]:
        """See `TransitionModel.fields`."""
        return percept_fields(size)

    def standardise(
        self, percept: Tensor, control: Tensor, next_percept: Tensor, dtype: torch.dtype
    ) -> None:
        """See `TransitionModel.standardise`: the table's sides and the scale of the features."""
        geometry.check_shapes(percept, control)
        parts = geometry.to_parts(torch.cat([percept, next_percept]))
        self.sides = geometry.table_sides(parts[:, geometry.EXTENTS])
        scene = geometry.scene_of(percept, self.sides)
        places = geometry.places_on_table(scene)
        self.mean = places.mean(0)
        # One scale for all: they are lengths, seen with the same noise.
        spread = places.var(0, correction=0).mean().sqrt()
        self.scale = torch.where(spread > 1e-9, spread, 1.0).expand(places.shape[1]).clone()
        self.most = geometry.extremes(scene, control).amax(0).clamp_min(1e-3)
        self.to(dtype).double()  # which learning on will see like this

    def held_out(self, machine: SVR, x: Tensor, y: Tensor, generator: Generator) -> Tensor | None:
        """See `TransitionModel.held_out`."""
        width = float(machine.gamma)
        found = grid_search(machine, x, y, C=machine.C, gamma=width, seed=generator)
        return found.held_out[0, 0, 0].T.clamp(-1, 1)

    def settle(self, rows: Sequence[Tensor], held: HeldOut) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.settle`.

        Turning the table is used only if it beats turning its box loosely, which gives the second
        errors.
        """
        percept, control, next_percept = rows
        features = self.features(percept, control)
        if not bool(held.learnt):
            _silence(self.machine, features[held.tells])
            self.measure_reach(features[held.tells])
        value = self.machine.values(features)
        value[held.tells] = held.value * held.learnt  # the others were not learnt from
        errors = []
        for trust in (1.0, 0.0):
            self.trust = torch.tensor(trust).to(percept)
            errors.append((self.next_percept(percept, control, value) - next_percept).abs())
        turned, loose = errors
        better = _better(parts_of(turned).box.mean(1), parts_of(loose).box.mean(1))
        self.trust = torch.tensor(float(better)).to(percept)
        return (turned if better else loose).mean(0), loose.mean(0)

    def predict_with_novelty(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.predict_with_novelty`."""
        compiled = self.compiled(percept, control) if percept.is_cpu else None
        size = percept.shape[-1]
        if compiled is None or percept.shape[:-1] != control.shape[:-1]:
            return self.predict_in_torch(percept, control)
        rows, motion = percept.reshape(-1, size).contiguous(), control.reshape(-1, 3).contiguous()
        after, novelty = torch.empty_like(rows), rows.new_empty(len(rows))
        threads = threads_for(len(rows), compiled.machine.m)
        call = function("transitions", rows.dtype)
        call(compiled, size, rows, motion, len(rows), after, novelty, threads)
        return after.view_as(percept), novelty.view(percept.shape[:-1])

    def predict_in_torch(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.predict_in_torch`; the scene is derived only once."""
        scene = self._scene(percept, control)
        value, distance = self.machine.values_and_distance(self._features(scene))
        after = geometry.next_percept(scene, control, value[..., 0].to(percept), self.trust)
        novelty = self.novelty_of(geometry.extremes(scene, control), distance)
        return after, novelty.to(percept.dtype)

    def compiled(self, percept: Tensor, motion: Tensor) -> Any:
        """Γ in the form of compiled code, if it supports percepts (n, D) and motions (n, 3).

        Results equal torch's except for the last digits. A row's result does not depend on others.
        DataError if shapes are wrong.
        """
        geometry.check_shapes(percept, motion)
        made = compiled_machine(self.machine, percept, motion)
        if made is None or made.d != 4:
            return None
        return structure("Gamma", percept.dtype)(
            machine=made, mean=self.mean, scale=self.scale, sides=self.sides, most=self.most,
            trust=float(self.trust), reach=float(self.reach),
            per_distance=1 / (float(self.machine.gamma_value) * LOG2E),
        )  # fmt: skip

    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.features`; no motion changes them."""
        return self._features(self._scene(percept, control))

    def next_percept(self, percept: Tensor, control: Tensor, value: Tensor) -> Tensor:
        """See `TransitionModel.next_percept`; `value` (..., 1) selects one of the two yaws."""
        scene = self._scene(percept, control)
        return geometry.next_percept(scene, control, value[..., 0], self.trust)

    def extremes(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.extremes`."""
        return geometry.extremes(self._scene(percept, control), control)

    def targets(
        self, percept: Tensor, control: Tensor, next_percept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.targets`.

        The target is where the next extents are between those of the second yaw, -1, and of the
        first, 1. If the percept contains the yaw, it is 0, and all transitions are equally
        informative.
        """
        scene = self._scene(percept, control)
        first, second = geometry.boxes_after(scene.yaws, control, scene.sides).unbind(-2)
        half = (first - second) / 2
        size = half.norm(dim=-1)
        after = geometry.to_parts(next_percept)[..., geometry.EXTENTS]
        off = after - (first + second) / 2
        target = ((off * half).sum(-1) / size.square().clamp_min(1e-12)).clamp(-1, 1)
        tells = (size > DECISIVE / 2) | (scene.yaws[..., 0] == scene.yaws[..., 1])
        return target[:, None], tells

    def shapes(self, features: int) -> dict[str, tuple[int, ...]]:
        """See `TransitionModel.shapes`."""
        return {"mean": (4,), "scale": (4,), "most": (4,), "sides": (2,)}

    def _scene(self, percept: Tensor, motion: Tensor) -> geometry.Scene:
        geometry.check_shapes(percept, motion)
        return geometry.scene_of(percept, self.sides.to(percept))

    def _features(self, scene: geometry.Scene) -> Tensor:
        return (geometry.places_on_table(scene).to(self.mean) - self.mean) / self.scale


def _better(error: Tensor, baseline: Tensor) -> bool:
    """Whether errors (n,) are below the baseline's by more than the standard error."""
    gain = baseline - error
    return bool(gain.mean() > gain.std() / len(gain) ** 0.5)


def _silence(machine: SVR, rows: Tensor) -> None:
    """Set the machine's output to 0; a few centres stay for the novelty."""
    some = torch.arange(min(len(rows), _QUIET_CENTRES), device=rows.device)
    machine.centres, machine.support = rows[some].clone(), some
    machine.weights = rows.new_zeros(len(some), 1)
    machine.bias, machine.gap, machine.cost = (rows.new_zeros(1) for _ in range(3))


def compiled_models(e: ModelEnvironment) -> CompiledModels | None:
    """Γ, C and the check of motions for compiled rollouts, or None if they are not compiled."""
    gamma, classifier = getattr(e.gamma, "__self__", None), e.classifier
    if not (type(gamma) is TableTransitionModel and type(classifier) is GraspClassifier):
        return None
    if type(e.possible) is not ClearMotion or e.gamma != gamma.predict_with_novelty:
        return None
    percepts, footprint = e.percepts, e.possible.footprint
    first, second = gamma.compiled(percepts, percepts[:, :3]), classifier.compiled(percepts)
    if first is None or second is None or not alike(percepts, footprint) or e.control_size != 3:
        return None
    models = structure("TabletopModels", percepts.dtype)(
        gamma=first, classifier=second, body=body_structure(footprint)
    )
    return CompiledModels(
        "tabletop", percepts.dtype, models, ("DOMAIN_NN", "DOMAIN_OTHER_NN", "DOMAIN_BRANCHING")
    )
