from collections.abc import Sequence
from itertools import permutations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded
from torch import Tensor

from cgtorch.errors import SettingsError
from cgtorch.evolution.selection import deviation, lexicase, ranking, tournament

tables = st.integers(1, 5).flatmap(
    lambda b: st.lists(
        st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=b, max_size=b),
        min_size=1,
        max_size=6,
    )
)


@given(st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0]), st.integers(1, 3)), min_size=1))
def test_ranking_is_by_fitness_then_size_then_place(pairs: list[tuple[float, int]]) -> None:
    fitness, size = (torch.tensor(x) for x in zip(*pairs, strict=True))
    wanted = sorted(range(len(pairs)), key=lambda i: (-pairs[i][0], pairs[i][1], i))
    assert ranking(fitness, size).tolist() == wanted


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


@given(tables, st.integers(0, 2**31))
def test_lexicase_chooses_only_whom_some_order_of_scenarios_leaves(
    table: list[list[float]], seed: int
) -> None:
    scores = torch.tensor(table)
    chosen = lexicase(torch.arange(len(table)), scores, 50, seeded(seed))
    assert chosen.shape == (50,)
    assert all(chances(scores)[i] > 0 for i in chosen.tolist())


@pytest.mark.parametrize("seed", range(3))
def test_lexicase_chooses_as_often_as_all_orders_of_scenarios_say(seed: int) -> None:
    scores = torch.rand(7, 4, generator=seeded(seed))
    chosen = lexicase(torch.arange(7), scores, 20_000, seeded(seed + 10))
    share = torch.bincount(chosen, minlength=7) / 20_000
    assert share.tolist() == pytest.approx(chances(scores), abs=0.015)


def test_who_alone_solves_a_hard_scenario_has_children() -> None:
    scores = torch.full((100, 8), 0.9)
    scores[3] = torch.tensor([1.0] + [0.0] * 7)  # the worst of all by the mean
    order = ranking(scores.mean(1), torch.ones(100))
    chosen = lexicase(order, scores, 4000, seeded(0))
    assert (chosen == 3).float().mean().item() == pytest.approx(1 / 8, abs=0.02)
    assert not (tournament(5)(order, scores, 4000, seeded(0)) == 3).any()


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=9))
def test_deviation_is_that_of_the_textbook(values: list[float]) -> None:
    def middle(numbers: list[float]) -> float:
        return sorted(numbers)[(len(numbers) - 1) // 2]

    scores = torch.tensor(values, dtype=torch.float64)[:, None]
    centre = middle(values)
    assert float(deviation(scores)[0]) == pytest.approx(middle([abs(v - centre) for v in values]))
