"""Random numbers of scenarios and of individuals: published answers, and what they depend on."""

import zlib

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, norm
from support import seeded

from cgtorch.evolution import compiled
from cgtorch.ground.counter_rng import (
    BITS,
    fields,
    individual_words,
    keys,
    normal,
    normal_from,
    nth_true,
    pick,
    random_key,
    shuffled,
    threefry,
    uniform,
    uniform_from,
    words,
)

MANY = 20_000


def pair(numbers: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor([numbers[0]]), torch.tensor([numbers[1]])


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [  # "threefry2x32 20" in the file kat_vectors of Random123
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
        ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
    ],
)
def test_the_published_answers_of_threefry(
    counter: tuple[int, int], key: tuple[int, int], expected: tuple[int, int]
) -> None:
    first, second = threefry(pair(key), pair(counter))
    assert (int(first), int(second)) == expected


@given(
    n=st.integers(1, 40),
    size=st.integers(1, 7),
    row=st.integers(0, 39),
    high=st.sampled_from([1, 2**31, 2**62]),
)
def test_a_row_alone_gets_the_same_numbers(n: int, size: int, row: int, high: int) -> None:
    seed = torch.randint(high, (n,), generator=seeded(n))
    count = torch.randint(400, (n,), generator=seeded(n))
    one = slice(row % n, row % n + 1)
    whole = uniform(seed, "Wander", count, size)
    assert torch.equal(uniform(seed[one], "Wander", count[one], size), whole[one])
    assert torch.equal(uniform(seed, "Wander", count, size + 1)[:, :size], whole)
    even = uniform(seed, "Wander", count, 2 * size)
    assert torch.equal(normal(even[one]), normal(even)[one])
    assert torch.equal(normal(even[one].double()), normal(even.double())[one])


def test_seed_name_and_count_all_matter() -> None:
    seed, nothing = torch.arange(200), torch.zeros(200, dtype=torch.long)
    every = [
        uniform(seed, "Wander", nothing, 2),
        uniform(seed, "Search", nothing, 2),
        uniform(seed, "Wander", nothing + 1, 2),
        uniform(seed + 2**40, "Wander", nothing, 2),
    ]
    numbers = torch.cat(every).flatten()
    assert len(numbers.unique()) > len(numbers) - 3


def test_numbers_of_scenarios_are_uniform_and_normal() -> None:
    seed = torch.arange(MANY)
    drawn = uniform(seed, "a", torch.zeros_like(seed), 4)
    assert drawn.min() >= 0
    assert drawn.max() < 1
    assert torch.corrcoef(drawn.T).fill_diagonal_(0).abs().max() < 0.03
    values = normal(drawn)
    assert all(kstest(column.numpy(), "uniform").pvalue > 0.001 for column in drawn.T)
    assert all(kstest(column.numpy(), norm.cdf).pvalue > 0.001 for column in values.T)
    ends = torch.tensor([[0.0, 0.0], [1 - 2.0**-24, 1 - 2.0**-24]])
    assert normal(ends).isfinite().all()


def individuals(seed: int) -> torch.Tensor:
    return words(keys(random_key(seeded(seed)), MANY)[:, None], torch.arange(6))


def test_words_are_those_of_splitmix64() -> None:
    """The published answers for a state of 1234567 (Vigna, "splitmix64.c", public domain)."""
    found = words(torch.tensor(1234567), torch.arange(3)).tolist()
    assert [word % 2**64 for word in found] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
    ]


def test_numbers_of_individuals_are_uniform_normal_and_independent() -> None:
    every = individuals(0)
    draws, found = uniform_from(every), normal_from(every).double()
    assert draws.min() >= 0
    assert draws.max() < 1
    assert torch.equal(draws * 2**BITS, fields(every).float())
    assert kstest(draws.flatten().numpy(), "uniform").pvalue > 0.001
    assert kstest(found.flatten().numpy(), norm.cdf).pvalue > 0.001
    neighbours = torch.stack([draws[:-1, 0], draws[1:, 0], found[:-1, 0].float()])
    for numbers, size in ((draws.T, 6), (found.T, 6), (neighbours[:2], 2)):
        assert (torch.corrcoef(numbers) - torch.eye(size)).abs().max() < 5 / MANY**0.5
    assert torch.corrcoef(neighbours)[0, 2].abs() < 0.05
    one = keys(random_key(seeded(0)), 100)[71]
    assert words(one, torch.tensor(4)) == every[71, 4]


