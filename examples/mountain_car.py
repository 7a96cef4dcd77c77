"""Gymnasium's MountainCarContinuous-v0, in a Γ learned from random pushes.

    cgtorch-train --domain examples.mountain_car:MountainCar --run-dir runs/car

A car in a valley must swing itself up to a flag by forces that are held for ten steps. They cost
what Gymnasium subtracts from the 100 points of the flag, and 90 points solve a start, as there.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from cgtorch import Domain, Field, Models, ScenarioBatch, World
from cgtorch.domains.exploration import Exploration, random_controls
from cgtorch.ground.environment import Dataset, start_lanes

HELD, STEPS, PUSHES = 10, 999, 12  # steps of a push and an episode, pushes of an exploring car
POWER, GRAVITY, FASTEST = 0.0015, 0.0025, 0.07
LEFT, FLAG, SOLVED = -1.2, 0.45, 90.0
STARTS = {"valley": (-0.6, -0.4), "anywhere": (-1.1, 0.4)}  # Gymnasium's own, and almost all


@dataclass(frozen=True)
class Starts(ScenarioBatch):
    """The initial positions of the car."""

    position: Tensor  # (B,)


class Valley(World):
    """A state (n, 4) is position, velocity, steps, and the points that pushing has cost."""

    control_size = 1

    def first_state(self, scenario: Tensor) -> Tensor:
        """See `World.first_state`."""
        return torch.nn.functional.pad(self.scenarios.position[scenario, None].double(), (0, 3))

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        """See `World.next_state`; these are Gymnasium's equations, for many cars at once."""
        position, velocity, steps, spent = state.unbind(1)
        force = control[:, 0].double().clamp(-1, 1)
        for _ in range(HELD):
            rolls = (position < FLAG) & (steps < STEPS)
            pushed = velocity + force * POWER - GRAVITY * (3 * position).cos()
            faster = pushed.clamp(-FASTEST, FASTEST)
            further = (position + faster).clamp(LEFT, 0.6)
            faster = torch.where((further == LEFT) & (faster < 0), 0.0, faster)
            position = torch.where(rolls, further, position)
            velocity = torch.where(rolls, faster, velocity)
            steps, spent = steps + rolls, spent + 0.1 * force.square() * rolls
        return torch.stack([position, velocity, steps, spent], 1)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`; speed is the distance that the car rolls during a push."""
        position, velocity, _, spent = state.unbind(1)
        return torch.stack([position, HELD * velocity, spent / 100], 1)

    def succeeded(self, state: Tensor) -> Tensor:
        """See `World.succeeded`."""
        return (state[:, 0] >= FLAG) & (100 - state[:, 3] >= SOLVED)


class CarModels(Models["MountainCar"]):
    """Errors of Γ add up in a swing, so it wants many pushes."""

    def explore(self, about: Exploration) -> Dataset:
        """See `Models.explore`; half of the pushes are the way the car rolls."""
        cars, chance, rows = about.most // PUSHES, about.generator, list[tuple[Tensor, ...]]()
        world = about.worlds(about.kind, cars)
        lanes = start_lanes(world, torch.arange(cars), 0, 0)
        for _ in range(PUSHES):
            force = random_controls(self.domain.control, cars, chance)
            onwards = lanes.percept[:, 1:2].sign() * force.abs()
            force = torch.where(torch.rand(cars, 1, generator=chance) < 0.5, onwards, force)
            seen, (lanes, _) = lanes.percept, world.step(lanes, force)
            _, reached = world.success(lanes)
            rows.append((seen, force, lanes.percept, lanes.percept, reached > 0.5))
        return Dataset(*(torch.cat(part) for part in zip(*rows, strict=True)))


class MountainCar(Domain[Starts]):
    """The valley, in two stages: Gymnasium's own starts, then starts anywhere."""

    percept = (Field("position"), Field("speed"), Field("spent", low=0))
    control = (Field("force", low=-1, high=1),)
    kinds = ("anywhere", "valley")
    stages: Mapping[str, str] = {"S0": "valley", "S1": "anywhere"}
    models = CarModels

    def draw(self, kind: str, count: int, generator: Generator) -> Starts:
        """See `Domain.draw`."""
        low, high = STARTS[kind]
        return Starts(low + (high - low) * torch.rand(count, generator=generator))

    def world(self, scenarios: Starts) -> Valley:
        """See `Domain.world`."""
        return Valley(scenarios)
