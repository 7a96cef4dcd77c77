"""Γ, the transition model: the next percept from a percept and a motion.

Nearly all of the answer is geometry (`cgtorch.models.geometry`): points move rigidly, and the box
around a rectangle of known sides follows from its yaw. The box seen leaves open to which side the
table is turned, and that is what support vector regression learns, from where on the table the
object would stand. Where the percept tells the table's yaw, there is nothing to learn, and its
sides are as seen. Obstacles are boxes of shapes that are not known. How Γ is fitted is in
`cgtorch.models.transition_fit`.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from cgtorch.models import geometry
from cgtorch.models.compiled import Compiled, gamma_structure, transitions
from cgtorch.models.svr import SVR
from cgtorch.native.structures import suits
from cgtorch.world.percepts import parted

_NOVEL_SHARE = 0.1  # beyond the data by this share of their range counts as half novel
LN2 = math.log(2)
_NUMBERS = ("mean", "scale", "sides", "most", "trust", "reach")


class TransitionModel(nn.Module):
    """Γ: (percept (..., D), motion (..., 3)) -> next percept (..., D), m and rad.

    D is that of any percept of the tabletop (`cgtorch.world.percepts`). Differentiable in both. The
    machine's one value in [-1, 1] says which of the two yaws that the box allows is the table's: 1
    the first, -1 the second. Other buffers: the features' `mean` and `scale` (4,), the table's
    `sides` (2,), `trust` () 1 where turning the table beats turning its box loosely and else 0,
    `reach` () the squared feature distance that counts as half novel, and `most` (4,) how far off,
    driven, turned and out of shape the data are at most.
    """

    mean: Tensor
    scale: Tensor
    sides: Tensor
    trust: Tensor
    reach: Tensor
    most: Tensor
    machine: SVR

    def __init__(self) -> None:
        super().__init__()
        for name, size in (("mean", 4), ("scale", 4), ("sides", 2), ("most", 4)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        for name in ("trust", "reach"):
            self.register_buffer(name, torch.ones((), dtype=torch.float64))
        self.machine = SVR()

    def forward(self, percept: Tensor, motion: Tensor) -> Tensor:
        """Next percept (..., D).

        Raises:
            DataError: Wrong shapes.
            ModelError: Not fitted.
        """
        return self.predict_with_novelty(percept, motion)[0]

    def novelty(self, percept: Tensor, motion: Tensor) -> Tensor:
        """How far (...) from the training data: 0 on a centre, 1/2 at the data's rim, 1 far off."""
        return self.predict_with_novelty(percept, motion)[1]

    def predict_with_novelty(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Next percept (..., D) and novelty (...), from one kernel evaluation.

        Raises:
            DataError: Wrong shapes.
            ModelError: Not fitted.
        """
        compiled = self.compiled(percept, motion)
        if compiled is not None and percept.shape[:-1] == motion.shape[:-1]:
            rows = percept.reshape(-1, percept.shape[-1]), motion.reshape(-1, 3)
            if (found := transitions(compiled, *rows)) is not None:
                return found[0].view_as(percept), found[1].view(percept.shape[:-1])
        return self.predict_in_torch(percept, motion)

    def predict_in_torch(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """What `predict_with_novelty` says, on any device and with gradients.

        Of percepts (n, D) and motions (n, 3) it gives the next percepts (n, D) and novelties (n,).
        """
        scene = self._scene(percept, motion)
        value, distance = self.machine.values_and_distance(self._features(scene))
        following = _following(scene, motion, value[..., 0].to(percept), self.trust)
        # By how much it exceeds the data, 1 where that is half novel.
        beyond = (_extremes(scene, motion) / self.most.to(percept) - 1).clamp_min(0).sum(-1)
        exponent = distance / self.reach + beyond.to(distance) / _NOVEL_SHARE
        return following, (1 - torch.exp(-LN2 * exponent)).to(percept.dtype)

    def compiled(self, percept: Tensor, motion: Tensor) -> Compiled | None:
        """Γ as compiled code knows it, where it can be asked about percepts (n, D), motions (n, 3).

        Raises:
            DataError: Wrong shapes.
        """
        geometry.check_percept(percept, motion)
        machine, numbers = self.machine._machine, self.tensors()[4:]
        suited = suits(percept, motion, *machine)
        if not suited or self.machine.kernel != "rbf" or not self.machine.fitted:
            return None
        return gamma_structure(machine, dict(zip(_NUMBERS, numbers, strict=True)))

    def tensors(self) -> tuple[Tensor, ...]:
        """Centres (m, 4), weights (m, 1), bias (1,) and γ () of the machine, then other buffers."""
        return *self.machine._machine, *(getattr(self, name) for name in _NUMBERS)

    def features(self, percept: Tensor) -> Tensor:
        """The standardised features (..., 4) that the machine sees; no motion changes them."""
        return self._features(self._scene(percept))

    def following(self, percept: Tensor, motion: Tensor, value: Tensor) -> Tensor:
        """Next percept (..., D) if the machine says `value` (...) about the two yaws."""
        return _following(self._scene(percept, motion), motion, value, self.trust)

    def extremes(self, percept: Tensor, motion: Tensor) -> Tensor:
        """What tells how unusual transitions are (..., 4), in the order of `most`."""
        return _extremes(self._scene(percept, motion), motion)

    def _scene(self, percept: Tensor, motion: Tensor | None = None) -> "_Scene":
        """What percepts (..., D) show; motions are only checked."""
        if motion is not None:
            geometry.check_percept(percept, motion)
        _, side, boxes = parted(percept)
        yaws, sides = geometry.tables_seen(percept, self.sides.to(percept))
        return _Scene(geometry.to_parts(percept), side, boxes, yaws, sides)

    def _features(self, scene: "_Scene") -> Tensor:
        places = geometry.places_on_table(scene.parts, scene.yaws).to(self.mean)
        return (places - self.mean) / self.scale


@dataclass(frozen=True)
class _Scene:
    """What is read off percepts once, for all that is asked of them.

    Attributes:
        parts: (..., 7) as of `geometry.to_parts`.
        side: (..., 2 or 0) and
        boxes: (..., K, 4) as of `cgtorch.world.percepts.parted`.
        yaws: (..., 2) that the table may have.
        sides: (2,) or (..., 2) of the table.
    """

    parts: Tensor
    side: Tensor
    boxes: Tensor
    yaws: Tensor
    sides: Tensor


def _following(scene: _Scene, motion: Tensor, value: Tensor, trust: Tensor) -> Tensor:
    """Next percepts (..., D) if the machine says `value` (...) about the two yaws."""
    moved = geometry.move_rigidly(scene.parts, motion)
    first, second = geometry.boxes_after(scene.yaws, motion, scene.sides).unbind(-2)
    # Sharper than the value itself, which the width of the kernel has smoothed.
    weight = torch.sin(torch.pi / 2 * value.clamp(-1, 1))[..., None] / 2
    extents = (first + second) / 2 + weight * (first - second)
    loose = geometry.loosely_turned(scene.parts[..., 2:4], motion[..., 2])
    extents = loose + trust.to(loose) * (extents - loose)
    after = geometry.columns(moved[..., :2], extents, moved[..., 4:])
    seven = geometry.from_parts(after)
    if scene.side.shape[-1] + scene.boxes.shape[-2] == 0:
        return seven
    others = geometry.boxes_moved(scene.boxes, motion).flatten(-2)
    side = geometry.side_turned(scene.side, motion)
    return torch.cat([seven, side, others], dim=-1)


def _extremes(scene: _Scene, motion: Tensor) -> Tensor:
    return geometry.extremes(scene.parts, motion, scene.yaws, scene.sides)