@pytest.mark.parametrize("low", [2**38, 2**39 - 1, 1000, 0, 12345678901])
def test_a_normal_number_is_the_quantile(low: int) -> None:
    wanted = norm.ppf((2 * low + 1) / 2.0**41)
    both = normal_from(torch.tensor([low, low + 2**39])).tolist()
    assert both == pytest.approx([-wanted, wanted], rel=1e-6, abs=2e-7)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 65, 1000, 5000])
def test_an_order_has_every_number_once(count: int) -> None:
    one, other = shuffled(count, 1), shuffled(count, -7)
    assert torch.equal(one.sort().values, torch.arange(count))
    assert torch.equal(one, shuffled(count, 1))
    assert torch.equal(one, compiled.shuffled(count, 1, torch.device("cpu")))
    assert count < 5 or not torch.equal(one, other)


def test_every_number_comes_everywhere() -> None:
    times = 1500
    places = torch.stack([shuffled(10, key) for key in range(times)])
    counts = torch.stack([(places == i).sum(0) for i in range(10)])
    assert (counts - times / 10).abs().max() < 5 * (times / 10) ** 0.5
    together = (places[:, 0] == 3) & (places[:, 1] == 4)
    assert float(together.float().mean()) == pytest.approx(1 / 90, abs=0.01)


@given(
    seed=st.integers(0, 2**62), count=st.integers(0, 2**34), size=st.integers(1, 5),
    who=st.text(max_size=4),
)  # fmt: skip
def test_numbers_of_a_scenario_are_the_words_of_its_seed_name_and_count(
    seed: int, count: int, size: int, who: str
) -> None:
    found = uniform(torch.tensor([seed]), who, torch.tensor([count]), size)
    key = pair((seed % 2**32, seed >> 32 ^ zlib.crc32(who.encode())))
    both = [threefry(key, pair((count % 2**32, block))) for block in range(3)]
    wanted = [int(word) // 256 / 2**24 for drawn in both for word in drawn][:size]
    assert found.tolist() == [wanted]
    assert found.dtype == torch.float32


def test_parts_of_an_individuals_words_follow_one_another() -> None:
    parts = individual_words(12345, 4, [3, 0, 2])
    assert [tuple(part.shape) for part in parts] == [(4, 3), (4, 0), (4, 2)]
    whole = words(keys(12345, 4)[:, None], torch.arange(5))
    assert torch.equal(torch.cat(parts, 1), whole)
    assert torch.equal(keys(12345, 9)[:4], keys(12345, 4))


def test_a_place_is_picked_by_its_share() -> None:
    draw = torch.arange(8) / 8
    assert pick(draw, 4).tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert pick(draw[-1:], torch.tensor([0])).tolist() == [0]
    largest = torch.tensor([1 - 2.0**-24])
    assert pick(largest, 2**24 + 3).tolist() == [2**24 + 2]  # which would round up to the count
    assert pick(largest, torch.tensor([5, 1])).tolist() == [4, 0]


def test_of_what_is_true_each_comes_with_its_share() -> None:
    mask = torch.tensor([[True, False, True, True], [False] * 4, [False, True, False, False]])
    draw = torch.tensor([0.0, 0.4, 0.5, 0.9]).expand(3, -1)
    assert nth_true(mask, draw).tolist() == [[0, 2, 2, 3], [0] * 4, [1] * 4]
    square = draw.reshape(3, 2, 2)
    assert torch.equal(nth_true(mask, square), nth_true(mask, draw).view(3, 2, 2))
