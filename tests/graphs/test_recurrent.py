"""Networks that remember: what a step gives, where the state lies, and what a name stands for."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support import create_run, model, seeded, world

import cgtorch
from cgtorch.domains.settings import DomainSettings
from cgtorch.graphs import ActionSet, RecurrentNN, check_action, resolve_actions
from cgtorch.graphs.action import memory_parts
from cgtorch.graphs.recurrent import recurrent_parameters, recurrent_step
from cgtorch.ground.environment import start_lanes
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import read_run
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.settings import TabletopSettings

Numbers = NDArray[np.float64]


def by_hand(x: Numbers, h: Numbers, numbers: Numbers, outputs: int) -> tuple[Numbers, Numbers]:
    """One step of one network, as its docstring states it."""
    inputs, hidden = len(x), len(h)
    sizes = [hidden * (inputs + hidden), hidden, outputs * hidden, outputs]
    wr, b, v, c = np.split(numbers, np.cumsum(sizes)[:-1])
    w, r = np.split(wr.reshape(hidden, inputs + hidden), [inputs], axis=1)
    after = np.tanh(0.5 * w @ x + 0.5 * r @ h + 0.01 * b)
    return after, 0.5 * v.reshape(outputs, hidden) @ after + 0.01 * c


@given(
    st.integers(0, 2**31),
    st.tuples(st.integers(1, 9), st.integers(1, 5), st.integers(1, 4)),
)
def test_a_step_is_what_it_says(seed: int, sizes: tuple[int, int, int]) -> None:
    (inputs, hidden, outputs), generator = sizes, seeded(seed)
    count = RecurrentNN(*sizes).num_parameters
    assert count == hidden * (inputs + hidden + 1) + outputs * (hidden + 1)
    x, h, numbers = (
        torch.randn(4, width, generator=generator, dtype=torch.float64)
        for width in (inputs, hidden, count)
    )
    found = recurrent_step(x, h, numbers, outputs)
    for i in range(4):
        wanted = by_hand(x[i].numpy(), h[i].numpy(), numbers[i].numpy(), outputs)
        for mine, other in zip(found, wanted, strict=True):
            np.testing.assert_allclose(mine[i].numpy(), other, atol=1e-12)


def test_sizes_and_what_is_exported() -> None:
    action = RecurrentNN()
    assert action.num_parameters == recurrent_parameters(7, 3, 3) == 45
    assert (action.message_size, action.memory_size, action.percept_size) == (3, 3, 7)
    assert action.outcomes == ("success",)
    assert cgtorch.RecurrentNN is RecurrentNN
    values = action.initial_parameters(10_000, seeded(0))
    assert abs(float(values.std()) - 1) < 0.01  # what is smaller is done in forward


@pytest.mark.parametrize("sizes", [(7, 3, 3), (3, 1, 1), (2, 8, 5)])
def test_it_keeps_the_interface(sizes: tuple[int, int, int]) -> None:
    for environment in (world(0, 3), world(0, 1), model(0, 2)):
        check_action("mine", RecurrentNN(*sizes), environment)


def test_the_state_is_carried_on_and_the_rest_stays() -> None:
    action, environment = RecurrentNN(), model(0, 4)
    lanes = start_lanes(environment, torch.arange(4), 5, 4)  # a part that it shares with others
    assert not lanes.memory.any()
    lanes.message[:], lanes.memory[:, 3] = 9.0, 7.0
    weights = torch.randn(4, 60, generator=seeded(0))
    own = weights[:, : action.num_parameters]
    once, outcome = action(lanes, own, environment)
    again, _ = action(once, own, environment)
    first = recurrent_step(lanes.percept, torch.zeros(4, 3), own, 3)
    second = recurrent_step(lanes.percept, first[0], own, 3)
    for after, (state, said) in ((once, first), (again, second)):
        assert torch.equal(after.memory[:, :3], state)
        assert torch.equal(after.message[:, :3], said)
        assert (after.message[:, 3:] == 9).all()
        assert (after.memory[:, 3] == 7).all()
        assert after.has_message.all()
    assert outcome.tolist() == [0] * 4
    assert (first[1] != second[1]).any(1).all()
    assert not lanes.memory[:, :3].any()  # the lanes it was given stay as they were
    assert not lanes.has_message.any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_neighbour_changes_a_row(dtype: torch.dtype) -> None:
    """Bit for bit, wherever the row stands in its batch."""
    x, h, w = (torch.randn(200, n, generator=seeded(n), dtype=dtype) for n in (7, 3, 45))
    whole = recurrent_step(x, h, w, 3)
    for n in (1, 2, 3, 5, 7, 8, 9, 17, 33):
        for first in range(100):
            rows = slice(first, first + n)
            part = recurrent_step(x[rows], h[rows], w[rows], 3)
            assert all(torch.equal(a, b[rows]) for a, b in zip(part, whole, strict=True))


def test_gradients_flow_through_time() -> None:
    x, w = (torch.randn(4, n, generator=seeded(n)).double().requires_grad_() for n in (7, 45))

    def twice(x: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
        state, _ = recurrent_step(x, x.new_zeros(4, 3), w, 3)
        return recurrent_step(x, state, w, 3)[1]

    assert torch.autograd.gradcheck(twice, (x, w))


def test_all_nodes_of_an_action_share_its_memory() -> None:
    one, other = RecurrentNN(), RecurrentNN(hidden=2)
    parts, size = memory_parts([one, other])
    assert (parts, size) == ((slice(0, 3), slice(3, 5)), 5)


def test_its_name_is_known_in_any_domain() -> None:
    assert resolve_actions(["RecurrentNN"], paper_actions(), (7, 3)).names[-1] == "RecurrentNN"
    action = resolve_actions(["RecurrentNN"], paper_actions(), (9, 2)).actions[-1]
    assert isinstance(action, RecurrentNN)
    assert (action.inputs, action.hidden, action.outputs) == (9, 3, 2)
    mine = ActionSet(("RecurrentNN",), (RecurrentNN(2, 5, 1),))
    assert resolve_actions(["RecurrentNN"], mine, (7, 3)) == mine


@pytest.mark.parametrize(
    ("settings", "own", "sizes"),
    [
        (RunSettings(actions=("RecurrentNN",)), TabletopSettings(percept="yaw"), (9, 3)),
        (RunSettings(domain="walking:Walking", actions=("RecurrentNN",)), None, (2, 1)),
    ],
)
def test_a_run_makes_it_for_its_domain(
    settings: RunSettings, own: DomainSettings | None, sizes: tuple[int, int], tmp_path: Path
) -> None:
    run = create_run(tmp_path / "run", settings, own)
    for each in (run, read_run(run.folder, domain=settings.domain)):
        action = each.actions.actions[each.actions.index("RecurrentNN")]
        assert isinstance(action, RecurrentNN)
        assert (action.inputs, action.outputs) == sizes
