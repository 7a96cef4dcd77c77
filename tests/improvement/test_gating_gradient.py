"""The compiled gradient is the one of automatic differentiation."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch import native
from cgtorch.graphs import BranchingNN
from cgtorch.improvement.gating import gradient_in_torch, gradient_of
from cgtorch.native import available

RESTARTS = 3

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")


def case(
    seed: int, count: int, members: int, branch: BranchingNN, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Parameters, percepts, how reliably members solve, and weights; many of each are 0."""
    generator = seeded(seed)
    shape = (RESTARTS, members - 1, branch.num_parameters)
    size = 10.0 ** torch.rand(RESTARTS, 1, 1, generator=generator, dtype=dtype).mul(3).sub(2)
    parameters = size * torch.randn(shape, generator=generator, dtype=dtype)
    percepts = torch.randn(count, branch.inputs, generator=generator, dtype=dtype)
    solves = torch.randint(0, 4, (count, members), generator=generator).to(dtype) / 3
    weight = torch.randint(0, 4, (count,), generator=generator).to(dtype)
    return parameters, percepts, solves, weight


@given(st.integers(0, 2**31), st.integers(1, 70), st.integers(2, 7), st.integers(1, 9))
def test_in_double_precision(seed: int, count: int, members: int, inputs: int) -> None:
    branch = BranchingNN(inputs, hidden=1 + seed % 4)
    parameters, percepts, *given = case(seed, count, members, branch, torch.float64)
    wanted = gradient_in_torch(branch, *given)(parameters, percepts)
    found = gradient_of(branch, *given, RESTARTS)(parameters, percepts)
    assert torch.allclose(found, wanted, rtol=1e-9, atol=1e-11)


@given(st.integers(0, 2**31), st.integers(1, 70), st.integers(2, 7))
@settings(max_examples=30)
def test_in_single_precision(seed: int, count: int, members: int) -> None:
    """Also where a node hardly ever passes on what only the next member solves."""
    branch = BranchingNN()
    parameters, percepts, *given = case(seed, count, members, branch, torch.float64)
    wanted = gradient_in_torch(branch, *given)(parameters, percepts)
    single = [each.float() for each in given]
    found = gradient_of(branch, *single, RESTARTS)(parameters.float(), percepts.float())
    assert torch.allclose(found.double(), wanted, rtol=1e-3, atol=2e-5)


def test_threads_and_earlier_calls_change_nothing() -> None:
    branch = BranchingNN()
    parameters, percepts, *given = case(1, 50, 4, branch, torch.float32)
    gradient = gradient_of(branch, *given, RESTARTS)
    native.use_threads(1)
    one = gradient(parameters, percepts).clone()
    gradient(2 * parameters, percepts)
    native.use_threads(3)
    assert torch.equal(gradient(parameters, percepts), one)
