"""Batches of scenarios, lanes and data, against the same done row by row."""

from dataclasses import dataclass, fields, replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded, world
from torch import Tensor

from cgtorch.ground.asked import Asked
from cgtorch.ground.environment import (
    Dataset,
    Lanes,
    ScenarioBatch,
    asked_of,
    rows_where,
    seeds_of,
    start_lanes,
)

NAMES = tuple(f.name for f in fields(Lanes))
seeds = st.integers(0, 2**31)


@dataclass(frozen=True)
class Places(ScenarioBatch):
    """Scenarios of two tensors."""

    place: Tensor
    seed: Tensor


def places(first: int, count: int) -> Places:
    seed = torch.arange(first, first + count)
    return Places(torch.stack([seed, -seed], 1).float(), seed)


def random_lanes(seed: int, count: int) -> Lanes:
    """Lanes of small whole numbers, so that some are equal."""
    generator = seeded(seed)

    def some(*shape: int) -> Tensor:
        return torch.randint(2, (count, *shape), generator=generator)

    floats = (some(3).float(), some(2).float(), some(4).float())
    return Lanes(*floats, some().bool(), some(2).float(), some(), some())


def test_scenarios_are_taken_and_joined_row_by_row() -> None:
    one, other = places(0, 5), places(9, 2)
    assert (len(one), len(other)) == (5, 2)
    some = one[torch.tensor([3, 1])]
    assert some.seed.tolist() == [3, 1]
    assert some.place.tolist() == [[3, -3], [1, -1]]
    assert one[1:3].seed.tolist() == [1, 2]
    joined = one.joined(other, some)
    assert joined.seed.tolist() == [0, 1, 2, 3, 4, 9, 10, 3, 1]
    assert torch.equal(joined.place[:, 1], -joined.seed.float())
    assert one.with_noise(7) is one


@given(seeds, st.integers(1, 6), st.data())
def test_rows_of_lanes_are_those_of_every_tensor(
    seed: int, count: int, data: st.DataObject
) -> None:
    one, two = random_lanes(seed, count), random_lanes(seed + 1, count)
    rows = data.draw(st.lists(st.integers(0, count - 1), unique=True))
    index = torch.tensor(rows, dtype=torch.long)
    first = data.draw(st.integers(0, count))
    some, mixed = two.rows(index), one.with_rows(index, two.rows(index))
    begin, other = one.part(slice(first, None)), one.moved(two.state, two.percept)
    assert len(one) == count
    for name in NAMES:
        mine, theirs = getattr(one, name).tolist(), getattr(two, name).tolist()
        assert getattr(some, name).tolist() == [theirs[i] for i in rows]
        wanted = [theirs[i] if i in rows else mine[i] for i in range(count)]
        assert getattr(mixed, name).tolist() == wanted
        assert getattr(begin, name).tolist() == mine[first:]
        moved = theirs if name in ("state", "percept") else mine
        assert getattr(other, name).tolist() == moved
    assert torch.equal(one.with_memory(slice(1, 2)).memory, one.memory[:, 1:])


@given(seeds, st.integers(1, 6), st.sampled_from(NAMES))
def test_lanes_differ_where_anything_but_their_steps_does(seed: int, count: int, name: str) -> None:
    one, two = random_lanes(seed, count), random_lanes(seed + 1, count)
    assert not one.differs(one).any()
    changed = replace(one, **{name: getattr(two, name)})
    rows = (getattr(one, name) != getattr(two, name)).view(count, -1).any(1)
    counts = name not in ("scenario", "step")
    assert one.differs(changed).tolist() == [counts and row for row in rows.tolist()]
    assert one.differs(changed).dtype == torch.bool
    wanted = [
        any(getattr(one, n)[i].tolist() != getattr(two, n)[i].tolist() for n in NAMES[:5])
        for i in range(count)
    ]
    assert one.differs(two).tolist() == wanted


def test_only_what_has_changed_is_written_over_lanes() -> None:
    lanes, before = random_lanes(0, 5), random_lanes(1, 2)
    kept = {name: getattr(lanes, name).clone() for name in NAMES}
    after = replace(before, memory=torch.full((2, 2), 7.0), step=before.step + 5)
    lanes.write(slice(1, 3), before, after)
    for name in NAMES:
        if name in ("memory", "step"):
            kept[name][1:3] = getattr(after, name)
        assert torch.equal(getattr(lanes, name), kept[name]), name


