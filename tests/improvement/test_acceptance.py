"""When a candidate replaces the skill that acts: on numbers by hand, and by exact counts."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from cgtorch.improvement.team import (
    CLEAR,
    ERRORS,
    MOST_WORSE,
    no_worse,
)

SHARE = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])


def decided(old: list[float], new: list[float], keep: list[int]) -> bool:
    return no_worse(torch.tensor(old), torch.tensor(new), torch.tensor(keep) > 0)


def test_who_is_better_elsewhere_and_the_same_on_w_is_taken() -> None:
    assert decided([1.0, 0.75, 0.0], [1.0, 0.75, 0.5], [1, 1, 0])
    assert decided([0.0, 0.0], [0.0, 0.5], [0, 0])


def test_who_is_better_nowhere_else_is_not_taken() -> None:
    assert not decided([1.0, 0.5], [1.0, 0.5], [1, 0])
    assert not decided([1.0, 0.5], [1.0, 0.25], [1, 0])
    assert not decided([0.75, 0.5], [1.0, 0.5], [1, 0])  # W alone is no reason
    assert not decided([1.0, 1.0], [1.0, 1.0], [1, 1])
    assert not decided([0.75], [1.0], [1])


def test_who_loses_much_of_w_is_not_taken_however_much_it_gains() -> None:
    for n in (1, 2, 5, 40):
        old, keep = [1.0] * n + [0.0] * 9 * n, [1] * n + [0] * 9 * n
        assert decided(old, [1.0] * 10 * n, keep)
        all_lose = [0.75] * n + [1.0] * 9 * n
        some_lose = [0.5 if i % 3 == 0 else 1.0 for i in range(n)] + [1.0] * 9 * n
        assert not decided(old, all_lose, keep)
        assert not decided(old, some_lose, keep)


def test_who_loses_a_little_of_w_is_taken_if_that_may_be_chance() -> None:
    """One of forty: the mean loss is as large as its standard error, and less than 5 %."""
    old, keep = [1.0] * 40 + [0.0] * 40, [1] * 40 + [0] * 40
    assert decided(old, [0.0] + [1.0] * 79, keep)
    # As much from all of them is no chance.
    assert not decided(old, [1 - 1 / 40] * 40 + [1.0] * 40, keep)


def plainly(old: Tensor, new: Tensor, keep: Tensor) -> bool:
    """The rule in so many words."""

    def mean(values: list[float]) -> float:
        return sum(values) / len(values)

    def error(values: list[float]) -> float:
        return (mean([(x - mean(values)) ** 2 for x in values]) / len(values)) ** 0.5

    rows = range(len(keep))
    change = [float(new[i] - old[i]) for i in rows]
    inside = [change[i] for i in rows if keep[i]]
    outside = [change[i] for i in rows if not keep[i]]
    if inside and mean(inside) < -min(ERRORS * error(inside), MOST_WORSE) - 1e-6:
        return False
    return sum(outside) > 0 and mean(change) > CLEAR * error(change)


@given(st.lists(st.tuples(SHARE, SHARE, st.booleans()), min_size=1, max_size=30))
def test_the_rule_is_what_it_is_said_to_be(rows: list[tuple[float, float, bool]]) -> None:
    old, new, keep = (torch.tensor([row[i] for row in rows]) for i in range(3))
    found = no_worse(old, new, keep.bool())
    assert found == plainly(old, new, keep.bool())
    change = new - old
    assert not found or (change[~keep.bool()].sum() > 0 and change.sum() > 0)
    enough = float(change.mean())
    assert no_worse(old, new, keep.bool(), enough - 0.01) is found
    assert not no_worse(old, new, keep.bool(), enough + 0.01)
