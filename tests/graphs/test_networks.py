"""Networks: what they compute, what they keep, where their state lies, and their names."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import create_run, model, seeded, world
from torch import Tensor

import cgtorch
from cgtorch.domains.settings import DomainSettings
from cgtorch.graphs import (
    Action,
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    LinearNN,
    RecurrentNN,
    check_action,
    resolve_actions,
)
from cgtorch.graphs.action import memory_parts
from cgtorch.graphs.networks import one_hidden_layer, percept_and_changes, recurrent_step
from cgtorch.ground.environment import start_lanes
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import read_run
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.settings import TabletopSettings

seeds = st.integers(0, 2**31)
sizes = st.tuples(st.integers(1, 9), st.integers(1, 5), st.integers(1, 4))


def normal(seed: int, *widths: int, rows: int = 4) -> list[Tensor]:
    generator = seeded(seed)
    return [torch.randn(rows, n, generator=generator, dtype=torch.float64) for n in widths]


@given(seeds, sizes)
def test_a_row_is_a_network_of_linear_layers(seed: int, sizes: tuple[int, int, int]) -> None:
    inputs, hidden, outputs = sizes
    first, second = torch.nn.Linear(inputs, hidden), torch.nn.Linear(hidden, outputs)
    parts = [p for layer in (first.double(), second.double()) for p in layer.parameters()]
    x, weights = normal(seed, inputs, ContinuousNN(*sizes).num_parameters)
    out = one_hidden_layer(x, weights, hidden, outputs)
    for i in range(4):
        with torch.no_grad():
            for p, values in zip(parts, weights[i].split([p.numel() for p in parts]), strict=True):
                p.copy_(values.view_as(p))
            torch.testing.assert_close(out[i], second(torch.sigmoid(first(x[i]))))


@given(seeds, sizes)
def test_a_recurrent_step_is_what_it_says(seed: int, sizes: tuple[int, int, int]) -> None:
    inputs, hidden, outputs = sizes
    parts = [hidden * (inputs + hidden), hidden, outputs * hidden, outputs]
    assert RecurrentNN(*sizes).num_parameters == sum(parts)
    x, h, numbers = normal(seed, inputs, hidden, sum(parts))
    state, said = recurrent_step(x, h, numbers, outputs)
    for i in range(4):
        wr, b, v, c = np.split(numbers[i].numpy(), np.cumsum(parts)[:-1])
        w, r = np.split(wr.reshape(hidden, inputs + hidden), [inputs], axis=1)
        after = np.tanh(0.5 * w @ x[i].numpy() + 0.5 * r @ h[i].numpy() + 0.01 * b)
        np.testing.assert_allclose(state[i], after, atol=1e-12)
        wanted = 0.5 * v.reshape(outputs, hidden) @ after + 0.01 * c
        np.testing.assert_allclose(said[i], wanted, atol=1e-12)


@given(seeds, st.integers(1, 6), st.integers(0, 4))
def test_inputs_are_the_percept_and_ten_times_its_changes(
    seed: int, inputs: int, delays: int
) -> None:
    x, earlier = normal(seed, inputs, inputs * delays)
    found = percept_and_changes(x, earlier)
    for row in range(4):
        times = np.concatenate([x[row], earlier[row]]).reshape(delays + 1, inputs)
        changes = [10 * (a - b) for a, b in itertools.pairwise(times)]
        np.testing.assert_array_equal(found[row], np.concatenate([times[0], *changes]))


FUNCTIONS: list[tuple[Callable[..., object], tuple[int, ...]]] = [
    (lambda x, w: one_hidden_layer(x, w, 3, 3), (7, 36)),
    (lambda x, h, w: recurrent_step(x, h, w, 3), (7, 3, 45)),
    (percept_and_changes, (7, 21)),
]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("function", "widths"), FUNCTIONS)
def test_no_neighbour_changes_a_row(
    function: Callable[..., object], widths: tuple[int, ...], dtype: torch.dtype
) -> None:
    """Bit for bit, wherever the row stands in its batch."""
    given = [each.to(dtype) for each in normal(0, *widths, rows=140)]

    def values(rows: slice) -> Tensor:
        found = function(*(each[rows] for each in given))
        return torch.cat(found if isinstance(found, tuple) else (found,), 1)  # type: ignore[arg-type]

    whole = values(slice(None))
    for n, first in itertools.product((1, 2, 3, 5, 7, 8, 9, 17, 33), range(0, 100, 3)):
        rows = slice(first, first + n)
        assert torch.equal(values(rows), whole[rows])


@pytest.mark.parametrize(("function", "widths"), FUNCTIONS)
def test_gradients_flow_to_weights_percepts_and_states(
    function: Callable[..., object], widths: tuple[int, ...]
) -> None:
    given = [each.requires_grad_() for each in normal(0, *widths)]
    assert torch.autograd.gradcheck(function, given)


def test_sizes_of_parameters_memories_and_messages() -> None:
    assert [a().num_parameters for a in (ContinuousNN, BranchingNN, RecurrentNN)] == [36, 32, 45]
    assert LinearNN(5, 2).num_parameters == DelayNN(5, 0, 2).num_parameters == 12
    recurrent = RecurrentNN()
    assert (recurrent.message_size, recurrent.memory_size, recurrent.percept_size) == (3, 3, 7)
    assert abs(float(recurrent.initial_parameters(10_000, seeded(0)).std()) - 1) < 0.01
    assert memory_parts([LinearNN(), DelayNN()]) == ((slice(0, 0), slice(0, 21)), 21)
    parts = memory_parts([recurrent, RecurrentNN(hidden=2)])
    assert parts == ((slice(0, 3), slice(3, 5)), 5)


NETWORKS = [
    ContinuousNN(), DelayNN(), DelayNN(3, 1, 1), DelayNN(4, 2, 1), LinearNN(), LinearNN(2, 5),
    RecurrentNN(), RecurrentNN(3, 1, 1), RecurrentNN(2, 8, 5),
]  # fmt: skip


def said(action: Action, seen: list[Tensor], state: Tensor, numbers: Tensor) -> Tensor:
    """A network's message for the latest percepts and its state, which is overwritten."""
    x = seen[0][:, : action.inputs]
    if isinstance(action, ContinuousNN):
        return one_hidden_layer(x, numbers, action.hidden, action.outputs)
    if isinstance(action, RecurrentNN):
        state[:], out = recurrent_step(x, state.clone(), numbers, action.outputs)
        return out
    times = [each[:, : action.inputs] for each in seen[: action.delays + 1]]
    changes = [10 * (a - b) for a, b in itertools.pairwise(times)]
    inputs = torch.cat([x, *changes], 1)
    matrix = 0.5 * numbers[:, : -action.outputs].unflatten(1, (action.outputs, -1))
    return (matrix @ inputs[..., None])[..., 0] + 0.01 * numbers[:, -action.outputs :]


