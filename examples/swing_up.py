"""The cart-pole swing-up of PILCO and Black-DROPS, as a Gymnasium environment.

    cgtorch-train --domain gymnasium:examples.swing_up:CartPoleSwingUp-v0 --models learned \
        --reward examples.swing_up:gained --run-dir runs/swing-up

A cart has to swing up a pole that hangs from it, and to balance it. Masses, friction, noise, the
time of a step, the first states and the cost are those of the published programs: `scenarios/
cartPole` of https://github.com/UCL-SML/pilco-matlab (Deisenroth and Rasmussen, "PILCO: a
model-based and data-efficient approach to policy search", ICML 2011), and `src/classic_control/
cartpole.cpp` of https://github.com/resibots/blackdrops (Chatzilygeroudis et al., "Black-box
data-efficient policy search for robotics", IROS 2017).
"""

from math import pi
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

CART, POLE, LENGTH = 0.5, 0.5, 0.5  # kg, kg and m
FRICTION, GRAVITY, FORCE = 0.1, 9.82, 10.0  # N s/m between cart and ground, m/s², N
SECONDS, STEPS, PARTS = 0.1, 40, 5  # of a step, steps of an episode, integrated parts of a step
SPREAD, NOISE = 0.1, 0.01  # standard deviations of first states and of what is observed
WIDTH = 0.25  # m from the goal at which a step gives 61 % of what it gives there
LAST, NEAR, UPRIGHT = 10, 0.1, pi / 18  # steps of the last second; m and rad off in a success
SOLVED = 20.0  # the return of an episode whose tip is at its goal for 2 of the 4 seconds

Numbers = NDArray[np.float64]


def derivative(state: Numbers, force: float) -> Numbers:
    """(4,) the change in a second of a state (4,): x (m), its speed, that of θ, and θ (rad).

    θ is 0 where the pole, a thin rod, hangs down. The force is in N.
    """
    _, speed, turning, angle = state
    sine, cosine = np.sin(angle), np.cos(angle)
    mass, pull = CART + POLE, force - FRICTION * speed
    swing = POLE * LENGTH * turning**2 * sine
    share = 4 * mass - 3 * POLE * cosine**2
    faster = (2 * swing + 3 * POLE * GRAVITY * sine * cosine + 4 * pull) / share
    turned = -3 * swing * cosine - 6 * mass * GRAVITY * sine - 6 * pull * cosine
    return np.array([speed, faster, turned / (LENGTH * share), turning])


def moved(state: Numbers, force: float) -> Numbers:
    """(4,) the state after a step with a constant force, by Runge and Kutta's fourth order."""
    time = SECONDS / PARTS
    for _ in range(PARTS):
        first = derivative(state, force)
        second = derivative(state + time / 2 * first, force)
        third = derivative(state + time / 2 * second, force)
        fourth = derivative(state + time * third, force)
        state = state + time / 6 * (first + 2 * second + 2 * third + fourth)
    return state


def near_goal(x: Any, sine: Any, cosine: Any) -> Any:
    """What a step gives, 1 less the published cost: 1 where the tip of the pole is at its goal.

    The goal is the place of the tip of an upright pole at x = 0. Numbers or tensors (n,).
    """
    square = (x + LENGTH * sine) ** 2 + (LENGTH + LENGTH * cosine) ** 2
    power = -square / (2 * WIDTH**2)
    return torch.exp(power) if isinstance(power, Tensor) else float(np.exp(power))


def gained(before: Tensor, action: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """Rewards (n,) of observations (n, 5) for `--reward`, as PILCO knows its cost; no step ends."""
    return near_goal(after[:, 0], after[:, 3], after[:, 4]), torch.zeros(len(after)).bool()


class SwingUp(gymnasium.Env[Numbers, Numbers]):
    """Observations (5,): x, its speed, that of θ, and the sine and cosine of θ, with noise.

    An action is the force in units of 10 N. `is_success` of the last step tells whether the cart
    was within 0.1 m of its place, and the pole within 10° of upright, all through the last second.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (5,), np.float64)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float64)

    def __init__(self) -> None:
        """The cart at rest."""
        self.state, self.steps, self.held = np.zeros(4), 0, 0

    def _observed(self) -> Numbers:
        x, speed, turning, angle = self.state + NOISE * self.np_random.standard_normal(4)
        return np.array([x, speed, turning, np.sin(angle), np.cos(angle)])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """See `gymnasium.Env.reset`: the pole hangs down, but for some noise."""
        super().reset(seed=seed)
        self.state = SPREAD * self.np_random.standard_normal(4)
        self.steps = self.held = 0
        return self._observed(), {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        force = FORCE * float(np.clip(action[0], -1, 1))
        self.state, self.steps = moved(self.state, force), self.steps + 1
        x, angle = self.state[0], self.state[3]
        off = abs((angle % (2 * pi)) - pi)
        self.held = self.held + 1 if abs(x) < NEAR and off < UPRIGHT else 0
        reward, done = near_goal(x, np.sin(angle), np.cos(angle)), self.steps >= STEPS
        success = {"is_success": done and self.held >= LAST}
        return self._observed(), reward, False, False, success


gymnasium.register(
    "CartPoleSwingUp-v0", f"{__name__}:SwingUp", max_episode_steps=STEPS, reward_threshold=SOLVED
)
