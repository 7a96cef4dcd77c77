"""Balancing two poles on one cart, the benchmark that neuroevolution has been compared in longest.

Equations of motion: Wieland, "Evolving neural network controllers for unstable systems", IJCNN
1991. Numbers and rules: Gomez, Schmidhuber & Miikkulainen, "Accelerated neural evolution through
cooperatively coevolved synapses", JMLR 9, 2008, who took the damping fitness and the test of
generalisation from Gruau, Whitley & Pyeatt, "A comparison between cellular encoding and direct
encoding for genetic neural networks", 1996.

Published programs differ: Stanley's NEAT leaves out the friction of the cart and starts the long
pole at 0.07 rad, which is 4.0 degrees, others at 1 degree. Here the friction is in, and the pole
starts at 4.5 degrees.

The physics is written for numbers of either kind: floats, of which a step costs the least where
lanes are few, or arrays of all lanes. Both give the same, to the last digit.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from standard.task import Starts, TaskWorld

Array = NDArray[np.float64]
DEGREE = math.pi / 180
GRAVITY, CART = 9.8, 1.0  # m/s², kg
LONG, SHORT = (0.1, 0.5), (0.01, 0.05)  # kg, and m of half a pole
TRACK_FRICTION, HINGE_FRICTION = 0.0005, 0.000002
FORCE = 10.0  # N, at a control of 1
TIME, TIMES = 0.01, 2  # s, of a step of the integration, and how many there are for each action
TRACK, STEEPEST = 2.4, 36 * DEGREE  # beyond which a pole counts as fallen
START = 4.5 * DEGREE  # of the long pole; all else is 0
FEW = 5  # lanes up to which floats are faster than arrays

GRID = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The places in its range of each of four numbers of the initial state, in the test of
generalisation."""
RANGES = (2.16, 1.35, 3.6 * DEGREE, 8.6 * DEGREE)
"""The ranges (±) of position and velocity of the cart, angle and angular velocity of the long
pole."""
LONG_RUN, SHORT_RUN = 100_000, 1000
ENOUGH = 200  # of the 625 starts of the grid
SHAKING = 100  # steps of which the damping fitness adds up how much there is


class DoublePole(TaskWorld):
    """Position and the two angles, then their velocities, in m and rad; all six are seen.

    The return is the number of steps balanced, and the task is solved by 100,000 (Gomez et al.).
    All starts are the same.
    """

    most_steps, solved_return = LONG_RUN, float(LONG_RUN)
    limits = np.array([TRACK, STEEPEST, STEEPEST])
    scale = 1 / torch.tensor([TRACK, STEEPEST, STEEPEST, 10.0, 5.0, 5.0], dtype=torch.float64)

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`."""
        start = torch.tensor([0.0, START, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        return start.repeat(len(seed), 1)

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        after, fallen = self.pushed(physics, control)
        return torch.from_numpy(after), torch.from_numpy(1.0 - fallen), torch.from_numpy(fallen)

    def pushed(self, physics: Tensor, control: Tensor) -> tuple[Array, NDArray[np.bool_]]:
        """States (n, 6) after controls (n, 1), and (n,) whether a pole has fallen."""
        force = FORCE * control[:, 0].clamp(-1, 1)
        after = moved(physics[:, :6].numpy(), force.numpy())
        outside = np.abs(after[:, :3]) > self.limits
        return after, outside[:, 0] | outside[:, 1] | outside[:, 2]

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :6] * self.scale


class LongWorld(DoublePole):
    """Balancing 100,000 steps from the standard start, without being shown velocities."""

    def __init__(self, scenarios: Starts | None = None) -> None:
        """The world of its one start, or of as many as there are scenarios."""
        super().__init__(
            Starts(torch.zeros(1, dtype=torch.long)) if scenarios is None else scenarios
        )

    def perceived(self, state: Tensor, scenario: Tensor) -> Tensor:
        """See `World.perceived`."""
        return state[:, :3] * self.scale[:3]


class GeneralisationWorld(LongWorld):
    """Balancing 1,000 steps from each of the 625 starts of Gruau et al.; their seeds are 0 to 624.

    The short pole begins upright and at rest.
    """

    most_steps, solved_return = SHORT_RUN, float(SHORT_RUN)

    def __init__(self, scenarios: Starts | None = None) -> None:
        """The world of all starts, or of some."""
        super().__init__(Starts(torch.arange(len(GRID) ** 4)) if scenarios is None else scenarios)

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`; the seed's digits to base 5 are places in the grid."""
        place = torch.tensor(GRID, dtype=torch.float64)
        digits = seed[:, None] // torch.tensor([125, 25, 5, 1]) % len(GRID)
        at = (2 * place[digits] - 1) * torch.tensor(RANGES, dtype=torch.float64)
        position, velocity, angle, spin = at.unbind(1)
        none = torch.zeros_like(angle)
        return torch.stack([position, angle, none, velocity, spin, none], 1)


