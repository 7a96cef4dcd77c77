"""Classic control tasks of Gymnasium, for many episodes at once and with Gymnasium's own numbers.

Controls are preferences among actions, or numbers from -1 to 1 for all that the motor can do.
Columns of states are copied into rows first, as what a sine is in its last digit may depend on how
numbers lie in memory, and nothing may depend on how many lanes there are.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.ground.counter_rng import uniform
from standard.task import TaskWorld

Array = NDArray[np.float64]
PI, TURN = math.pi, 2 * math.pi


def drawn(seed: Tensor, name: str, size: int) -> Tensor:
    """(n, size) uniform numbers in [-1, 1) of starts with these seeds (n,), in float64."""
    return 2 * uniform(seed, name, torch.zeros_like(seed), size).double() - 1


class CartPole(TaskWorld):
    """CartPole-v1: position, velocity, angle and angular velocity; every step counts 1.

    The threshold is Gymnasium's own.
    """

    control_size, most_steps, solved_return = 2, 500, 475.0
    scale = 1 / torch.tensor([2.4, 2.0, 0.21, 2.0], dtype=torch.float64)
    limits = torch.tensor([2.4, 12 * TURN / 360], dtype=torch.float64)

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`."""
        return 0.05 * drawn(seed, "cartpole", 4)

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        return self.pushed(physics, 20 * (control[:, 1] > control[:, 0]).double() - 10)

    def pushed(self, physics: Tensor, force: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`advance` of the cart (n, 4) by forces (n,) in N."""
        _, speed, angle, spin = physics.T.contiguous().unbind()
        sine, cosine = angle.sin(), angle.cos()
        pushed = (force + 0.05 * spin * spin * sine) / 1.1
        turning = (9.8 * sine - cosine * pushed) / (2 / 3 - (0.05 / 1.1) * cosine * cosine)
        pushed = pushed - (0.05 / 1.1) * turning * cosine
        after = physics + 0.02 * torch.stack([speed, pushed, spin, turning], 1)
        fallen = (after[:, ::2].abs() > self.limits).any(1)
        return after, torch.ones_like(speed), fallen

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :4] * self.scale


class CartPoleNoVelocities(CartPole):
    """CartPole-v1 of which only position and angle are seen."""

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :4:2] * self.scale[::2]


class NarrowCartPole(CartPoleNoVelocities):
    """Cart and pole on which tangled program graphs with memory were evolved.

    Only position and angle are seen, the cart may go 1 m to each side, and of the three actions the
    middle one repeats the last force, which is to the left at first. All of this is as in
    src/cpp/environments/classicRL/CartPole.h of github.com/tanya-jp/SharedMemTPG. It has no
    threshold; this one is Gymnasium's.
    """

    control_size = 3
    limits = torch.tensor([1.0, 12 * TURN / 360], dtype=torch.float64)
    scale = 1 / torch.tensor([1.0, 1.0, 0.2094384, 1.0], dtype=torch.float64)

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`; the last column is the last force."""
        return torch.nn.functional.pad(super().begin(seed), (0, 1), value=-10.0)

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        chosen = control.argmax(1)
        force = torch.where(chosen == 1, physics[:, 4], 10.0 * (chosen - 1))
        after, reward, fallen = self.pushed(physics[:, :4], force)
        return torch.cat([after, force[:, None]], 1), reward, fallen


class Acrobot(TaskWorld):
    """Acrobot-v1: two angles and their velocities; every step costs 1 until the tip is high enough.

    The threshold is Gymnasium's own.
    """

    control_size, most_steps, solved_return = 3, 500, -100.0
    fastest = torch.tensor([4 * PI, 9 * PI], dtype=torch.float64)
    period = 0.2

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`; Gymnasium draws in float64 and rounds to float32."""
        return (0.1 * drawn(seed, "acrobot", 4)).float()

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`; one step of the classic method of Runge and Kutta."""
        start, torque = physics.T.contiguous().numpy(), control.argmax(1).numpy() - 1.0
        half = self.period / 2
        a = acrobot_rates(start, torque)
        b = acrobot_rates(start + half * a, torque)
        c = acrobot_rates(start + half * b, torque)
        d = acrobot_rates(start + self.period * c, torque)
        after = start + self.period / 6 * (a + 2 * (b + c) + d)
        after[:2] -= TURN * np.rint(after[:2] / TURN)
        limits = self.fastest.numpy()[:, None]
        after[2:] = after[2:].clip(-limits, limits)
        high = np.cos(after[0]) + np.cos(after[0] + after[1]) < -1
        return torch.from_numpy(after.T), torch.from_numpy(high - 1.0), torch.from_numpy(high)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        angle = state[:, :2].contiguous()
        spin = state[:, 2:4] / self.fastest
        both = torch.stack([angle.cos(), angle.sin()], 2).flatten(1)
        return torch.cat([both, spin], 1)


class AcrobotNoVelocities(Acrobot):
    """Acrobot-v1 of which only the cosines and sines of the angles are seen."""

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return super().perceived(state, scenario)[:, :4]


def acrobot_rates(state: Array, torque: Array) -> Array:
    """Time derivatives (4, n) of states (4, n), as in Sutton and Barto's book.

    Links have length and mass 1, their centres of mass are in their middles, and their moments of
    inertia are 1; gravity is 9.8. What is constant is multiplied out. Arrays of NumPy cost a third
    of what tensors do where lanes are few.
    """
    first, second, speed, turn = state
    sine, cosine = np.sin(second), np.cos(second)
    own, both = cosine + 3.5, 0.5 * cosine + 1.25
    low = 4.9 * np.sin(first + second)
    whole = low + 14.7 * np.sin(first) - sine * turn * (0.5 * turn + speed)
    ratio = both / own
    pulled = torque + ratio * whole - 0.5 * speed * speed * sine - low
    bent = pulled / (1.25 - ratio * both)
    return np.stack([speed, turn, -(both * bent + whole) / own, bent])


class MountainCarContinuous(TaskWorld):
    """MountainCarContinuous-v0: position and velocity; pushing costs, and the flag brings 100.

    Gymnasium rounds this state to float32 in each step, and so does this world: the numbers of its
    float64 state are float32's. The threshold is Gymnasium's own.
    """

    most_steps, solved_return = 999, 90.0
    centre = torch.tensor([-0.3, 0.0], dtype=torch.float64)
    scale = 1 / torch.tensor([0.9, 0.07], dtype=torch.float64)
    wall, flag = torch.tensor([-1.2, 0.45]).unbind()

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`."""
        position = (0.1 * drawn(seed, "mountain_car_continuous", 1) - 0.5).float()
        return torch.nn.functional.pad(position, (0, 1))

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        position, velocity = physics.T.float().contiguous().unbind()
        force = control[:, 0].clamp(-1, 1)
        slope = 0.0025 * (3 * position).double().cos()
        velocity = (velocity + (0.0015 * force.float() - slope.float())).clamp(-0.07, 0.07)
        position = (position + velocity).clamp(-1.2, 0.6)
        velocity = torch.where(position == self.wall, velocity.clamp_min(0), velocity)
        there = position >= self.flag
        after = torch.stack([position, velocity], 1).double()
        return after, 100 * there.double() - 0.1 * force * force, there

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return (state[:, :2] - self.centre) * self.scale


class Pendulum(TaskWorld):
    """Pendulum-v1: angle and angular velocity; a control of 1 is the greatest torque, 2 N m.

    Gymnasium names no threshold. -200 asks for swinging up and holding from nearly all starts, as
    good controllers have a mean return of about -150.
    """

    most_steps, solved_return = 200, -200.0
    ranges = torch.tensor([PI, 1.0], dtype=torch.float64)

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`."""
        return self.ranges * drawn(seed, "pendulum", 2)

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        angle, spin = physics.T.contiguous().unbind()
        torque = 2 * control[:, 0].clamp(-1, 1)
        leaning = (angle + PI) % TURN - PI
        cost = leaning * leaning + 0.1 * spin * spin + 0.001 * torque * torque
        spin = (spin + 0.75 * angle.sin() + 0.15 * torque).clamp(-8, 8)
        after = torch.stack([angle + 0.05 * spin, spin], 1)
        return after, -cost, torch.zeros_like(cost, dtype=torch.bool)

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        angle, spin = state[:, :2].T.contiguous().unbind()
        return torch.stack([angle.cos(), angle.sin(), spin / 8], 1)


class PendulumNoVelocity(Pendulum):
    """Pendulum-v1 of which only the cosine and the sine of the angle are seen."""

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return super().perceived(state, scenario)[:, :2]
