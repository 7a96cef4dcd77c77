"""Primitives: routines of several low-level steps with parameters, an end, and an outcome.

A primitive moves the hand along one to four straight segments, which are the controls of an arm's
world. Its parameters are offsets, in units of `OFFSET` or `WAY`, from places that the percept
tells. It ends the skill when the task is solved, and when the time is over.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Generator, Tensor

from cgtorch.graphs import Action
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.manipulation.arm import Arm

OFFSET, WAY, DEEP = 0.03, 0.1, 0.06  # m by which one unit of a parameter moves a target
SMALL = 0.4  # the standard deviation of offsets of new nodes, in units of `OFFSET`
CLEARANCE = 0.08  # m above a thing from which the hand comes down to it
FAR, NEAR, SHORT = 45, 25, 30  # low-level steps of segments, at most
ARRIVED, PASSED = 0.01, 0.03
"""Distances from a target on each axis, in m, where a segment ends, or one of several."""
FINGERS = 12  # low-level steps in which a gripper opens or closes
OPENED, CLOSED = 0.0, 1.0  # in the memory

SOLVED, OVER = 2, 1


class Primitive(Action):
    """A routine of an arm; the gripper stays as the last primitive left it."""

    outcomes = ("done", "time over", "solved")
    terminal: Mapping[str, bool] = {"time over": False, "solved": True}
    memory_size, memory_part = 1, "gripper"
    num_parameters = 3
    first_step = 0.5

    def __init__(self, arm: Arm, place: str = "object", pace: float = 1.0) -> None:
        """For an arm, to one of its places; `pace` multiplies numbers of low-level steps."""
        super().__init__()
        self.arm, self.place, self.pace = arm, place, pace

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """See `Action.initial_parameters`; offsets, the first three, are small."""
        drawn = torch.randn(n, self.num_parameters, generator=generator)
        drawn[:, :3] *= SMALL
        return drawn

    def at(self, lanes: Lanes, place: str = "hand") -> Tensor:
        """(n, 3) the position of a place, m."""
        return self.arm.position(lanes.percept, place)

    def aim(self, lanes: Lanes, offset: Tensor) -> Tensor:
        """(n, 3) the place of this primitive, with an offset (n, 3) in units of `OFFSET`."""
        return self.at(lanes, self.place) + OFFSET * offset

    def go(
        self,
        lanes: Lanes,
        environment: Environment,
        target: Tensor,
        steps: int,
        speed: Tensor | None = None,
        near: float = ARRIVED,
    ) -> Lanes:
        """The lanes after a segment to a target (n, 3), at a share (n, 1) of full speed.

        It ends after a number of low-level steps, or `near` the target, in m on each axis.
        """
        grip = 2 * lanes.memory[:, :1] - 1
        limit = torch.full_like(grip, max(1, round(self.pace * steps)))
        fast = torch.ones_like(grip) if speed is None else speed
        more = grip, limit, fast, torch.full_like(grip, near)
        return environment.step(lanes, torch.cat([target, *more], 1))[0]

    def from_above(self, lanes: Lanes, environment: Environment, target: Tensor) -> Lanes:
        """The lanes after the hand came to a target (n, 3) from above."""
        hand = self.at(lanes)
        high = torch.maximum(hand[:, 2:], target[:, 2:] + CLEARANCE)
        lanes = self.over(lanes, environment, (hand, target), high)
        return self.go(lanes, environment, target, NEAR)

    def over(
        self, lanes: Lanes, environment: Environment, ways: Sequence[Tensor], high: Tensor
    ) -> Lanes:
        """The lanes after the hand passed over points (n, 3) at a height (n, 1)."""
        for way in ways:
            above = torch.cat([way[:, :2], high], 1)
            lanes = self.go(lanes, environment, above, FAR, near=PASSED)
        return lanes

    def fingers(self, lanes: Lanes, environment: Environment, state: float) -> Lanes:
        """The lanes after the gripper opened or closed."""
        return self.go(with_gripper(lanes, state), environment, self.at(lanes), FINGERS, near=0.0)

    def ended(self, lanes: Lanes, environment: Environment) -> tuple[Lanes, Tensor]:
        """The lanes, and how the primitive ended."""
        lanes, chance = environment.success(lanes)
        over = torch.where(self.late(lanes), OVER, 0)
        return lanes, torch.where(chance > 0.5, SOLVED, over)

    def late(self, lanes: Lanes) -> Tensor:
        """(n,) bool, whether the time of an episode is over."""
        return self.arm.elapsed(lanes.percept) >= 1 - 1e-4


class Close(Primitive):
    """Close the gripper."""

    num_parameters = 0
    state: ClassVar[float] = CLOSED

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        return self.ended(self.fingers(lanes, environment, self.state), environment)


class Open(Close):
    """Open the gripper."""

    state = OPENED


class Wait(Primitive):
    """Stay until the time is over, for tasks that count at the last step."""

    num_parameters = 0

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes = self.go(lanes, environment, self.at(lanes), 4 * FAR, near=0.0)
        return self.ended(lanes, environment)


class Reach(Primitive):
    """Move the hand to the place, with an offset."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        lanes = self.go(lanes, environment, self.aim(lanes, parameters), FAR)
        return self.ended(lanes, environment)


