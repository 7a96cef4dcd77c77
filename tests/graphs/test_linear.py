"""Linear networks of a percept and its latest changes."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import model, seeded, world

import cgtorch
from cgtorch.graphs import DelayNN, LinearNN, check_action, resolve_actions
from cgtorch.graphs.action import memory_parts
from cgtorch.graphs.linear import percept_and_changes
from cgtorch.ground.environment import start_lanes
from cgtorch.tabletop.actions import paper_actions


@given(st.integers(0, 2**31), st.integers(1, 6), st.integers(0, 4))
def test_inputs_are_the_percept_and_ten_times_its_changes(
    seed: int, inputs: int, delays: int
) -> None:
    x, earlier = (
        torch.randn(3, n, generator=seeded(seed), dtype=torch.float64)
        for n in (inputs, inputs * delays)
    )
    found = percept_and_changes(x, earlier)
    for row in range(3):
        times = np.concatenate([x[row], earlier[row]]).reshape(delays + 1, inputs)
        changes = [10 * (a - b) for a, b in itertools.pairwise(times)]
        np.testing.assert_array_equal(found[row], np.concatenate([times[0], *changes]))


@pytest.mark.parametrize(("delays", "sizes"), [(0, (7, 3)), (3, (7, 3)), (2, (4, 1))])
def test_it_says_what_its_docstring_says(delays: int, sizes: tuple[int, int]) -> None:
    inputs, outputs = sizes
    action, environment = DelayNN(inputs, delays, outputs), model(0, 4)
    size = inputs * (delays + 1)
    assert action.num_parameters == outputs * (size + 1)
    numbers = torch.randn(4, action.num_parameters, generator=seeded(1))
    matrix = 0.5 * numbers[:, : outputs * size].view(4, outputs, size)
    lanes = start_lanes(environment, torch.arange(4), 5, inputs * delays + 1)
    lanes.memory[:, -1], lanes.message[:] = 7.0, 9.0
    seen = [torch.zeros(4, inputs)] * (delays + 1)
    for step in range(delays + 2):
        lanes.percept[:] = torch.randn(lanes.percept.shape, generator=seeded(step))
        before = lanes.memory.clone()
        after, outcome = action(lanes, numbers, environment)
        assert torch.equal(lanes.memory, before)  # the lanes it was given stay as they were
        seen = [lanes.percept[:, :inputs].clone(), *seen[:-1]]
        changes = [10 * (a - b) for a, b in itertools.pairwise(seen)]
        wanted = (matrix @ torch.cat([seen[0], *changes], 1)[..., None])[..., 0]
        wanted += 0.01 * numbers[:, outputs * size :]
        torch.testing.assert_close(after.message[:, :outputs], wanted)
        assert (after.message[:, outputs:] == 9).all()
        assert (after.memory[:, -1] == 7).all()
        assert after.has_message.all()
        assert outcome.tolist() == [0] * 4
        lanes = after


def test_without_delays_it_is_the_linear_network() -> None:
    assert LinearNN(5, 2).num_parameters == DelayNN(5, 0, 2).num_parameters == 12
    assert LinearNN(5, 2).memory_size == 0
    assert memory_parts([LinearNN(), DelayNN()]) == ((slice(0, 0), slice(0, 21)), 21)


@pytest.mark.parametrize("action", [DelayNN(), DelayNN(3, 1, 1), LinearNN(), LinearNN(2, 5)])
def test_it_keeps_the_interface(action: DelayNN) -> None:
    for environment in (world(0, 3), world(0, 1), model(0, 2)):
        check_action("mine", action, environment)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_neighbour_changes_a_row(dtype: torch.dtype) -> None:
    """Bit for bit, wherever the row stands in its batch."""
    x, earlier = (torch.randn(50, n, generator=seeded(n), dtype=dtype) for n in (7, 21))
    whole = percept_and_changes(x, earlier)
    for n, first in itertools.product((1, 3, 8, 17), range(30)):
        rows = slice(first, first + n)
        assert torch.equal(percept_and_changes(x[rows], earlier[rows]), whole[rows])


@pytest.mark.parametrize("name", ["DelayNN", "LinearNN"])
def test_its_name_is_known_in_any_domain(name: str) -> None:
    assert resolve_actions([name], paper_actions(), (7, 3)).names == (*paper_actions().names, name)
    action = resolve_actions([name], paper_actions(), (9, 2)).actions[-1]
    assert (action.inputs, action.outputs) == (9, 2)
    assert cgtorch.DelayNN is DelayNN
