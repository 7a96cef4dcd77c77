"""A small analytic domain with rewards: a cart that is to come to a flag with few pushes."""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch import Domain, Field, Lanes, RewardedModels, ScenarioBatch, World

PLACE, SPEED, STEPS, RETURN, OVER = range(5)
LIMIT, FLAG = 30, 1.0


@dataclass(frozen=True)
class Places(ScenarioBatch):
    """Where carts begin."""

    place: Tensor


class Track(World):
    """A push changes the speed; each step costs 1, and the flag brings 20."""

    control_size = 1

    def first_state(self, scenario: Tensor) -> Tensor:
        place = self.scenarios.place[scenario]
        return torch.stack([place, *[torch.zeros_like(place)] * 4], 1).double()

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        place, speed, steps, total, over = state.unbind(1)
        speed = 0.9 * speed + 0.1 * control[:, 0].clamp(-1, 1)
        place = place + speed
        there = (place > FLAG).double()
        ended = torch.maximum(there, (steps + 1 >= LIMIT).double())
        after = torch.stack([place, speed, steps + 1, total + 20 * there - 1, ended], 1)
        return torch.where(over[:, None] > 0, state, after)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        return state[:, :STEPS]

    def succeeded(self, state: Tensor) -> Tensor:
        return state[:, RETURN] > 0

    def over(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, OVER] > 0

    def returns(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, RETURN]


class CartModels(RewardedModels["RewardedCart"]):
    """Γ of the cart, whose episodes are broken off."""

    most_steps = LIMIT


class GivenModels(CartModels):
    """Γ of the cart, of which rewards are known."""

    def reward(self, before: Tensor, control: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:  # type: ignore[override]
        there = after[:, 0] > FLAG
        return 20 * there.to(after) - 1, there


class RewardedCart(Domain[Places]):
    """The cart."""

    percept = (Field("place"), Field("speed"))
    control = (Field("push", low=-1, high=1),)
    target_return = 8.0
    models = CartModels

    def draw(self, kind: str, count: int, generator: Generator) -> Places:
        return Places(0.4 * torch.rand(count, generator=generator) - 0.2)

    def world(self, scenarios: Places) -> Track:
        return Track(scenarios)
