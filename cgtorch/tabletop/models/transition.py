"""Γ, the transition model: the next percept from a percept and a motion.

Nearly all of the answer is geometry (`cgtorch.tabletop.models.geometry`): points move rigidly, and
the box around a rectangle of known sides follows from its yaw. The box seen leaves open to which
side the table is turned, and that is what support vector regression learns, from where on the table
the object would stand. Where the percept tells the table's yaw, there is nothing to learn, and its
sides are as seen. Obstacles are boxes of shapes that are not known. How Γ is fitted is in
`cgtorch.tabletop.models.transition_fit`.
"""

from typing import Any

import torch
from torch import Tensor

from cgtorch.domains.transition import TransitionModel
from cgtorch.native import constants, function, structure, suits
from cgtorch.svm.compiled import LOG2E, machine_structure, threads_for
from cgtorch.tabletop.models import geometry

DECISIVE = 0.03
"""Metres by which the boxes of the two yaws have to differ for a transition to tell them apart:
three times the noise of a transition."""


class TableTransitionModel(TransitionModel):
    """Γ: (percept (..., D), motion (..., 3)) -> next percept (..., D), m and rad.

    D is that of any percept of the tabletop (`cgtorch.tabletop.world.percepts`). Differentiable in
    both. The machine's one value in [-1, 1] says which of the two yaws that the box allows is the
    table's: 1 the first, -1 the second. Further buffers: the table's `sides` (2,), and `trust` () 1
    where turning the table beats turning its box loosely and else 0. `most` (4,) is how far off,
    driven, turned and out of shape the data are at most.
    """

    sides: Tensor
    trust: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name, size in (("mean", 4), ("scale", 4), ("sides", 2), ("most", 4)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        self.register_buffer("trust", torch.ones((), dtype=torch.float64))

    def predict_with_novelty(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.predict_with_novelty`."""
        compiled, size = self.compiled(percept, control), percept.shape[-1]
        if compiled is None or percept.shape[:-1] != control.shape[:-1]:
            return self.predict_in_torch(percept, control)
        rows, motion = percept.reshape(-1, size).contiguous(), control.reshape(-1, 3).contiguous()
        after, novelty = torch.empty_like(rows), rows.new_empty(len(rows))
        call, threads = (
            function("transitions", rows.dtype),
            threads_for(len(rows), compiled.machine.m),
        )
        call(compiled, size, rows, motion, len(rows), after, novelty, threads)
        return after.view_as(percept), novelty.view(percept.shape[:-1])

    def predict_in_torch(self, percept: Tensor, control: Tensor) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.predict_in_torch`; a scene is read off percepts only once."""
        scene = self._scene(percept, control)
        value, distance = self.machine.values_and_distance(self._features(scene))
        after = geometry.next_percept(scene, control, value[..., 0].to(percept), self.trust)
        novelty = self.novelty_of(geometry.extremes(scene, control), distance)
        return after, novelty.to(percept.dtype)

    def compiled(self, percept: Tensor, motion: Tensor) -> Any:
        """Γ as compiled code knows it, where it can be asked about percepts (n, D), motions (n, 3).

        The same numbers as torch's but for the last digits; a row's do not depend on the others.
        DataError if the shapes are wrong.
        """
        geometry.check_shapes(percept, motion)
        machine = self.machine._machine
        if not suits(percept, motion, *machine) or not self.machine.fitted:
            return None
        made = machine_structure(*machine)
        if made is None or made.d != 4 or made.k != 1:
            return None
        if percept.shape[-1] > constants("engine_limits", percept.dtype)["MOST_PERCEPT"]:
            return None
        return structure("Gamma", percept.dtype)(
            machine=made, mean=self.mean, scale=self.scale, sides=self.sides, most=self.most,
            trust=float(self.trust), reach=float(self.reach),
            per_distance=1 / (float(machine[3]) * LOG2E),
        )  # fmt: skip

    def features(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.features`; no motion changes them."""
        return self._features(self._scene(percept, control))

    def next_percept(self, percept: Tensor, control: Tensor, value: Tensor) -> Tensor:
        """See `TransitionModel.next_percept`; `value` (..., 1) is about the two yaws."""
        scene = self._scene(percept, control)
        return geometry.next_percept(scene, control, value[..., 0], self.trust)

    def extremes(self, percept: Tensor, control: Tensor) -> Tensor:
        """See `TransitionModel.extremes`."""
        return geometry.extremes(self._scene(percept, control), control)

    def targets(
        self, percept: Tensor, control: Tensor, next_percept: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See `TransitionModel.targets`.

        The target is where the next extents lie between those of the second yaw, -1, and of the
        first, 1. Where the percept tells the yaw, it is 0 and all transitions are worth as much.
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
