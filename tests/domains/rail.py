"""A small domain: a cart on a rail, blown by the wind, whose lamp turns and whose gear shifts."""

from dataclasses import dataclass
from typing import Any

import torch
from support import seeded
from torch import Generator, Tensor

from cgtorch import Domain, DomainSettings, Field, ScenarioBatch, World, option
from cgtorch.domains.exploration import random_controls
from cgtorch.domains.models import Models
from cgtorch.ground.environment import Dataset, start_lanes

END = 3.0  # m from the middle of the rail to either end
MOVES = 12  # pushes of each cart that is driven
PLACE, WIND, LAMP, GEAR = range(4)


@dataclass(frozen=True)
class Carts(ScenarioBatch):
    """Where carts begin."""

    place: Tensor  # (B,) m from the middle
    wind: Tensor  # (B,) m by which a push goes further
    lamp: Tensor  # (B,) rad
    gear: Tensor  # (B,) 0, 1 or 2; a push goes as far as this times half its length


class Rail(World):
    """A state is place, wind, lamp and gear, and all are seen."""

    control_size = 3

    def first_state(self, scenario: Tensor) -> Tensor:
        s = self.scenarios
        return torch.stack([s.place, s.wind, s.lamp, s.gear], 1)[scenario]

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        place, wind, lamp, gear = state.unbind(1)
        push, turn, shift = control.unbind(1)
        place = place + push.clamp(-1, 1) * gear / 2 + wind
        lamp = torch.remainder(lamp + turn + torch.pi, 2 * torch.pi) - torch.pi
        gear = (gear + shift.round()).clamp(0, 2)
        return torch.stack([place.clamp(-END, END), wind, lamp, gear], 1)

    def succeeded(self, state: Tensor) -> Tensor:
        return (state[:, PLACE].abs() < 0.5) & (state[:, LAMP].cos() > -0.5)


@dataclass(frozen=True)
class RailSettings(DomainSettings):
    """How strong the wind may be, and more that is of no use."""

    wind: float = option(0.25, "Strongest wind, m.", least=0, most=2)
    carts: int = option(1, "Carts on the rail.", "there are as many")
    colour: str = option("red", "Of the carts.", choices=("red", "blue"))
    stops: tuple[str, ...] = option((), "Names of the stops.")


class Cart(Domain[Carts]):
    """The cart is to stop in the middle, its lamp not turned back."""

    settings: RailSettings
    settings_type = RailSettings
    percept = (
        Field("place", "m", -END, END),
        Field("wind", "m"),
        Field("lamp", "rad", kind="angle"),
        Field("gear", low=0, high=2, kind="discrete"),
    )
    control = (
        Field("push", "m", -1, 1),
        Field("turn", "rad", -torch.pi, torch.pi, "angle"),
        Field("shift", low=-1, high=1, kind="discrete"),
    )

    def draw(self, kind: str, count: int, generator: Generator) -> Carts:
        drawn = torch.rand(count, 4, generator=generator)
        place, wind, lamp = (2 * drawn[:, :3] - 1).unbind(1)
        gear = (3 * drawn[:, 3]).floor()
        return Carts(2 * place, self.settings.wind * wind, torch.pi * lamp, gear)

    def world(self, scenarios: Carts) -> Rail:
        return Rail(scenarios)


def cart_with(**parts: Any) -> Cart:
    """A cart of which some attributes or methods are others."""
    return type("Own", (Cart,), parts)()


def rail_with(**parts: Any) -> Cart:
    """A cart in whose world some methods are others."""
    kind = type("Track", (Rail,), parts)
    return cart_with(world=lambda self, scenarios: kind(scenarios))


class SeeingModels(Models[Cart]):
    """What matters: how far a push leads, and how far the middle is."""

    def transition_features(self, percept: Tensor, control: Tensor) -> Tensor:
        return percept[..., GEAR:] * control[..., :1].clamp(-1, 1)

    def success_features(self, percept: Tensor) -> Tensor:
        return percept[..., :1].abs()


class SeeingCart(Cart):
    """One that says what matters."""

    models = SeeingModels


def driven(transitions: int, tests: int, seed: int) -> Dataset:
    """What carts meet that are pushed at random; three of ten tests have the rarer result."""
    cart, generator, count = Cart(), seeded(seed), 16 + max(transitions, tests) // MOVES
    world = cart.world(cart.draw("any", count, generator))
    lanes, rows, seen = start_lanes(world, torch.arange(count), 0, 0), [], []
    for _ in range(MOVES):
        seen.append(lanes.percept)
        control = random_controls(Cart.control, count, generator)
        after, _ = world.step(lanes, control)
        rows.append((lanes.percept, control, after.percept))
        lanes = after
    p, u, q = (torch.cat(part) for part in zip(*rows, strict=True))
    pick, at = torch.randperm(len(p), generator=generator)[:transitions], torch.cat(seen)
    at = at[torch.randperm(len(at), generator=generator)]
    succeeded = world.succeeded(at)
    rarer, rest = sorted((at[succeeded], at[~succeeded]), key=len)
    tested = torch.cat([rarer[: int(0.3 * tests)], rest])[:tests]
    tested = tested[torch.randperm(tests, generator=generator)]
    return Dataset(p[pick], u[pick], q[pick], tested, world.succeeded(tested))