class Shift(Primitive):
    """Move the hand along a vector."""

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """See `Action.initial_parameters`."""
        return torch.randn(n, self.num_parameters, generator=generator)

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        target = self.at(lanes) + WAY * parameters
        return self.ended(self.go(lanes, environment, target, SHORT), environment)


class Carry(Primitive):
    """Move so that the object comes to the place, with an offset, if it moves with the hand."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        target = self.carried(lanes, parameters)
        return self.ended(self.go(lanes, environment, target, FAR), environment)

    def carried(self, lanes: Lanes, offset: Tensor) -> Tensor:
        """(n, 3) where the hand has to be."""
        return self.at(lanes) - self.at(lanes, "object") + self.aim(lanes, offset)


class Insert(Carry):
    """Carry the object to the place, first across and up or down, then along x.

    The first parameter, how far it goes along x, has a unit of `DEEP`, as objects can be long.
    """

    def initial_parameters(self, n: int, generator: Generator) -> Tensor:
        """See `Action.initial_parameters`."""
        drawn = super().initial_parameters(n, generator)
        drawn[:, 0] /= SMALL
        return drawn

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        unit = parameters.new_tensor([DEEP / OFFSET, 1.0, 1.0])
        target, hand = self.carried(lanes, unit * parameters), self.at(lanes)
        aside = torch.cat([hand[:, :1], target[:, 1:]], 1)
        lanes = self.go(lanes, environment, aside, FAR, near=PASSED / 2)
        return self.ended(self.go(lanes, environment, target, FAR), environment)


class Place(Carry):
    """Carry the object to the place: up, across, and down; the fourth parameter is the height."""

    num_parameters = 4

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        target, hand = self.carried(lanes, parameters[:, :3]), self.at(lanes)
        rise = (WAY + WAY / 2 * parameters[:, 3:]).clamp_min(0)
        high = torch.maximum(hand[:, 2:], target[:, 2:]) + rise
        lanes = self.over(lanes, environment, (hand, target), high)
        return self.ended(self.go(lanes, environment, target, NEAR), environment)


class Pick(Primitive):
    """Grasp at the place with an offset, from above."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        target = self.aim(lanes, parameters)
        lanes = self.from_above(with_gripper(lanes, OPENED), environment, target)
        return self.ended(self.fingers(lanes, environment, CLOSED), environment)


class Push(Primitive):
    """Come to the place with an offset from above, closed, and move along a vector."""

    num_parameters = 6

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        target = self.aim(lanes, 2 * parameters[:, :3])
        lanes = self.from_above(with_gripper(lanes, CLOSED), environment, target)
        target = self.at(lanes) + 1.5 * WAY * parameters[:, 3:]
        return self.ended(self.go(lanes, environment, target, FAR), environment)