def test_rows_where_something_is_true() -> None:
    mask = torch.tensor([True, False, True, True])
    assert rows_where(mask).tolist() == [0, 2, 3]
    assert rows_where(~mask).tolist() == [1]
    assert rows_where(torch.zeros(3, dtype=torch.bool)).tolist() == []


def dataset(**changed: Any) -> Dataset:
    """Three transitions and two tests."""
    parts = {
        "percept": torch.arange(12.0).view(3, 4), "control": torch.ones(3, 2),
        "next_percept": -torch.arange(12.0).view(3, 4), "tested": torch.zeros(2, 4),
        "succeeded": torch.tensor([True, False]),
    }  # fmt: skip
    return Dataset(**{**parts, **changed})


def test_data_are_extended_in_order() -> None:
    one, other = dataset(), dataset(percept=torch.full((3, 4), 9.0))
    both = one.extended(other)
    for f in fields(Dataset):
        wanted = [*getattr(one, f.name).tolist(), *getattr(other, f.name).tolist()]
        assert getattr(both, f.name).tolist() == wanted
    assert both.whole(4)


@pytest.mark.parametrize(
    "changed",
    [
        {"percept": torch.zeros(2, 4)},
        {"percept": torch.zeros(3, 5)},
        {"percept": torch.zeros(3, 4, 1)},
        {"percept": torch.tensor(0.0)},
        {"percept": torch.zeros(12), "next_percept": torch.zeros(12)},
        {"percept": torch.zeros(3, 4, 1), "next_percept": torch.zeros(3, 4, 1)},
        {"next_percept": torch.zeros(3, 5)},
        {"control": torch.zeros(2, 2)},
        {"control": torch.zeros(3)},
        {"control": torch.zeros(3, 2, 1)},
        {"control": torch.zeros(3, 2, dtype=torch.float64)},
        {"tested": torch.zeros(3, 4)},
        {"tested": torch.zeros(2, 5)},
        {"tested": torch.zeros(2, 4, 1)},
        {"tested": torch.full((2, 4), torch.nan)},
        {"succeeded": torch.tensor(True)},
        {"succeeded": torch.tensor([[True], [False]])},
        {"succeeded": torch.tensor([1, 0])},
        *({name: torch.full((3, 4), torch.inf)} for name in ("percept", "next_percept", "control")),
        *({name: torch.zeros(3, 4).long()} for name in ("percept", "next_percept", "control")),
    ],
)
def test_data_that_do_not_fit_are_not_whole(changed: dict[str, Tensor]) -> None:
    assert dataset().whole()
    assert dataset().whole(4)
    assert not dataset().whole(3)
    assert not dataset(**changed).whole()


def test_fresh_lanes_know_nothing_yet() -> None:
    place, scenario = world(0, 6), torch.tensor([4, 1, 1])
    lanes = start_lanes(place, scenario, 3, 2)
    state, percept = place.start(scenario)
    assert torch.equal(lanes.percept, percept)
    assert torch.equal(lanes.state, state)
    assert torch.equal(lanes.message, torch.zeros(3, 3))
    assert torch.equal(lanes.memory, torch.zeros(3, 2))
    assert lanes.has_message.tolist() == [False] * 3
    assert lanes.scenario.tolist() == [4, 1, 1]
    assert lanes.step.tolist() == [0] * 3


def test_what_an_environment_does_not_tell_has_a_default() -> None:
    class Seeds:
        seeds = torch.tensor([50, 60, 70])

    class Counts:
        asked = Asked(steps=3)

    scenario = torch.tensor([2, 0])
    other: Any = object()
    seeded_one: Any = Seeds()
    counting: Any = Counts()
    assert seeds_of(seeded_one, scenario).tolist() == [70, 50]
    assert seeds_of(other, scenario).tolist() == [2, 0]
    assert asked_of(counting) == Asked(steps=3)
    assert asked_of(other) == Asked()
