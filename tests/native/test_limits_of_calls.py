"""What compiled code takes and refuses, and small functions of it beside those of torch."""

import pytest
import torch

from cgtorch import native
from cgtorch.evolution import compiled
from cgtorch.evolution.selection import deviation, parents
from cgtorch.ground import counter_rng
from cgtorch.native import alike, available, function, suits, threads_worth, use_threads

pytestmark = pytest.mark.skipif(not available(), reason="there is no C compiler")

FLOATS = [torch.float32, torch.float64]
NO_MEMORY, MORE_THAN_THERE_IS = 1, 2**57


def test_tensors_of_one_type_on_one_device_suit_compiled_code() -> None:
    x, y = torch.zeros(2), torch.zeros(3)
    assert suits(x)
    assert suits(x, y)
    assert suits(x.double(), y.double())
    for others in ((x, y.double()), (x.double(), y), (x.half(), y.half()), (x.long(),)):
        assert not alike(*others)
        assert not suits(*others)
    there = x.to("meta"), y.to("meta")
    assert alike(*there)
    assert not suits(*there)
    assert not alike(x, there[1])


def test_what_needs_a_gradient_does_not_suit_unless_nobody_asks_for_it() -> None:
    x, leaf = torch.zeros(2), torch.zeros(2, requires_grad=True)
    assert not suits(x, leaf)
    assert not suits(leaf)
    with torch.no_grad():
        assert suits(x, leaf)


def test_threads_are_those_of_torch_unless_others_are_set() -> None:
    assert use_threads(3) == 0
    assert native.threads() == 3
    assert [threads_worth(work, 4) for work in (0, 3, 4, 11, 12, 99)] == [1, 1, 1, 2, 3, 3]
    assert use_threads(0) == 3
    assert native.threads() == torch.get_num_threads()


@pytest.mark.parametrize("dtype", FLOATS)
def test_memory_that_there_is_not_is_told_before_anything_is_read(dtype: torch.dtype) -> None:
    much, few = MORE_THAN_THERE_IS, torch.zeros(4, dtype=dtype)
    chosen = torch.zeros(4, dtype=torch.long)
    for name, arguments in {
        "lexicase": (few, 2, much, few, 1, 1, chosen, 1),
        "deviation": (few, much, 1, few, 1),
        "ranking": (few, chosen, 1, much, chosen),
    }.items():
        call = function(name, dtype)
        assert call is not None
        assert call(*arguments) == NO_MEMORY, name
    with pytest.raises(MemoryError, match="no memory to run deviation"):
        compiled._call("deviation", dtype, few, much, 1, few, 1)


@pytest.mark.parametrize(
    ("numbers", "found"),
    [
        ([], False), ([0], False), ([1], True), ([2], False), ([0, 2, 0], False),
        ([0, 1, 2], True), ([0, -1], True), ([3], True), ([2, 9], True),
    ],
)  # fmt: skip
def test_a_flag_of_any_action_is_found_and_what_is_none_has_the_last(
    numbers: list[int], found: bool
) -> None:
    action, call = torch.tensor(numbers, dtype=torch.long), function("any_flagged", torch.float32)
    assert call is not None
    assert call(action, len(numbers), torch.tensor([0, 1, 0, 1]), 3) == found
    assert call(action, len(numbers), torch.zeros(4, dtype=torch.long), 3) == 0


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 31, 33, 1024, 1025, 5000])
@pytest.mark.parametrize("key", [0, -7, 2**62])
def test_an_order_is_that_of_torch(count: int, key: int) -> None:
    assert torch.equal(compiled.shuffled(count, key), counter_rng.shuffled(count, key))


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize(
    ("individuals", "scenarios", "levels"),
    [(300, 12, 3), (257, 3, 0), (64, 1, 2), (65, 2, 1), (33, 30, 1), (500, 40, 2), (1, 1, 1)],
)
def test_parents_of_many_are_those_of_torch(
    individuals: int, scenarios: int, levels: int, dtype: torch.dtype
) -> None:
    """Where many share their scores, more survive than there are vectors of them, or none do."""
    g = torch.Generator().manual_seed(individuals)
    scores = torch.rand(individuals, scenarios, generator=g, dtype=dtype) - 0.5
    if levels:
        scores = (scores * levels).round() / levels
    chosen = compiled.lexicase(scores, compiled.deviation(scores), 60, 5)
    assert torch.equal(chosen, parents(scores + 0.0, deviation(scores), 60, 5))
