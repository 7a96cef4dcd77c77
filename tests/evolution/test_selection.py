"""Ranking, tournaments and epsilon-lexicase selection: who has children, and how many."""

import sys
from collections.abc import Sequence
from itertools import permutations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.evolution.selection import deviation, lexicase, ranked, ranking, tournament
from cgtorch.graphs import NO_NODE, Graphs
from cgtorch.ground.errors import SettingsError


def of_sizes(sizes: Tensor) -> Graphs:
    """Graphs of so many nodes each, which lie in the last slots and lead nowhere."""
    most = int(sizes.max()) + 1
    action = torch.where(torch.arange(most) >= most - sizes[:, None], 0, NO_NODE)
    edges = torch.full((len(sizes), most, 1), NO_NODE)
    start = torch.full((len(sizes),), most - 1)
    return Graphs(action, edges, torch.zeros(len(sizes), most, 1), start)


numbers = st.floats(allow_nan=False, width=32) | st.sampled_from([0.0, -0.0, 0.5, 1e-45, 3.4e38])


@given(
    st.lists(st.tuples(numbers, st.integers(0, 70)), min_size=1, max_size=50),
    st.sampled_from([torch.float32, torch.float64]),
)
def test_ranking_is_by_fitness_then_size_then_place(
    pairs: list[tuple[float, int]], dtype: torch.dtype
) -> None:
    """Compiled and in torch."""
    values, sizes = zip(*pairs, strict=True)
    fitness, graphs = torch.tensor(values, dtype=dtype), of_sizes(torch.tensor(sizes))
    wanted = sorted(range(len(pairs)), key=lambda i: (-pairs[i][0], pairs[i][1], i))
    assert ranking(fitness, graphs).tolist() == ranked(fitness, graphs).tolist() == wanted


@pytest.mark.parametrize("rounds", [1, 2, 5])
def test_tournament_pressure(rounds: int) -> None:
    """The best of t draws from P is within the best r with probability 1 - (1 - r/P)^t."""
    order = torch.randperm(20, generator=seeded(0))
    winners = tournament(rounds)(order, torch.zeros(20, 1), 40_000, seeded(1))
    place = torch.argsort(order)[winners]
    for r in range(1, 20):
        wanted = 1 - (1 - r / 20) ** rounds
        assert (place < r).float().mean().item() == pytest.approx(wanted, abs=0.013)


def test_a_tournament_needs_somebody() -> None:
    with pytest.raises(SettingsError, match="tournament is 0; give at least 1"):
        tournament(0)


tables = st.integers(1, 5).flatmap(
    lambda b: st.lists(
        st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=b, max_size=b),
        min_size=1,
        max_size=6,
    )
)


def filtered(scores: Tensor, cases: Sequence[int]) -> list[int]:
    """Who is left after the cases in this order, told one individual at a time."""
    epsilon = deviation(scores).tolist()
    left = list(range(len(scores)))
    for case in cases:
        best = max(float(scores[i, case]) for i in left)
        left = [i for i in left if float(scores[i, case]) >= best - epsilon[case]]
    return left


def chances(scores: Tensor) -> list[float]:
    """How probably each individual is chosen, over all orders of the scenarios."""
    orders = list(permutations(range(scores.shape[1])))
    chance = [0.0] * len(scores)
    for cases in orders:
        left = filtered(scores, cases)
        for i in left:
            chance[i] += 1 / len(left) / len(orders)
    return chance


@settings(max_examples=25)
@given(tables, st.integers(0, 2**31))
def test_lexicase_chooses_only_whom_some_order_of_scenarios_leaves(
    table: list[list[float]], seed: int
) -> None:
    scores = torch.tensor(table)
    chosen = lexicase(torch.arange(len(table)), scores, 50, seeded(seed))
    assert chosen.shape == (50,)
    chance = chances(scores)
    assert all(chance[i] > 0 for i in chosen.tolist())


@pytest.mark.parametrize("seed", range(3))
def test_lexicase_chooses_as_often_as_all_orders_of_scenarios_say(seed: int) -> None:
    """And equal individuals equally often."""
    scores = torch.rand(7, 4, generator=seeded(seed))
    scores[3:5] = scores[2]
    chosen = lexicase(torch.arange(7), scores, 20_000, seeded(seed + 10))
    share = torch.bincount(chosen, minlength=7) / 20_000
    assert share.tolist() == pytest.approx(chances(scores), abs=0.015)


def test_who_alone_solves_a_hard_scenario_has_children() -> None:
    scores = torch.full((100, 8), 0.9)
    scores[3] = torch.tensor([1.0] + [0.0] * 7)  # the worst of all by the mean
    order = scores.mean(1).argsort(descending=True)
    chosen = lexicase(order, scores, 4000, seeded(0))
    assert (chosen == 3).float().mean().item() == pytest.approx(1 / 8, abs=0.02)
    assert not (tournament(5)(order, scores, 4000, seeded(0)) == 3).any()


def test_groups_give_as_many_parents_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """In groups of 50, whoever is best in its own has all of its group's children."""
    monkeypatch.setattr(sys.modules["cgtorch.evolution.selection"], "MOST_CANDIDATES", 50)
    scores = torch.rand(150, 1, generator=seeded(0))
    scores[:3, 0] = torch.tensor([9.0, 8.0, 7.0])
    shares = torch.zeros(150)
    for seed in range(60):
        chosen = lexicase(torch.arange(150), scores, 31, seeded(seed))
        assert chosen.shape == (31,)
        shares += torch.bincount(chosen, minlength=150) / 31 / 60
    # The best is in one of three groups always; the others meet a better one at times.
    alone = 1 / 3
    second = alone * (1 - 49 / 149)
    assert shares[0].item() == pytest.approx(alone, abs=0.1)
    assert shares[1].item() == pytest.approx(second, abs=0.1)
    assert 0 < shares[2].item() < shares[1].item() + 0.1


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=9))
def test_deviation_is_that_of_the_textbook(values: list[float]) -> None:
    def middle(numbers: list[float]) -> float:
        return sorted(numbers)[(len(numbers) - 1) // 2]

    scores = torch.tensor(values, dtype=torch.float64)[:, None]
    centre = middle(values)
    assert float(deviation(scores)[0]) == pytest.approx(middle([abs(v - centre) for v in values]))
