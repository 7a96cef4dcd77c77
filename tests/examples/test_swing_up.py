"""The cart-pole swing-up agrees with laws of mechanics, and with the published cost."""

import sys
from math import cos, exp, pi, sin
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from examples import swing_up
from examples.swing_up import CART, FORCE, GRAVITY, LENGTH, NOISE, POLE, STEPS, SwingUp

State = NDArray[np.float64]


def drawn(seed: int) -> State:
    return np.random.default_rng(seed).uniform(-1, 1, 4) * [1, 2, 6, pi]


def energy(state: State) -> float:
    """The kinetic and potential energy (J) of a cart and a thin rod that hangs from it."""
    _, speed, turning, angle = state
    middle = speed + LENGTH / 2 * turning * cos(angle), LENGTH / 2 * turning * sin(angle)
    spin = POLE * LENGTH**2 / 12 * turning**2
    moving = CART * speed**2 + POLE * (middle[0] ** 2 + middle[1] ** 2) + spin
    return moving / 2 - POLE * GRAVITY * LENGTH / 2 * cos(angle)


def momentum(state: State) -> float:
    """The momentum (kg m/s) along the ground."""
    _, speed, turning, angle = state
    return (CART + POLE) * speed + POLE * LENGTH / 2 * turning * cos(angle)


@pytest.mark.parametrize("seed", range(5))
def test_energy_and_momentum_stay_without_friction_and_force(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(swing_up, "FRICTION", 0.0)
    state = first = drawn(seed)
    for _ in range(10):
        state = swing_up.moved(state, 0.0)
    assert energy(state) == pytest.approx(energy(first), abs=1e-3)
    assert momentum(state) == pytest.approx(momentum(first), abs=1e-3)
    assert abs(state - first).max() > 0.3


@pytest.mark.parametrize("seed", range(5))
def test_a_step_is_what_a_plain_slow_integration_of_the_equations_of_motion_gives(
    seed: int,
) -> None:
    """Lagrange's two equations are solved for the accelerations as a linear system."""
    force = FORCE * (-1) ** seed
    state = drawn(seed)
    x, speed, turning, angle = state
    parts = 20_000
    for _ in range(parts):
        lever = POLE * LENGTH / 2
        masses = [
            [CART + POLE, lever * cos(angle)],
            [lever * cos(angle), POLE * LENGTH**2 / 3],
        ]
        pulls = [
            force - swing_up.FRICTION * speed + lever * turning**2 * sin(angle),
            -lever * GRAVITY * sin(angle),
        ]
        faster, turned = np.linalg.solve(masses, pulls)
        time = swing_up.SECONDS / parts
        speed, turning = speed + time * faster, turning + time * turned
        x, angle = x + time * speed, angle + time * turning
    assert swing_up.moved(state, force) == pytest.approx([x, speed, turning, angle], abs=2e-3)


def test_a_step_gives_one_less_the_published_cost() -> None:
    """Of the tip's distance d to its goal it is 1 - exp(-d²/2 · 0.25²)."""
    after = torch.tensor([[0.3, 0.0, 0.0, sin(2.5), cos(2.5)], [0.0, 1.0, 0.0, 0.0, -1.0]])
    tip = 0.3 + 0.5 * sin(2.5), -0.5 * cos(2.5)
    square = tip[0] ** 2 + (0.5 - tip[1]) ** 2
    found, ended = swing_up.gained(after, after[:, :1], after)
    assert found.tolist() == pytest.approx([exp(-square / (2 * 0.25**2)), 1])
    assert not ended.any()
    assert swing_up.near_goal(0.3, sin(2.5), cos(2.5)) == pytest.approx(float(found[0]))


def episode(angle: float, control: float) -> list[tuple[State, float, bool, bool]]:
    env = gymnasium.make("examples.swing_up:CartPoleSwingUp-v0")
    env.reset(seed=3)
    own = env.unwrapped
    assert isinstance(own, SwingUp)
    own.state = np.array([0.0, 0.0, 0.0, angle])
    steps, over = [], False
    while not over:
        seen, reward, ended, over, info = env.step(np.array([control]))
        assert not ended
        steps.append((seen, float(reward), over, info["is_success"]))
    return steps


def test_an_episode_has_forty_steps_and_tells_success_at_its_end() -> None:
    upright, hanging = episode(pi, 0.0), episode(0.0, 0.0)
    assert len(upright) == len(hanging) == STEPS == 40
    assert [success for *_, success in upright] == [False] * 39 + [True]
    assert upright[-1][1] == pytest.approx(1)
    assert not any(success for *_, success in hanging)
    assert hanging[-1][1] == pytest.approx(exp(-1 / (2 * 0.25**2)), rel=1e-6)


def test_observations_have_noise_and_controls_beyond_their_bounds_do_not_count() -> None:
    own = SwingUp()
    own.reset(seed=1)
    seen = np.array([own.step(np.array([5.0]))[0] for _ in range(3)])
    other = SwingUp()
    other.reset(seed=1)
    again = np.array([other.step(np.array([1.0]))[0] for _ in range(3)])
    assert (seen == again).all()
    assert 0 < abs(seen[-1, 0] - own.state[0]) < 6 * NOISE
    assert seen[:, 3] ** 2 + seen[:, 4] ** 2 == pytest.approx(1)
