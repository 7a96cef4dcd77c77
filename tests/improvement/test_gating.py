"""Branches: each scenario goes to a member that solves it; their gradient is that of autograd."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded, world
from torch import Tensor
from torch.optim.adam import adam

from cgtorch import native
from cgtorch.graphs import BranchingNN
from cgtorch.ground.environment import start_lanes
from cgtorch.improvement import gating as gate
from cgtorch.improvement.gating import (
    BLUR,
    _most_reliable,
    _scale_and_blur,
    _shares,
    _unscaled,
    gradient_in_torch,
    gradient_of,
    selected_members,
    train_gating,
)

BRANCH = BranchingNN()
RESTARTS = 3
compiled = pytest.mark.skipif(not native.available(), reason="there is no C compiler")


def percepts(count: int, seed: int = 0) -> Tensor:
    return world(seed, count).start(torch.arange(count))[1]


def sent(seen: Tensor, solves: Tensor, seed: int = 1, weight: Tensor | None = None) -> Tensor:
    """The member of each scenario after training."""
    weight = torch.ones(len(seen)) if weight is None else weight
    parameters = train_gating(BRANCH, seen, solves, weight, seeded(seed))
    assert parameters.shape == (solves.shape[1] - 1, BRANCH.num_parameters)
    return selected_members(BRANCH, parameters, seen)


@pytest.mark.parametrize(("members", "unit"), [(2, 1.0), (4, 1.0), (2, 1e-9)])
def test_sets_that_can_be_separated_are(members: int, unit: float) -> None:
    seen = unit * percepts(60)
    edges = seen[:, 5].quantile(torch.linspace(0, 1, members + 1)[1:-1])
    zone = torch.bucketize(seen[:, 5].contiguous(), edges)
    found = sent(seen, torch.nn.functional.one_hot(zone, members).float())
    assert float((found == zone).float().mean()) > 0.95


def test_sets_are_separated_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "function", lambda name, dtype: None)
    monkeypatch.setattr(gate, "EPOCHS", 300)
    test_sets_that_can_be_separated_are(2, 1.0)


def test_members_that_solve_are_preferred_and_hopeless_scenarios_ignored() -> None:
    seen = percepts(40, 2)
    # Member 1 solves the right half and member 0 solves all that anybody does.
    left, hopeless = seen[:, 5] > 0, torch.arange(40) % 8 == 0
    solves = torch.stack([~hopeless, ~left & ~hopeless], 1).float()
    found = sent(seen, solves, 3)
    assert solves.gather(1, found[:, None])[~hopeless].min() == 1
    sure = torch.where(left[:, None], torch.tensor([1.0, 0.34]), torch.tensor([0.34, 1.0]))
    assert float((sent(seen, sure, 5) == (~left).long()).float().mean()) > 0.9


def test_a_scenario_that_nobody_solves_counts_as_one_without_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gate, "EPOCHS", 20)
    seen, solves, weight = percepts(30), torch.rand(30, 3, generator=seeded(0)), torch.ones(30)
    hopeless = torch.arange(30) % 3 == 0
    solves[hopeless] = 0
    one = train_gating(BRANCH, seen, solves, weight, seeded(1))
    other = train_gating(BRANCH, seen, solves, weight * ~hopeless, seeded(1))
    assert torch.equal(one, other)


@pytest.mark.parametrize("important", [0, 1])
def test_weight_decides_where_not_all_can_be_served(important: int) -> None:
    seen = percepts(1, 6).repeat(20, 1)  # twenty scenarios that look the same
    solves, weight = torch.zeros(20, 2), torch.ones(20)
    solves[:4, important], solves[4:, 1 - important] = 1, 1
    assert set(sent(seen, solves, 7).tolist()) == {1 - important}
    weight[:4] = 20
    assert set(sent(seen, solves, 7, weight).tolist()) == {important}


def test_one_member_needs_no_branch() -> None:
    assert sent(percepts(5), torch.ones(5, 1)).tolist() == [0] * 5


def test_the_generator_decides() -> None:
    seen, solves = percepts(20), torch.rand(20, 3, generator=seeded(0))
    about = BRANCH, seen, solves, torch.ones(20)
    first, again, other = (train_gating(*about, seeded(s)) for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@given(st.integers(0, 2**31), st.integers(1, 4))
@settings(max_examples=20)
def test_networks_are_the_same_in_metres(seed: int, count: int) -> None:
    generator, double = seeded(seed), {"dtype": torch.float64}
    scaled = torch.randn(count, BRANCH.num_parameters, generator=generator, **double)
    centre = torch.randn(7, generator=generator, **double)
    scale = 0.1 + torch.rand(7, generator=generator, **double)
    x = torch.randn(9, 7, generator=generator, **double)
    metres = _unscaled(BRANCH, scaled, centre, scale)
    lanes = start_lanes(world(0, 9), torch.arange(9), 0, 0)
    one, other = replace(lanes, percept=(x - centre) / scale), replace(lanes, percept=x)
    for row in range(count):
        wanted = BRANCH.network(one, scaled[row].expand(9, -1))
        assert torch.allclose(wanted, BRANCH.network(other, metres[row].expand(9, -1)), atol=1e-10)


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


def test_the_descent_is_that_of_the_optimiser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Step for step what `torch.optim` comes to, with rates that follow half a cosine."""
    monkeypatch.setattr(gate, "EPOCHS", 60)
    x, solves = percepts(30, 8), torch.rand(30, 3, generator=seeded(9))
    weight, blur = torch.ones(30), torch.full((7,), gate.BLUR)
    gradient = gradient_of(BRANCH, solves, weight, gate.RESTARTS)
    found = gate._descend(BRANCH, x, solves, weight, blur, seeded(10))
    generator = seeded(10)
    parameters = torch.randn(gate.RESTARTS, 2, BRANCH.num_parameters, generator=generator)
    memory = torch.zeros_like(parameters), torch.zeros_like(parameters), torch.zeros(())
    given, mean, square, step = ([each] for each in (parameters, *memory))
    for epoch in range(gate.EPOCHS):
        slope = gradient(parameters, x + torch.randn(x.shape, generator=generator) * blur)
        adam(  # which the class is made of, whose first use takes a second
            given, [slope], mean, square, [], step, foreach=False, amsgrad=False, beta1=0.9,
            beta2=0.999, lr=gate.RATE * (1 + math.cos(math.pi * epoch / gate.EPOCHS)) / 2,
            weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip
    assert torch.allclose(found, parameters, atol=1e-4)


def border(at: float) -> Tensor:
    """A node that takes what lies below, by its first hidden unit."""
    parameters = torch.zeros(1, BRANCH.num_parameters)
    size, hidden = BRANCH.hidden * BRANCH.inputs, BRANCH.hidden
    parameters[0, 0], parameters[0, size] = 50.0, -50.0 * at
    parameters[0, size + hidden : size + 3 * hidden : hidden] = torch.tensor([-8.0, 8.0])
    parameters[0, size + 3 * hidden :] = torch.tensor([4.0, -4.0])
    return parameters


def test_of_equally_right_tries_the_one_with_the_widest_margin_is_chosen() -> None:
    """Three borders at one number of the percept, two of them between the two groups."""
    seen, solves = torch.zeros(40, 7), torch.zeros(40, 2)
    seen[:20, 0], seen[20:, 0] = -1.0, 1.0
    solves[:20, 0] = solves[20:, 1] = 1

    tries = [border(at) for at in (2.0, 0.97, 0.0)]
    right = (torch.arange(40) >= 20).long()
    assert [torch.equal(selected_members(BRANCH, each, seen), right) for each in tries] == [
        False, True, True,
    ]  # fmt: skip
    about = seen, solves, torch.ones(40)
    assert _most_reliable(BRANCH, tries, *about, seeded(0)) == 2
    assert _most_reliable(BRANCH, tries[:2], *about, seeded(0)) == 1

    weight = torch.ones(40)
    weight[20:] = 0  # where the first one alone sends to a member that fails
    assert _most_reliable(BRANCH, tries[:2], seen, solves, weight, seeded(0)) == 0


def test_of_a_single_scenario_the_more_reliable_member_is_chosen() -> None:
    seen, tries = torch.full((1, 7), -1.0), [border(-2.0), border(0.0)]
    assert [int(selected_members(BRANCH, each, seen)) for each in tries] == [1, 0]
    solves = torch.tensor([[0.9, 0.5]])
    assert _most_reliable(BRANCH, tries, seen, solves, torch.ones(1), seeded(0)) == 1


def test_inputs_that_hardly_vary_are_noise_unless_all_of_them_do() -> None:
    unit = torch.tensor([[-1.0], [1.0]]) / 2**0.5  # whose standard deviation is 1
    for deviations, scales, blur in (
        ([0.5, 0.01, 0.0], [0.5, 0.1, 0.1], BLUR),
        ([0.1, 0.1, 0.0], [0.1, 0.1, 0.1], BLUR),
        ([0.05, 0.01, 0.0], [0.05, 0.05, 0.05], BLUR / 2),
        ([0.0, 0.0, 0.0], [0.1, 0.1, 0.1], BLUR),
    ):
        scale, noise = _scale_and_blur(unit * torch.tensor(deviations))
        assert scale.tolist() == pytest.approx(scales)
        assert noise == pytest.approx(blur)


def test_shares_of_weights_add_up_to_one_unless_there_are_none() -> None:
    assert _shares(torch.tensor([1.0, 0.0, 3.0])).tolist() == [0.25, 0.0, 0.75]
    assert _shares(torch.zeros(3)).tolist() == [0, 0, 0]


def case(
    seed: int, count: int, members: int, branch: BranchingNN, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Parameters, percepts, how reliably members solve, and weights; many of each are 0."""
    generator = seeded(seed)
    shape = (RESTARTS, members - 1, branch.num_parameters)
    size = 10.0 ** torch.rand(RESTARTS, 1, 1, generator=generator, dtype=dtype).mul(3).sub(2)
    parameters = size * torch.randn(shape, generator=generator, dtype=dtype)
    seen = torch.randn(count, branch.inputs, generator=generator, dtype=dtype)
    solves = torch.randint(0, 4, (count, members), generator=generator).to(dtype) / 3
    return parameters, seen, solves, torch.randint(0, 4, (count,), generator=generator).to(dtype)


@compiled
@given(st.integers(0, 2**31), st.integers(1, 70), st.integers(2, 7), st.integers(1, 9))
@settings(max_examples=50)
def test_the_compiled_gradient_is_that_of_autograd(
    seed: int, count: int, members: int, inputs: int
) -> None:
    """In single precision also where a node hardly ever passes on what only the next one solves."""
    branch = BranchingNN(inputs, hidden=1 + seed % 4)
    parameters, seen, *given = case(seed, count, members, branch, torch.float64)
    wanted = gradient_in_torch(branch, *given)(parameters, seen)
    found = gradient_of(branch, *given, RESTARTS)(parameters, seen)
    assert torch.allclose(found, wanted, rtol=1e-9, atol=1e-11)
    single = gradient_of(branch, *(each.float() for each in given), RESTARTS)
    found = single(parameters.float(), seen.float()).double()
    assert torch.allclose(found, wanted, rtol=1e-3, atol=2e-5)


@compiled
def test_threads_and_earlier_calls_change_nothing() -> None:
    parameters, seen, *given = case(1, 50, 4, BRANCH, torch.float32)
    gradient = gradient_of(BRANCH, *given, RESTARTS)
    native.use_threads(1)
    one = gradient(parameters, seen).clone()
    gradient(2 * parameters, seen)
    native.use_threads(3)
    assert torch.equal(gradient(parameters, seen), one)


@compiled
def test_scenarios_without_weight_move_nothing() -> None:
    """Not even by rounding, though the last vector of scenarios is filled up."""
    parameters, seen, solves, weight = case(1, 50, 4, BRANCH, torch.float32)
    gradient = gradient_of(BRANCH, solves, torch.zeros_like(weight), RESTARTS)
    assert not gradient(parameters, seen).any()