class DoublePoleNoVelocities(LongWorld):
    """Balancing up to 1,000 steps without being shown velocities, as calmly as possible.

    The return is Gruau's fitness, 0.1 t / 1000 + 0.9 f, of t steps balanced: f is 0 where t is
    below 100, else 0.75 over the sum, in the last 100 steps balanced, of the absolute values of the
    cart's position and velocity and of the long pole's angle and angular velocity. It is given
    when the episode is over. A state remembers these 100 numbers behind the six of `DoublePole`.

    The fitness has no threshold: a solution is what passes `CHALLENGES`. A return of 0.1 says that
    all of 1,000 steps were balanced, or nearly all and very calmly, which is when to try that.
    """

    most_steps, solved_return = SHORT_RUN, 0.1

    def begin(self, seed: Tensor) -> Tensor:
        """See `TaskWorld.begin`."""
        return torch.nn.functional.pad(super().begin(seed), (0, SHAKING))

    def advance(
        self, physics: Tensor, control: Tensor, step: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `TaskWorld.advance`."""
        after, fallen = self.pushed(physics, control)
        moving = np.abs(after)
        shaking = moving[:, 0] + moving[:, 3] + moving[:, 1] + moving[:, 4]
        about, before = physics.numpy().copy(), step.numpy()
        about[:, :6] = after
        row, slot = np.arange(len(about)), 6 + before % SHAKING
        about[row, slot] = np.where(fallen, about[row, slot], shaking)
        reward = np.zeros(len(about))
        over = np.flatnonzero(fallen | (before + 1 >= self.most_steps))
        if len(over):
            balanced = before[over] + 1 - fallen[over]
            reward[over] = calmness(balanced, about[over, 6:].sum(1))
        return torch.from_numpy(about), torch.from_numpy(reward), torch.from_numpy(fallen)


def calmness(balanced: NDArray[np.int64], shaking: Array) -> Array:
    """Gruau's fitness (n,) of so many steps balanced (n,) with so much shaking (n,) at the end."""
    calm = 0.75 / np.maximum(shaking, 1e-300)
    return 0.1 * balanced / SHORT_RUN + 0.9 * np.where(balanced < SHAKING, 0.0, calm)


@dataclass(frozen=True)
class Challenge:
    """What a policy has to pass: at least `enough` episodes of a world have returns of `least`."""

    world: type[LongWorld]
    least: float
    enough: int


CHALLENGES = (Challenge(LongWorld, LONG_RUN, 1), Challenge(GeneralisationWorld, SHORT_RUN, ENOUGH))
"""Gruau's tests, both of which a policy without velocities passes if it is a solution."""


def moved(state: Array, force: Array) -> Array:
    """States (n, 6) after an action with forces (n,)."""
    if len(state) <= FEW:
        lanes = zip(state.tolist(), force.tolist(), strict=True)
        return np.array([_action(*lane) for lane in lanes]).reshape(-1, 6)
    return np.stack(_action(np.ascontiguousarray(state.T), force), 1)


def _action(state: Iterable[Any], force: Any) -> list[Any]:
    """Six numbers after an action, by the classic method of Runge and Kutta."""
    now = list(state)
    for _ in range(TIMES):
        a = _rates(now, force)
        b = _rates([s + TIME / 2 * r for s, r in zip(now, a, strict=True)], force)
        c = _rates([s + TIME / 2 * r for s, r in zip(now, b, strict=True)], force)
        d = _rates([s + TIME * r for s, r in zip(now, c, strict=True)], force)
        now = [
            s + TIME / 6 * (k + 2 * (m + n) + r)
            for s, k, m, n, r in zip(now, a, b, c, d, strict=True)
        ]
    return now


def _rates(state: list[Any], force: Any) -> tuple[Any, ...]:
    """Time derivatives of the six numbers, by Wieland's equations."""
    _, first, second, velocity, spin, turn = state
    angles = np.array([first, second])
    sines, cosines = np.sin(angles), np.cos(angles)
    if angles.ndim == 1:
        sines, cosines = sines.tolist(), cosines.tolist()
    push, mass, lean = _pole(*LONG, sines[0], cosines[0], spin)
    jolt, weight, tilt = _pole(*SHORT, sines[1], cosines[1], turn)
    rubbed = force - TRACK_FRICTION * ((velocity > 0) * 1.0 - (velocity < 0) * 1.0)
    faster = (rubbed + push + jolt) / (CART + mass + weight)
    swung = -0.75 / LONG[1] * (faster * cosines[0] + lean)
    shaken = -0.75 / SHORT[1] * (faster * cosines[1] + tilt)
    return velocity, spin, turn, faster, swung, shaken


def _pole(mass: float, length: float, sine: Any, cosine: Any, spin: Any) -> tuple[Any, Any, Any]:
    """The force of a pole on the cart, its mass as the cart feels it, and how it is turned."""
    lean = HINGE_FRICTION / (mass * length) * spin - GRAVITY * sine
    force = mass * length * spin * spin * sine + 0.75 * mass * cosine * lean
    return force, mass * (1 - 0.75 * cosine * cosine), lean