@pytest.mark.parametrize("action", NETWORKS)
def test_messages_and_memory_go_on_and_the_rest_stays(action: Action) -> None:
    environment, outputs = model(0, 4), action.message_size
    for place in (world(0, 3), world(0, 1), environment):
        check_action("mine", action, place)
    numbers = torch.randn(4, action.num_parameters, generator=seeded(1))
    lanes = start_lanes(environment, torch.arange(4), 6, action.memory_size + 1)
    lanes.memory[:, -1], lanes.message[:] = 7.0, 9.0
    seen = [torch.zeros_like(lanes.percept)] * 5
    state = torch.zeros(4, action.memory_size)
    for step in range(5):
        lanes.percept[:] = torch.randn(lanes.percept.shape, generator=seeded(step))
        kept = lanes.memory.clone(), lanes.message.clone(), lanes.has_message.clone()
        after, outcome = action(lanes, numbers, environment)
        for before, now in zip(kept, (lanes.memory, lanes.message, lanes.has_message), strict=True):
            assert torch.equal(before, now)  # the lanes it was given stay as they were
        seen = [lanes.percept.clone(), *seen[:-1]]
        torch.testing.assert_close(after.message[:, :outputs], said(action, seen, state, numbers))
        assert (after.message[:, outputs:] == 9).all()
        assert (after.memory[:, -1] == 7).all()
        assert after.has_message.all()
        assert outcome.tolist() == [0] * 4
        lanes = after


def test_branching_takes_the_larger_output_and_the_first_of_equals() -> None:
    environment = model(0, 3)
    lanes = start_lanes(environment, torch.arange(3), 0, 0)
    weights = torch.zeros(3, 32)
    weights[:, -2:] = torch.tensor([[1.0, 2.0], [2.0, 1.0], [1.0, 1.0]])
    after, outcome = BranchingNN()(lanes, weights, environment)
    assert outcome.tolist() == [1, 0, 0]
    assert after is lanes


@pytest.mark.parametrize("name", ["DelayNN", "LinearNN", "RecurrentNN"])
def test_a_name_is_known_in_any_domain(name: str) -> None:
    assert resolve_actions([name], paper_actions(), (7, 3)).names == (*paper_actions().names, name)
    action = resolve_actions([name], paper_actions(), (9, 2)).actions[-1]
    assert (action.inputs, action.outputs) == (9, 2)
    mine = ActionSet((name,), (RecurrentNN(2, 5, 1),))
    assert resolve_actions([name], mine, (7, 3)) == mine
    assert cgtorch.DelayNN is DelayNN
    assert cgtorch.RecurrentNN is RecurrentNN


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
