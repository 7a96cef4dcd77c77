"""The double pole against a plain simulation of one state, and what is known about it."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from standard import double_pole
from standard.double_pole import (
    CHALLENGES,
    DEGREE,
    DoublePole,
    DoublePoleNoVelocities,
    GeneralisationWorld,
    LongWorld,
)
from standard.task import OVER, RETURN, STEPS, Starts
from torch import Tensor

from cgtorch.ground.environment import Lanes, start_lanes

GAINS = torch.tensor([-0.07, -5.2, 4.7, -0.15, -1.4, 0.46], dtype=torch.float64)
"""A linear controller of both poles: a solution of Riccati's equation, rounded."""


def begun(world: Any, count: int) -> Lanes:
    return start_lanes(world, torch.arange(count), 0, 0)


def steady(lanes: Lanes) -> Tensor:
    return (lanes.state[:, :6] @ GAINS)[:, None].float()


def plain_rates(state: list[float], force: float) -> list[float]:
    """Wieland's equations, written as in the papers, for x, θ1, θ2 and their velocities."""
    _, *angles, v, w1, w2 = state
    total, mass = 0.0, 1.0
    for theta, w, m, half in ((angles[0], w1, 0.1, 0.5), (angles[1], w2, 0.01, 0.05)):
        hinge = 2e-6 * w / (m * half)
        total += m * half * w**2 * math.sin(theta)
        total += 0.75 * m * math.cos(theta) * (hinge - 9.8 * math.sin(theta))
        mass += m * (1 - 0.75 * math.cos(theta) ** 2)
    friction = 0.0005 * (0 if v == 0 else math.copysign(1, v))
    a = (force - friction + total) / mass
    turned = [
        -0.75 / half * (a * math.cos(t) - 9.8 * math.sin(t) + 2e-6 * w / (m * half))
        for t, w, m, half in ((angles[0], w1, 0.1, 0.5), (angles[1], w2, 0.01, 0.05))
    ]
    return [v, w1, w2, a, *turned]


def plain_action(state: list[float], force: float) -> list[float]:
    for _ in range(2):
        y = np.array(state)
        k1 = np.array(plain_rates(list(y), force))
        k2 = np.array(plain_rates(list(y + 0.005 * k1), force))
        k3 = np.array(plain_rates(list(y + 0.005 * k2), force))
        k4 = np.array(plain_rates(list(y + 0.01 * k3), force))
        state = list(y + 0.01 / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return state


def inside(state: list[float]) -> bool:
    return abs(state[0]) <= 2.4 and max(abs(state[1]), abs(state[2])) <= 36 * DEGREE


def test_episodes_are_those_of_a_plain_simulation() -> None:
    lanes = begun(world := GeneralisationWorld(), 625)
    plain = lanes.state[:, :6].tolist()
    generator = torch.Generator().manual_seed(3)
    few = range(0, 625, 25)
    for _ in range(40):
        control = steady(lanes) + 0.6 * torch.randn(625, 1, generator=generator)
        before = lanes.state[:, OVER]
        lanes, _ = world.step(lanes, control)
        for i in few:
            if not before[i]:
                plain[i] = plain_action(plain[i], 10 * float(control[i, 0].clamp(-1, 1)))
                assert lanes.state[i, :6].tolist() == pytest.approx(plain[i], abs=1e-9)
                assert bool(lanes.state[i, OVER]) != inside(plain[i])
    assert 0 < lanes.state[::25, OVER].sum() < len(few)


def test_floats_and_arrays_give_the_same() -> None:
    numbers = np.random.default_rng(0)
    state = numbers.normal(size=(100, 6)) * [1, 0.3, 0.3, 1, 2, 3]
    force = numbers.uniform(-10, 10, 100)
    together = double_pole.moved(state, force)
    for i in range(0, 98, 3):
        some = slice(i, i + 3)
        assert (together[some] == double_pole.moved(state[some], force[some])).all()
    assert double_pole.moved(state[:0], force[:0]).shape == (0, 6)


@pytest.mark.parametrize("push", [-1.0, 0.0, 1.0])
def test_poles_fall_unless_they_are_held(push: float) -> None:
    lanes = begun(world := DoublePole(Starts(torch.zeros(1).long())), 1)
    assert lanes.state[0, :6].tolist() == [0, 4.5 * DEGREE, 0, 0, 0, 0]
    for _ in range(50):
        lanes, _ = world.step(lanes, torch.full((1, 1), push))
    assert world.over(lanes).all()
    assert world.returns(lanes) == lanes.state[:, STEPS] - 1
    assert not world.success(lanes)[1].any()


def test_a_linear_controller_balances_from_most_starts() -> None:
    lanes = begun(world := GeneralisationWorld(), 625)
    assert len(lanes.state.unique(dim=0)) == 625
    corner = [-0.9 * 2.16, -0.9 * 3.6 * DEGREE, 0, -0.9 * 1.35, -0.9 * 8.6 * DEGREE, 0]
    assert lanes.state[0, :6].tolist() == pytest.approx(corner)
    assert lanes.state[312, :6].abs().max() < 1e-12
    for _ in range(1000):
        lanes, _ = world.step(lanes, steady(lanes))
    balanced = world.returns(lanes) == 1000
    assert balanced.sum() >= CHALLENGES[1].enough
    assert torch.equal(world.success(lanes)[1] > 0, balanced)
    assert world.over(lanes).all()


def test_the_standard_start_is_balanced_for_long() -> None:
    for world in (LongWorld(), DoublePole(Starts(torch.zeros(1).long()))):
        lanes = begun(world, 1)
        for _ in range(2000):
            lanes, _ = world.step(lanes, steady(lanes))
        assert not world.over(lanes).any()
        assert world.returns(lanes) == 2000
        assert world.most_steps == 100_000


@pytest.mark.parametrize("held", [0, 99, 150, 1000])
def test_the_damping_fitness_is_gruaus(held: int) -> None:
    """A controller that lets go after so many steps."""
    lanes = begun(world := DoublePoleNoVelocities(Starts(torch.arange(2))), 2)
    shaking: list[float] = []
    for step in range(1000):
        assert world.over(lanes).any() or (world.returns(lanes) == 0).all()
        lanes, _ = world.step(lanes, steady(lanes) if step < held else torch.ones(2, 1))
        x, long, short, v, spin, _ = lanes.state[0, :6].abs().tolist()
        if not inside([x, long, short]):
            break
        shaking.append(x + v + long + spin)
    assert world.over(lanes).all()
    expected = 0.1 * len(shaking) / 1000
    expected += 0.9 * 0.75 / sum(shaking[-100:]) if len(shaking) >= 100 else 0
    assert lanes.state[:, RETURN].tolist() == pytest.approx([expected] * 2, rel=1e-9)
    assert (len(shaking) >= 100) == (held >= 99)
    assert world.percept_size == 3
