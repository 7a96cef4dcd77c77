"""Rewards of standard tasks as functions of what is perceived, for episodes that are imagined.

They are given to this library together with its learned Γ, and to no other: what a step is worth
and when an episode is over. What happens in a step is not in them.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cgtorch.domains.rewarded_model import Reward
from standard.classic import CartPole, MountainCarContinuous
from standard.double_pole import DoublePole


def cartpole(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """1 in each step, until the cart or the pole is beyond its limit."""
    limits = (CartPole.limits * CartPole.scale[::2]).to(after)
    return torch.ones_like(after[:, 0]), (after[:, ::2].abs() > limits).any(1)


def acrobot(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """-1 in each step but the one in which the tip is high enough."""
    cosine, sine, bend, bent = after[:, :4].unbind(1)
    high = cosine + (cosine * bend - sine * bent) < -1
    return high.to(after) - 1, high


def mountain_car_continuous(
    before: Tensor, control: Tensor, after: Tensor
) -> tuple[Tensor, Tensor]:
    """Pushing costs, and the flag brings 100."""
    world = MountainCarContinuous
    flag = (world.flag.double() - world.centre[0]) * world.scale[0]
    there = after[:, 0] >= flag.to(after)
    return 100 * there.to(after) - 0.1 * control[:, 0].square(), there


def pendulum(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """The angle from upright, its velocity and the torque cost."""
    angle, spin = torch.atan2(before[:, 1], before[:, 0]), 8 * before[:, 2]
    cost = angle.square() + 0.1 * spin.square() + 0.004 * control[:, 0].square()
    return -cost, torch.zeros(len(after), dtype=torch.bool)


def double_pole(before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """1 in each step but the one in which the cart or a pole is beyond its limit."""
    limits = torch.from_numpy(DoublePole.limits) * DoublePole.scale[:3]
    fallen = (after[:, :3].abs() > limits.to(after)).any(1)
    return 1 - fallen.to(after), fallen


@dataclass(frozen=True)
class Given:
    """What is known of a task before anything is learned.

    Attributes:
        reward: of a step, and whether it ends the episode.
        bounds: of each number of a percept.
        circles: places of a cosine in a percept, behind each of which is the sine.
    """

    reward: Reward
    bounds: tuple[float, float] = (-math.inf, math.inf)
    circles: tuple[int, ...] = ()


GIVEN: dict[str, Given] = {
    "cartpole": Given(cartpole),
    "acrobot": Given(acrobot, (-1, 1), (0, 2)),
    "mountain_car_continuous": Given(mountain_car_continuous, (-1, 1)),
    "pendulum": Given(pendulum, (-1, 1), (0,)),
    "double_pole": Given(double_pole),
}
"""By the names of the tasks; of a task that is not among them Γ cannot tell what it is worth."""
