"""What an arm must keep clear of on its way: table, object, body, other arms, and itself."""

from dataclasses import dataclass

from torch import Tensor

from cgtorch.tabletop.kinematics.collision import Tensors

TABLE, OBJECT, HELD, OWN = range(4)
"""The first solids of a scene: the table, the standing object, and the held object. Those of the
arm begin at `OWN`, followed by fixed ones."""
REACH, APPROACH, LIFT, CARRY = 1, 2, 4, 8
"""Kinds of ways: to the pre-grasp, to the grasp, up with the object, and home with it."""
ALWAYS = REACH | APPROACH | LIFT | CARRY
OBJECT_RADIUS, OBJECT_HALF = 0.025, 0.05  # m, of the upright cylinder that an object is taken for


@dataclass(frozen=True, eq=False)
class Scene(Tensors):
    """An arm, and everything that it must keep clear of.

    Attributes:
        pose, size, radius, frame: (S, ...) of solids, see `Solids`. Those of table and objects
            differ by row.
        pairs: (P, 3) long: two solids, of which the first moves, and the kinds of ways on which
            they must stay apart.
        reach: (P, n) how much closer a unit of each joint can bring a pair at most, m.
    """

    pose: Tensor
    size: Tensor
    radius: Tensor
    frame: Tensor
    pairs: Tensor
    reach: Tensor
