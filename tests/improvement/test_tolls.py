"""Tolls: what a transition is worth to a graph that does nothing is taken from rivals' values."""

import math
from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from lottery import staking
from lottery_search import HELD, PLAYED, search_of, tuned
from support import same, seeded
from torch import Generator

from cgtorch.graphs import ActionSet, Graphs
from cgtorch.ground.environment import Environment
from cgtorch.improvement.expected_state import State
from cgtorch.improvement.mean_search import (
    UNTUNED,
    MeanSearch,
)
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.tuning import EVERY, PATIENCE, Tuning
from cgtorch.simulation import Rollouts


class Lasting(Fresh):
    """Episodes of many lengths, which earn the more for a transition the larger a parameter is."""

    sign = 1.0

    def runs(self, graphs: Graphs, actions: ActionSet, world: Environment) -> Rollouts:
        found = super().runs(graphs, actions, world)
        shape = found.transitions.shape
        lengths = found.transitions + torch.arange(shape.numel()).view(shape)
        earned = 1 + graphs.parameters[:, 0, :1] / 10
        return replace(found, transitions=lengths, returns=self.sign * lengths * earned)


def test_a_toll_is_what_a_transition_is_worth_before_tuning() -> None:
    search = MeanSearch(search_of().setup, Lasting(search_of().fresh.world, 4))
    one = tuned(staking(0.5))
    moved = replace(one, distribution=replace(one.distribution, mean=one.distribution.mean + 1))
    state = State(HELD, moved, (tuned(staking(0.1)),), spent=PLAYED)
    after = search._tuned(state, (moved,), seeded(5))
    assert after.lengthy
    assert [each.toll for each in after.rivals] == [0.0, pytest.approx(1.05)]
    for sign, worth in (
        (1.0, 1.05),
        (-1.0, 0.0),
        (math.inf, 0.0),
        (-math.inf, 0.0),
        (0.0, 0.0),
        (0.5, 0.525),
    ):
        search.fresh.sign = sign  # type: ignore[attr-defined]
        played = search.fresh.episodes
        assert search._worth_of_transitions(one.graph, seeded(6)) == pytest.approx(worth)
        assert search.fresh.episodes - played == UNTUNED


class Known(MeanSearch):
    """A search where a transition is worth so much."""

    worth: ClassVar[float] = 0.5

    def _worth_of_transitions(self, graph: Graphs, generator: Generator) -> float:
        return self.worth


def test_the_same_graph_is_tuned_under_a_toll_where_lengths_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def after_update(one: Tuning, *rivals: Tuning, lengthy: bool = True) -> tuple[Tuning, ...]:
        state = State(HELD, one, rivals, lengthy=lengthy, spent=PLAYED)
        return search._tuned(state, (one,), seeded(5)).rivals

    search = Known(*vars(search_of()).values())
    one, rival = tuned(staking(0.5)), tuned(staking(0.1))
    first = after_update(one, rival)
    assert [each.toll for each in first] == [0.0, 0.5]
    assert same(first[1].graph, one.graph)
    assert [each.alone for each in first] == [False, True]
    assert len(after_update(one, rival, lengthy=False)) == 1
    for updates, rivals in ((EVERY - 1, 2), (EVERY, 1)):
        later = replace(one, distribution=replace(one.distribution, updates=updates))
        assert len(after_update(later, rival)) == rivals
    already = tuned(staking(0.1), 0.75)
    assert [each.toll for each in after_update(one, already)] == [0.75]
    assert [each.toll for each in after_update(one, already, rival)] == [0.75, 0.0]
    assert [each.toll for each in after_update(one)] == [0.5]
    # One with a toll gets a rival that begins anew where it stalls.
    has = tuned(staking(0.5), 0.75)
    assert len(after_update(has, rival)) == 1
    stalls = tuned(staking(-5.0), 0.75, updates=EVERY - 1, lost=PATIENCE - 1, mark=9.0)
    assert [each.toll for each in after_update(stalls, rival)] == [0.0, 0.5]
    assert len(after_update(replace(stalls, mark=-99.0), rival)) == 1  # as samples become better
    monkeypatch.setattr(Known, "worth", 0.0)
    assert len(after_update(one, rival)) == 1
