"""Branches: each scenario goes to a member that solves it."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded, world
from torch import Tensor

from cgtorch.graphs import BranchingNN
from cgtorch.ground.environment import start_lanes
from cgtorch.improvement import gating as gate
from cgtorch.improvement.gating import (
    _most_reliable,
    _unscaled,
    gradient_of,
    selected_members,
    train_gating,
)

BRANCH = BranchingNN()


def percepts(count: int, seed: int = 0) -> Tensor:
    return world(seed, count).start(torch.arange(count))[1]


@pytest.mark.parametrize("members", [2, 3, 4])
def test_sets_that_can_be_separated_are(members: int) -> None:
    seen = percepts(60)
    edges = seen[:, 5].quantile(torch.linspace(0, 1, members + 1)[1:-1])
    zone = torch.bucketize(seen[:, 5].contiguous(), edges)
    solves = torch.nn.functional.one_hot(zone, members).float()
    parameters, member = train_gating(BRANCH, seen, solves, torch.ones(60), seeded(1))
    assert parameters.shape == (members - 1, BRANCH.num_parameters)
    assert float((member == zone).float().mean()) > 0.95
    assert torch.equal(member, selected_members(BRANCH, parameters, seen))


def test_sets_are_separated_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "function", lambda name, dtype: None)
    test_sets_that_can_be_separated_are(3)


def test_members_that_solve_are_preferred_and_hopeless_scenarios_ignored() -> None:
    seen = percepts(40, 2)
    # Member 1 solves the right half and member 0 solves all that anybody does.
    left, hopeless = seen[:, 5] > 0, torch.arange(40) % 8 == 0
    solves = torch.stack([~hopeless, ~left & ~hopeless], 1).float()
    _, member = train_gating(BRANCH, seen, solves, torch.ones(40), seeded(3))
    assert solves.gather(1, member[:, None])[~hopeless].min() == 1


def test_surer_members_are_preferred() -> None:
    seen = percepts(40, 4)
    left = seen[:, 5] > 0
    sure = torch.where(left[:, None], torch.tensor([1.0, 0.34]), torch.tensor([0.34, 1.0]))
    _, member = train_gating(BRANCH, seen, sure, torch.ones(40), seeded(5))
    assert float((member == (~left).long()).float().mean()) > 0.9


@pytest.mark.parametrize("important", [0, 1])
def test_weight_decides_where_not_all_can_be_served(important: int) -> None:
    seen = percepts(1, 6).repeat(20, 1)  # twenty scenarios that look the same
    solves = torch.zeros(20, 2)
    solves[:4, important], solves[4:, 1 - important] = 1, 1
    weight = torch.ones(20)
    _, member = train_gating(BRANCH, seen, solves, weight, seeded(7))
    assert set(member.tolist()) == {1 - important}
    weight[:4] = 20
    _, member = train_gating(BRANCH, seen, solves, weight, seeded(7))
    assert set(member.tolist()) == {important}


def test_one_member_needs_no_branch() -> None:
    parameters, member = train_gating(
        BRANCH, percepts(5), torch.ones(5, 1), torch.ones(5), seeded(0)
    )
    assert parameters.shape == (0, BRANCH.num_parameters)
    assert member.tolist() == [0] * 5


def test_the_generator_decides() -> None:
    seen = percepts(20)
    solves = torch.rand(20, 3, generator=seeded(0))
    first, again, other = (
        train_gating(BRANCH, seen, solves, torch.ones(20), seeded(s))[0] for s in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@given(st.integers(0, 2**31), st.integers(1, 4))
def test_networks_are_the_same_in_metres(seed: int, count: int) -> None:
    generator = seeded(seed)
    scaled = torch.randn(count, BRANCH.num_parameters, generator=generator, dtype=torch.float64)
    centre = torch.randn(7, generator=generator, dtype=torch.float64)
    scale = 0.1 + torch.rand(7, generator=generator, dtype=torch.float64)
    x = torch.randn(9, 7, generator=generator, dtype=torch.float64)
    metres = _unscaled(BRANCH, scaled, centre, scale)
    everywhere = world(0, 9)
    lanes = start_lanes(everywhere, torch.arange(9), 0, 0)
    for row in range(count):
        one = replace(lanes, percept=(x - centre) / scale)
        other = replace(lanes, percept=x)
        weights = (scaled[row].expand(9, -1), metres[row].expand(9, -1))
        assert torch.allclose(
            BRANCH.network(one, weights[0]), BRANCH.network(other, weights[1]), atol=1e-10
        )


@given(st.integers(0, 2**31), st.integers(1, 4), st.sampled_from([0.0, 1.0, 1e4]))
@settings(max_examples=30)
def test_selected_members_follow_the_branches_in_turn(seed: int, count: int, size: float) -> None:
    """Also where the sigmoid of large outputs, or of zeros, cannot tell the two apart."""
    seen, everywhere = percepts(20), world(0, 20)
    parameters = size * torch.randn(count, BRANCH.num_parameters, generator=seeded(seed))
    lanes = start_lanes(everywhere, torch.arange(20), 0, 0)
    expected = [count] * 20
    for i in reversed(range(count)):
        _, outcome = BRANCH(lanes, parameters[i].expand(20, -1), everywhere)
        expected = [i if o == 0 else e for o, e in zip(outcome.tolist(), expected, strict=True)]
    assert selected_members(BRANCH, parameters, seen).tolist() == expected


def test_the_descent_is_that_of_the_optimiser() -> None:
    """Step for step what `torch.optim.Adam` comes to, with its cosine schedule."""
    x, solves = percepts(30, 8), torch.rand(30, 3, generator=seeded(9))
    weight, blur = torch.ones(30), torch.full((7,), gate.BLUR)
    gradient = gradient_of(BRANCH, solves, weight, gate.RESTARTS)
    found = gate._descend(BRANCH, x, solves, weight, blur, seeded(10))
    generator = seeded(10)
    shape = (gate.RESTARTS, 2, BRANCH.num_parameters)
    parameters = torch.randn(shape, generator=generator)
    optimiser = torch.optim.Adam([parameters], lr=gate.RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, gate.EPOCHS)
    for _ in range(gate.EPOCHS):
        noisy = x + torch.randn(x.shape, generator=generator) * blur
        parameters.grad = gradient(parameters, noisy)
        optimiser.step()
        schedule.step()
    assert torch.equal(found, parameters)


def test_of_equally_right_tries_the_one_with_the_widest_margin_is_chosen() -> None:
    """Three borders at one number of the percept, two of them between the two groups."""
    seen = torch.zeros(40, 7)
    seen[:20, 0], seen[20:, 0] = -1.0, 1.0
    solves = torch.zeros(40, 2)
    solves[:20, 0] = solves[20:, 1] = 1

    def border(at: float) -> Tensor:
        """A node that takes what lies below, by its first hidden unit."""
        parameters = torch.zeros(1, BRANCH.num_parameters)
        size, hidden = BRANCH.hidden * BRANCH.inputs, BRANCH.hidden
        parameters[0, 0], parameters[0, size] = 50.0, -50.0 * at
        parameters[0, size + hidden : size + 3 * hidden : hidden] = torch.tensor([-8.0, 8.0])
        parameters[0, size + 3 * hidden :] = torch.tensor([4.0, -4.0])
        return parameters

    tries = [border(at) for at in (2.0, 0.97, 0.0)]
    sent = [selected_members(BRANCH, parameters, seen) for parameters in tries]
    right = (torch.arange(40) >= 20).long()
    assert [torch.equal(each, right) for each in sent] == [False, True, True]
    assert _most_reliable(BRANCH, tries, seen, solves, torch.ones(40), seeded(0)) == 2
    assert _most_reliable(BRANCH, tries[:2], seen, solves, torch.ones(40), seeded(0)) == 1
