"""Random numbers of individuals, which are functions of keys."""

import math

import pytest
import torch
from scipy.stats import kstest, norm
from support import seeded

from cgtorch.ground.counter_rng import (
    BITS,
    fields,
    keys,
    normal_from,
    random_key,
    uniform_from,
    words,
)

MANY = 20_000


def drawn(seed: int, count: int = MANY, numbers: int = 6) -> torch.Tensor:
    return words(keys(random_key(seeded(seed)), count)[:, None], torch.arange(numbers))


def test_words_are_those_of_splitmix64() -> None:
    """The published answers for a state of 1234567 (Vigna, "splitmix64.c", public domain)."""
    found = words(torch.tensor(1234567), torch.arange(5)).tolist()
    assert [word % 2**64 for word in found] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_uniform_numbers_are_uniform_and_independent() -> None:
    draws = uniform_from(drawn(0))
    assert draws.min() >= 0
    assert draws.max() < 1
    assert torch.equal(draws * 2**BITS, fields(drawn(0)).float())
    for threshold in (0.001, 0.3, 0.9):
        error = (threshold * (1 - threshold) / MANY) ** 0.5
        assert ((draws < threshold).float().mean(0) - threshold).abs().max() < 5 * error
    assert (torch.corrcoef(draws.T) - torch.eye(6)).abs().max() < 5 / MANY**0.5
    neighbours = torch.corrcoef(torch.stack([draws[:-1, 0], draws[1:, 0]]))[0, 1]
    assert abs(neighbours) < 5 / MANY**0.5


def test_a_number_is_the_same_whatever_else_is_looked_at() -> None:
    all_of_them = drawn(3)
    one = keys(random_key(seeded(3)), 100)[71]
    assert words(one, torch.tensor(4)) == all_of_them[71, 4]


def test_normal_numbers_are_normal() -> None:
    found = normal_from(drawn(1)).double()
    assert kstest(found.flatten().numpy(), norm.cdf).pvalue > 0.001
    assert (torch.corrcoef(found.T) - torch.eye(6)).abs().max() < 5 / MANY**0.5
    assert (
        abs(torch.corrcoef(torch.stack([found[:, 0], uniform_from(drawn(1))[:, 0]]))[0, 1]) < 0.05
    )


@pytest.mark.parametrize("low", [2**38, 2**39 - 1, 1000, 0, 12345678901])
def test_a_normal_number_is_the_quantile(low: int) -> None:
    chance = (2 * low + 1) / 2.0**41
    both = normal_from(torch.tensor([low, low + 2**39]))
    wanted = norm.ppf(chance)
    assert both.tolist() == pytest.approx([-wanted, wanted], rel=1e-6, abs=2e-7)
    assert math.isfinite(float(both.sum()))
