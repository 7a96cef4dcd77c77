"""A cart on a rail must stop within 20 cm of the middle; wind moves it, too.

    cgtorch-train --domain examples.cart:Cart --run-dir runs/cart

A push moves the cart by the control. The domain shows the least that a domain of your own needs.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch import Domain, Field, ScenarioBatch, World


@dataclass(frozen=True)
class Carts(ScenarioBatch):
    """The positions of B carts, and the wind there."""

    place: Tensor  # (B,) m from the middle
    wind: Tensor  # (B,) m that a cart is moved by during a push


class Rail(World):
    """A state (n, 2) is position and wind; both are perceived."""

    control_size = 1

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return torch.stack([self.scenarios.place, self.scenarios.wind], 1)[scenario]

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`."""
        place, wind = state.unbind(1)
        return torch.stack([(place + control[:, 0].clamp(-1, 1) + wind).clamp(-3, 3), wind], 1)

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`."""
        return state[:, 0].abs() < 0.2


class Cart(Domain[Carts]):
    """Pushes that stop a cart in the middle of its rail."""

    percept = (Field("place", "m"), Field("wind", "m"))
    control = (Field("push", "m", -1, 1),)

    def draw(self, kind: str, count: int, generator: Generator) -> Carts:
        """See `Domain.draw`."""
        both = 2 * torch.rand(count, 2, generator=generator) - 1
        return Carts(2 * both[:, 0], both[:, 1] / 4)

    def world(self, scenarios: Carts) -> Rail:
        """See `Domain.world`."""
        return Rail(scenarios)