class Drag(Primitive):
    """Come to the object with an offset from above, closed, and move as it has to move to the goal.

    The second three parameters are an offset of the end.
    """

    num_parameters = 6

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        way = self.at(lanes, "goal") - self.at(lanes, "object")
        target = self.at(lanes, "object") + 2 * OFFSET * parameters[:, :3]
        lanes = self.from_above(with_gripper(lanes, CLOSED), environment, target)
        target = self.at(lanes) + way + OFFSET * parameters[:, 3:]
        return self.ended(self.go(lanes, environment, target, FAR), environment)


class PushTo(Primitive):
    """Push the object to the goal: come down behind it, and move on along the line to the goal.

    The parameters are the distance behind it, the height, where the motion ends, and its speed.
    """

    num_parameters = 4

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        back, height, end, fast = parameters.split(1, 1)
        thing, goal = self.at(lanes, "object"), self.at(lanes, "goal")
        way = (goal - thing)[:, :2]
        way = way / way.norm(dim=1, keepdim=True).clamp_min(1e-3)
        low = thing[:, 2:] + OFFSET * height
        behind = thing[:, :2] - (0.09 + OFFSET * back) * way
        target = torch.cat([behind, low], 1)
        lanes = self.from_above(with_gripper(lanes, CLOSED), environment, target)
        last = torch.cat([goal[:, :2] - (0.06 + OFFSET * end) * way, low], 1)
        speed = (0.6 + 0.3 * fast).clamp(0.05, 1)
        return self.ended(self.go(lanes, environment, last, FAR, speed), environment)


class Hit(Primitive):
    """Hit the object towards the goal: come down behind it, and stroke by the distance to go.

    The parameters are the distance behind it, the height, and the stroke's length and speed, each
    with the share by which it grows with the distance.
    """

    num_parameters = 6

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        """See `Action.forward`."""
        back, height, long, longer, fast, faster = parameters.split(1, 1)
        thing, goal = self.at(lanes, "object"), self.at(lanes, "goal")
        way = (goal - thing)[:, :2]
        distance = way.norm(dim=1, keepdim=True).clamp_min(1e-3)
        way = way / distance
        low = thing[:, 2:] + OFFSET * height
        behind = thing[:, :2] - (0.1 + OFFSET * back) * way
        lanes = with_gripper(lanes, CLOSED)
        lanes = self.from_above(lanes, environment, torch.cat([behind, low], 1))
        stroke = 0.15 + 0.05 * long + (0.2 + 0.1 * longer) * distance
        speed = 0.5 + 0.3 * fast + (0.5 + 0.3 * faster) * (distance - 0.4)
        target = torch.cat([behind + stroke * way, low], 1)
        lanes = self.go(lanes, environment, target, FINGERS, speed.clamp(0.05, 1), near=0.0)
        return self.ended(lanes, environment)


def with_gripper(lanes: Lanes, state: float) -> Lanes:
    """The lanes with the gripper to be opened or closed in the next segment."""
    return replace(lanes, memory=torch.full_like(lanes.memory, state))


def primitives(arm: Arm, pace: float = 1.0) -> dict[str, Primitive]:
    """All primitives of an arm by name; those that can go to several places are named after them.

    `pace` multiplies all numbers of low-level steps.
    """
    others = [place for place in arm.places if place != "object"]
    single = (Shift, Pick, Push, Drag, PushTo, Hit, Open, Close)
    return {
        **{f"Reach{p.title()}": Reach(arm, p, pace) for p in arm.places},
        **{f"Carry{p.title()}": Carry(arm, p, pace) for p in others},
        **{f"Insert{p.title()}": Insert(arm, p, pace) for p in others},
        "Place": Place(arm, "goal", pace),
        **{kind.__name__: kind(arm, "object", pace) for kind in single},
    }
