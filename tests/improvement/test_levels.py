"""What an update keeps of its samples, and what tells that a tuning gets better."""

from dataclasses import replace
from math import inf

import pytest
import torch
from lottery import ACTIONS, staking
from lottery_search import tuned
from support import seeded

from cgtorch.graphs import ActionSet, Graphs, LinearNN, Step
from cgtorch.improvement.horizon import Horizon, Played
from cgtorch.improvement.spread import MANY
from cgtorch.improvement.tuning import (
    CONVERGED,
    MOST,
    PROGRESS,
    RECENT,
    RELATIVE,
    Tuning,
    _after_truncated,
    _after_whole,
    begun,
)


def rows(values: torch.Tensor) -> tuple[torch.Tensor, Played]:
    """Samples that got these values (P, B), the later ones in longer episodes."""
    drawn = torch.randn(len(values), 2, generator=seeded(0)).double()
    lengths = 1 + torch.arange(len(values))[:, None].expand(values.shape)
    early = values.new_zeros(*values.shape, 0)
    return drawn, Played(values.double(), lengths, values.new_zeros(values.shape), early)


def after(tuning: Tuning, values: torch.Tensor) -> tuple[Tuning, bool]:
    drawn, played = rows(values)
    return _after_whole(tuning, drawn, played, played, MOST)


def after_truncated(tuning: Tuning, values: torch.Tensor) -> Tuning:
    return _after_truncated(replace(tuning, horizon=Horizon(5.0)), *rows(values), MOST, 1)


def test_a_level_is_the_mean_of_the_better_half_in_the_last_updates() -> None:
    values = torch.tensor([[1.0, 2.0], [9.0, 8.0], [3.0, 4.0], [0.0, 7.0], [5.0, 6.0]])
    one = tuned(staking(0.5), recent=(1.0, 2.0, 3.0, 4.0))
    assert RECENT == 4
    found, long = after(one, values)
    assert found.recent == (2.0, 3.0, 4.0, (8.5 + 5.5) / 2)
    assert not long
    assert found.level == pytest.approx(4.0)
    assert after(replace(one, horizon=Horizon(9.0)), values)[0].recent == (7.0,)
    truncated = after_truncated(one, values)
    assert (truncated.recent, truncated.horizon.steps) == (one.recent, 5.0)
    assert after_truncated(one, torch.ones(5, 2)).horizon.steps == inf
    many = replace(one, scenarios=10, reliability=1.0)
    assert after(many, torch.arange(5.0)[:, None].expand(5, 2))[0].scenarios == 10
    lengths = torch.arange(5.0)[:, None] + torch.rand(5, 2, generator=seeded(1))
    assert after(one, lengths)[1]


def test_samples_get_better_by_a_tenth_of_what_they_were_worth() -> None:
    one = tuned(staking(0.5), mark=10.0)
    assert PROGRESS == 0.1
    assert not replace(one, recent=(11.0,)).improving
    assert replace(one, recent=(11.01,)).improving


def test_what_is_known_at_the_edge_of_convergence_goes_on() -> None:
    one = tuned(staking(0.5))
    small = replace(one, distribution=replace(one.distribution, step=CONVERGED))
    assert replace(small, reliability=0.9).more() is not None
    smaller = replace(one, distribution=replace(one.distribution, step=CONVERGED / 2))
    assert replace(smaller, reliability=MANY).more() is not None
    assert replace(smaller, reliability=0.9).more() is None
    assert replace(smaller, scenarios=MOST, reliability=0.0).more() is None
    many = replace(smaller, scenarios=MOST - 1, reliability=0.0).more()
    assert many is not None
    assert many.scenarios == MOST


def test_nodes_without_parameters_change_no_first_steps() -> None:
    actions = ActionSet(("Linear", "Step"), (LinearNN(2, 1), Step(1)))
    graph = Graphs(
        torch.tensor([[0, 1]]), torch.tensor([[[1, -1], [0, 0]]]),
        torch.tensor([[[30.0, 40.0, 0.0], [0.0, 0.0, 0.0]]]), torch.zeros(1, dtype=torch.long),
    )  # fmt: skip
    found = begun(graph, actions, 1)
    assert found is not None
    wanted = RELATIVE**2 * (30**2 + 40**2) / 3 / 3  # as there are three parameters
    assert found.distribution.covariance.diagonal().tolist() == pytest.approx([wanted] * 3)
    assert begun(staking(0.5).graph, ACTIONS, 3, alone=True) is not None
