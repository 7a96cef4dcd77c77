"""A stroke that lets an object slide to a goal out of the hand's reach."""

import torch
from torch import Tensor

from cgtorch.ground.environment import Environment, Lanes
from cgtorch.manipulation.primitives import CLOSED, NEAR, Primitive, with_gripper

FINGER = (0.0135, 0.0149)  # m from the middle of a Fetch's closed gripper to its sides, in x and y
RADIUS = 0.025  # m, of the object
GAP, RISE = 0.014, 0.011  # m from the fingers to the object, and from its middle to the hand's
ABOVE = 0.07  # m above its last height at which the hand passes over the object
SLOWED = 0.981  # m/s² by which friction slows the object, a tenth of gravity
FULL = 1.25  # m/s of the hand at its full speed
BEYOND = 0.5  # m, so far that a stroke does not slow down
SETTLE, STROKE = 3, 9  # segments of a low-level step each, and low-level steps at a pace of 1
UNITS = (0.004, 0.004, 0.05, 0.01, 0.05, 0.01)
"""Of the parameters; see `Strike`."""


class Strike(Primitive):
    """Strike the object so that it slides to the goal: come down behind it, stop, and stroke.

    A corner of the closed gripper meets the object, which leaves along the line from the corner to
    its middle. The hand aims anew while it comes, since the object may still move a little. The
    parameters, whose units are `UNITS`, are added to

    - the gap between the gripper and the object before the stroke, in m;
    - the height of the hand above the object's middle, in m;
    - the stroke's speed, as a share of the speed with which the object has to leave;
    - that speed, as a share of the hand's full speed;
    - the angle from the x axis to the stroke, as a share of it;
    - that angle, in rad.
    """

    num_parameters = len(UNITS)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes = with_gripper(lanes, CLOSED)
        more = parameters * parameters.new_tensor(UNITS)
        hand, low = self.at(lanes), self.behind(lanes, more)
        high = torch.maximum(hand[:, 2:], low[:, 2:] + ABOVE)
        lanes = self.over(lanes, environment, (hand,), high)
        lanes = self.over(lanes, environment, (self.behind(lanes, more),), high)
        lanes = self.go(lanes, environment, self.behind(lanes, more), NEAR)
        for _ in range(SETTLE):  # with twice the usual gain, so that less of an error is left
            target = 2 * self.behind(lanes, more) - self.at(lanes)
            lanes = self.go(lanes, environment, target, 1, near=0.0)
        along, needed = self.aimed(lanes, more)
        speed = (1 + more[:, 2:3]) * needed / FULL + more[:, 3:4]
        speed = speed * along.abs().amax(1, keepdim=True)  # that of the faster axis
        target = self.behind(lanes, more)
        target[:, :2] += BEYOND * along
        lanes = self.go(lanes, environment, target, STROKE, speed.clamp(0.05, 1), near=0.0)
        return self.ended(lanes, environment)

    def behind(self, lanes: Lanes, more: Tensor) -> Tensor:
        """(n, 3) where the hand has to be before the stroke."""
        along, _ = self.aimed(lanes, more)
        thing = self.at(lanes, "object")
        corner = thing[:, :2] - (RADIUS + (GAP + more[:, :1]).clamp_min(0)) * along
        middle = corner - along.new_tensor(FINGER) * along.sign()
        return torch.cat([middle, thing[:, 2:] + RISE + more[:, 1:2]], 1)

    def aimed(self, lanes: Lanes, more: Tensor) -> tuple[Tensor, Tensor]:
        """The direction (n, 2) of the stroke, and the speed (n, 1) that the object needs, m/s."""
        needed = launch((self.at(lanes, "goal") - self.at(lanes, "object"))[:, :2])
        angle = torch.atan2(needed[:, 1:], needed[:, :1]) * (1 + more[:, 4:5]) + more[:, 5:]
        return torch.cat([angle.cos(), angle.sin()], 1), needed.norm(dim=1, keepdim=True)


def launch(way: Tensor) -> Tensor:
    """(n, 2) the velocity in m/s with which an object comes to rest after a way (n, 2) in m.

    MuJoCo's cone of friction is a pyramid by default. It slows an object on the axis on which it is
    faster, and on both, half as much each, once its speeds are alike. With speeds p > q it comes to
    rest after (p² + q²) / 2a on the first axis and pq / a on the second one, where a is `SLOWED`.
    So its way bends towards the diagonal.
    """
    size = way.abs()
    most, least = size.amax(1, keepdim=True), size.amin(1, keepdim=True)
    both, rest = (most + least).sqrt(), (most - least).sqrt()
    speed = torch.where(size == most, both + rest, both - rest)
    return (SLOWED / 2) ** 0.5 * speed * way.sign()
