"""Γ, the transition model: the next percept from a percept and a motion.

Nearly all of the answer is geometry (`cgtorch.models.geometry`): points move rigidly, and the box
around a rectangle of known sides follows from its yaw. The box seen leaves open to which side the
table is turned, and that is what support vector regression learns, from where on the table the
object would stand. Where the percept tells the table's yaw, there is nothing to learn, and its
sides are as seen. Obstacles are boxes of shapes that are not known. How Γ is fitted is in
`cgtorch.models.transition_fit`.
"""

import torch
from torch import Tensor, nn

from cgtorch.models import geometry
from cgtorch.models.svr import SVR
from cgtorch.world.percepts import parted

_NOVEL_SHARE = 0.1  # beyond the data by this share of their range counts as half novel


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
        value, _ = self._asked(percept, motion)
        return self.following(percept, motion, value)

    def novelty(self, percept: Tensor, motion: Tensor) -> Tensor:
        """How far (...) from the training data: 0 on a centre, 1/2 at the data's rim, 1 far off."""
        return self.predict_with_novelty(percept, motion)[1]

    def predict_with_novelty(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Next percept (..., D) and novelty (...), from one kernel evaluation.

        Raises:
            DataError: Wrong shapes.
            ModelError: Not fitted.
        """
        value, distance = self._asked(percept, motion)
        following = self.following(percept, motion, value)
        beyond = self._beyond(percept, motion).to(distance)
        return following, (1 - torch.exp2(-distance / self.reach - beyond)).to(percept.dtype)

    def _asked(self, percept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """What the machine says (...) and the distance (...)."""
        geometry.check_percept(percept, motion)
        value, distance = self.machine.values_and_distance(self.features(percept))
        return value[..., 0].to(percept), distance

    def features(self, percept: Tensor) -> Tensor:
        """The standardised features (..., 4) that the machine sees; no motion changes them."""
        yaws, _ = geometry.tables_seen(percept, self.sides.to(percept))
        places = geometry.places_on_table(geometry.to_parts(percept), yaws).to(self.mean)
        return (places - self.mean) / self.scale

    def following(self, percept: Tensor, motion: Tensor, value: Tensor) -> Tensor:
        """Next percept (..., D) if the machine says `value` (...) about the two yaws."""
        _, side, boxes = parted(percept)
        parts = geometry.to_parts(percept)
        moved = geometry.move_rigidly(parts, motion)
        yaws, sides = geometry.tables_seen(percept, self.sides.to(percept))
        first, second = geometry.boxes_after(yaws, motion, sides).unbind(-2)
        # Sharper than the value itself, which the width of the kernel has smoothed.
        weight = torch.sin(torch.pi / 2 * value.clamp(-1, 1))[..., None] / 2
        extents = (first + second) / 2 + weight * (first - second)
        loose = geometry.loosely_turned(parts[..., 2:4], motion[..., 2])
        extents = loose + self.trust.to(parts) * (extents - loose)
        after = torch.cat([moved[..., :2], extents, moved[..., 4:]], dim=-1)
        others = geometry.boxes_moved(boxes, motion).flatten(-2)
        return torch.cat(
            [geometry.from_parts(after), geometry.side_turned(side, motion), others], dim=-1
        )

    def _beyond(self, percept: Tensor, motion: Tensor) -> Tensor:
        """By how much (...) percept and motion exceed the data, 1 where that is half novel."""
        yaws, sides = geometry.tables_seen(percept, self.sides.to(percept))
        seen = geometry.extremes(geometry.to_parts(percept), motion, yaws, sides)
        return (seen / self.most.to(percept) - 1).clamp_min(0).sum(-1) / _NOVEL_SHARE
