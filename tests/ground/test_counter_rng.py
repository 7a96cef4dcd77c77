"""Random numbers that belong to a scenario: the published generator, and what they depend on."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cgtorch.evolution import compiled
from cgtorch.ground.counter_rng import normal, shuffled, threefry, uniform

KNOWN = [  # "threefry2x32 20" in the file kat_vectors of Random123: counter, key, result
    ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
    ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
    ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
]


def words(numbers: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor([numbers[0]]), torch.tensor([numbers[1]])


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_the_published_answers(
    counter: tuple[int, int], key: tuple[int, int], expected: tuple[int, int]
) -> None:
    first, second = threefry(words(key), words(counter))
    assert (int(first), int(second)) == expected


@given(
    n=st.integers(1, 40),
    size=st.integers(1, 7),
    row=st.integers(0, 39),
    high=st.sampled_from([1, 2**31, 2**62]),
)
def test_a_row_alone_gets_the_same_numbers(n: int, size: int, row: int, high: int) -> None:
    generator = torch.Generator().manual_seed(n)
    seed = torch.randint(high, (n,), generator=generator)
    count = torch.randint(400, (n,), generator=generator)
    one = slice(row % n, row % n + 1)
    whole = uniform(seed, "Wander", count, size)
    assert torch.equal(uniform(seed[one], "Wander", count[one], size), whole[one])
    assert torch.equal(uniform(seed, "Wander", count, size + 1)[:, :size], whole)
    even = uniform(seed, "Wander", count, 2 * size)
    assert torch.equal(normal(even[one]), normal(even)[one])
    assert torch.equal(normal(even[one].double()), normal(even.double())[one])


def test_seed_name_and_count_all_matter() -> None:
    seed, nothing = torch.arange(200), torch.zeros(200, dtype=torch.long)
    far = seed + 2**40
    every = [
        uniform(seed, "Wander", nothing, 2),
        uniform(seed, "Search", nothing, 2),
        uniform(seed, "Wander", nothing + 1, 2),
        uniform(far, "Wander", nothing, 2),
    ]
    numbers = torch.cat(every).flatten()
    assert len(numbers.unique()) > len(numbers) - 3


def test_uniform_and_normal_numbers_are_that() -> None:
    seed = torch.arange(20_000)
    drawn = uniform(seed, "a", torch.zeros_like(seed), 4)
    assert drawn.min() >= 0
    assert drawn.max() < 1
    for column in drawn.T:  # Kolmogorov and Smirnov's bound at the 0.1 % level
        steps = (torch.arange(len(seed)) + 0.5) / len(seed)
        assert (column.sort().values - steps).abs().max() < 1.95 / len(seed) ** 0.5
    assert torch.corrcoef(drawn.T).fill_diagonal_(0).abs().max() < 0.03
    values = normal(drawn)
    assert values.isfinite().all()
    expected = torch.distributions.Normal(0.0, 1.0).cdf(values)
    for column in expected.T:
        assert (column.sort().values - steps).abs().max() < 1.95 / len(seed) ** 0.5


def test_the_ends_of_the_interval_give_finite_normal_numbers() -> None:
    ends = torch.tensor([[0.0, 0.0], [1 - 2.0**-24, 1 - 2.0**-24]])
    assert normal(ends).isfinite().all()


@pytest.mark.parametrize("count", [1, 2, 3, 7, 64, 65, 1000, 5000])
def test_an_order_has_every_number_once(count: int) -> None:
    one, other = shuffled(count, 1), shuffled(count, -7)
    assert torch.equal(one.sort().values, torch.arange(count))
    assert torch.equal(one, shuffled(count, 1))
    assert count < 5 or not torch.equal(one, other)


def test_every_number_comes_everywhere() -> None:
    places = torch.stack([shuffled(10, key) for key in range(4000)])
    counts = torch.stack([(places == i).sum(0) for i in range(10)])
    assert (counts - 400).abs().max() < 5 * 400**0.5
    together = (places[:, 0] == 3) & (places[:, 1] == 4)
    assert float(together.float().mean()) == pytest.approx(1 / 90, abs=0.006)


def test_compiled_orders_are_the_same() -> None:
    for count in (1, 5, 4096, 10_001):
        assert torch.equal(compiled.shuffled(count, -123), shuffled(count, -123))
