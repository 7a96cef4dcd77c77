"""The number of scenarios follows from how reliably they tell individuals apart."""

import pytest
import torch
from support import seeded
from torch import Tensor

from cgtorch.evolution.fitness import WORST
from cgtorch.improvement.spread import ENOUGH, FEWEST, MEMORY, MOST, Need, reliability


def scores(quality: float, noise: float, difficulty: float = 10.0, b: int = 16) -> Tensor:
    """Of 400 individuals, whose quality, scenarios and luck have these standard deviations."""
    generator = seeded(0)
    p = 400
    own = quality * torch.randn(p, 1, generator=generator)
    hard = difficulty * torch.randn(1, b, generator=generator)
    return own + hard + noise * torch.randn(p, b, generator=generator)


@pytest.mark.parametrize(("quality", "noise"), [(1.0, 0.0), (1.0, 4.0), (0.5, 4.0), (0.0, 1.0)])
def test_it_is_the_share_of_the_means_variance_that_is_not_luck(
    quality: float, noise: float
) -> None:
    wanted = quality**2 / (quality**2 + noise**2 / 16)
    assert reliability(scores(quality, noise)) == pytest.approx(wanted, abs=0.08)
    alone = reliability(scores(quality, noise, difficulty=0.0))
    assert alone == pytest.approx(reliability(scores(quality, noise)), abs=1e-4)


def test_too_little_says_nothing_and_equal_ones_need_no_more() -> None:
    assert reliability(torch.rand(3, 8)) == 1
    assert reliability(torch.rand(30, 1)) == 1
    assert reliability(torch.ones(30, 8)) == 1
    assert reliability(torch.eye(8)) == 0  # of equal means, by luck alone


def test_the_unfinished_are_left_out() -> None:
    some = scores(1.0, 1.0)
    unfinished = torch.full((50, 16), WORST)
    unfinished[:, 1:] = 0
    assert reliability(torch.cat([unfinished, some])) == reliability(some)


def after(need: Need, generation: Tensor, times: int) -> Need:
    for _ in range(times):
        need = need.after(generation)
    return need


def test_luck_asks_for_more_scenarios_up_to_a_limit_and_differences_for_fewer() -> None:
    more = after(Need(), scores(0.0, 1.0), 8)
    assert FEWEST < more.scenarios < MOST
    assert after(Need(), scores(0.0, 1.0), 60).scenarios == MOST
    assert after(more, scores(1.0, 0.0), 60).scenarios == FEWEST
    between = scores(1.0, 4.0)  # a reliability of a half
    assert after(more, between, 60).scenarios == after(more, between, 30).scenarios


@pytest.mark.parametrize("count", [2, 3])
def test_it_is_that_of_a_two_way_analysis_of_variance(count: int) -> None:
    """1 - 1 / F, where F compares the means of individuals with what is left beside scenarios."""
    table = torch.rand(ENOUGH, count, generator=seeded(3)).tolist()
    rows, columns = range(ENOUGH), range(count)
    mean = sum(map(sum, table)) / (ENOUGH * count)
    own = [sum(row) / count for row in table]
    hard = [sum(table[i][j] for i in rows) / ENOUGH for j in columns]
    among = count * sum((x - mean) ** 2 for x in own) / (ENOUGH - 1)
    rest = sum((table[i][j] - own[i] - hard[j] + mean) ** 2 for i in rows for j in columns)
    wanted = 1 - rest / ((ENOUGH - 1) * (count - 1)) / among
    assert reliability(torch.tensor(table)) == pytest.approx(wanted, rel=1e-5)


def test_a_step_is_a_half_more_or_a_fifth_less_within_limits() -> None:
    luck, sure = scores(0.0, 1.0, b=4), scores(1.0, 0.0, b=4)
    for count, how, wanted in (
        (10, {}, 15), (11, {}, 17), (10, {"most": 12}, 12), (10, {"most": 5}, 10),
        (MOST - 1, {"most": 2 * MOST}, MOST),
    ):  # fmt: skip
        assert Need(count, 0.0).after(luck, **how).scenarios == wanted
    for count, how, wanted in (
        (10, {}, 8),
        (11, {}, 8),
        (10, {"fewest": 9}, 9),
        (9, {"fewest": 10}, 9),
    ):
        assert Need(count, 1.0).after(sure, **how).scenarios == wanted


def test_what_is_known_of_luck_is_remembered() -> None:
    found = Need(10, 0.5).after(scores(1.0, 0.0)).reliability
    assert found == pytest.approx(MEMORY * 0.5 + 1 - MEMORY)
    opposite = torch.eye(8).repeat(1, 2) + 1e-3 * torch.rand(8, 16, generator=seeded(0))
    assert reliability(opposite) < -1
    assert Need(10, 0.5).after(opposite).reliability == pytest.approx(MEMORY * 0.5 - (1 - MEMORY))


def test_a_single_generation_does_not_change_it() -> None:
    assert Need().after(scores(0.0, 1.0)).scenarios == FEWEST
    assert Need(scenarios=40).after(scores(0.3, 1.0, b=4)).scenarios == 40
