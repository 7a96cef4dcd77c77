import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import model, seeded

from cgtorch.graphs import BranchingNN, ContinuousNN
from cgtorch.graphs.networks import network_parameters, one_hidden_layer
from cgtorch.ground.environment import start_lanes


def as_modules(weights: torch.Tensor, inputs: int, hidden: int, outputs: int) -> torch.nn.Module:
    """The same network as torch's own layers."""
    first, second = torch.nn.Linear(inputs, hidden), torch.nn.Linear(hidden, outputs)
    parts = (first.weight, first.bias, second.weight, second.bias)
    sizes = [p.numel() for p in parts]
    with torch.no_grad():
        for part, values in zip(parts, weights.split(sizes), strict=True):
            part.copy_(values.view_as(part))
    return torch.nn.Sequential(first, torch.nn.Sigmoid(), second)


@given(
    st.integers(0, 2**31),
    st.tuples(st.integers(1, 9), st.integers(1, 5), st.integers(1, 4)),
)
def test_a_row_is_a_network_of_linear_layers(seed: int, sizes: tuple[int, int, int]) -> None:
    generator = seeded(seed)
    count = network_parameters(*sizes)
    x = torch.randn(5, sizes[0], generator=generator)
    weights = torch.randn(5, count, generator=generator)
    out = one_hidden_layer(x, weights, *sizes[1:])
    for i in range(5):
        module = as_modules(weights[i], *sizes)
        assert sum(p.numel() for p in module.parameters()) == count
        torch.testing.assert_close(out[i], module(x[i]))


def test_the_papers_sizes() -> None:
    assert ContinuousNN().num_parameters == 7 * 3 + 3 + 3 * 3 + 3
    assert BranchingNN().num_parameters == 7 * 3 + 3 + 3 * 2 + 2


def test_gradients_flow_to_weights_and_percepts() -> None:
    x = torch.randn(4, 7, generator=seeded(0), dtype=torch.float64, requires_grad=True)
    w = torch.randn(4, 36, generator=seeded(1), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x, w: one_hidden_layer(x, w, 3, 3), (x, w))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_neighbour_changes_a_row(dtype: torch.dtype) -> None:
    """Bit for bit, wherever the row stands in its batch."""
    x = torch.randn(200, 7, generator=seeded(0), dtype=dtype)
    w = torch.randn(200, 36, generator=seeded(1), dtype=dtype)
    whole = one_hidden_layer(x, w, 3, 3)
    for n in (1, 2, 3, 5, 7, 8, 9, 17, 33):
        for first in range(100):
            rows = slice(first, first + n)
            assert torch.equal(one_hidden_layer(x[rows], w[rows], 3, 3), whole[rows])


def test_continuous_sends_a_message_and_keeps_what_is_beyond_it() -> None:
    environment = model(0, 4)
    lanes = start_lanes(environment, torch.arange(4), 5, 0)
    lanes.message[:] = 9.0
    weights = torch.randn(4, 36, generator=seeded(0))
    after, outcome = ContinuousNN()(lanes, weights, environment)
    assert outcome.tolist() == [0] * 4
    assert after.has_message.all()
    assert torch.equal(after.message[:, :3], one_hidden_layer(lanes.percept, weights, 3, 3))
    assert (after.message[:, 3:] == 9).all()
    assert (lanes.message == 9).all()  # the lanes it was given stay as they were
    assert not lanes.has_message.any()


def test_branching_takes_the_larger_output_and_the_first_of_equals() -> None:
    environment = model(0, 3)
    lanes = start_lanes(environment, torch.arange(3), 0, 0)
    weights = torch.zeros(3, 32)
    weights[:, -2:] = torch.tensor([[1.0, 2.0], [2.0, 1.0], [1.0, 1.0]])
    after, outcome = BranchingNN()(lanes, weights, environment)
    assert outcome.tolist() == [1, 0, 0]
    assert after is lanes
