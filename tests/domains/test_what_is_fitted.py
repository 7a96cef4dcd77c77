"""Which rows Γ and C are fitted to, and which are held out, whatever they are."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rail import Cart, driven
from support import models_of, seeded

from cgtorch.domains import knowledge as learned
from cgtorch.domains.knowledge import ASIDE, FEW, SPARE, Knowledge
from cgtorch.domains.models import Models
from cgtorch.ground.environment import Dataset

COUNTS = st.integers(0, 40) | st.integers(SPARE - 12, SPARE + 12) | st.integers(FEW - 12, FEW + 12)


class Counting(Models[Any]):
    """Models that note what it is asked to fit to."""

    def __init__(self) -> None:
        super().__init__(None)
        self.fits: list[tuple[Dataset, int]] = []

    def fit_success(self, data: Dataset, seed: int) -> tuple[Any, Any]:
        self.fits.append((data, seed))
        return None, None

    def fit_transition(self, data: Dataset, seed: int) -> tuple[Any, Any]:
        self.fits.append((data, seed))
        few = SimpleNamespace(centres=[])
        return SimpleNamespace(machine=few), None


def numbered(transitions: int, tests: int, begin: int = 0) -> Dataset:
    """Rows that say which they are."""
    p, t = (torch.arange(begin, begin + n).float()[:, None] for n in (transitions, tests))
    return Dataset(p, p, p, t, t[:, 0] % 2 == 0)


def rows_of(data: Dataset) -> tuple[list[int], list[int]]:
    assert torch.equal(data.percept, data.control)
    assert torch.equal(data.percept, data.next_percept)
    assert torch.equal(data.succeeded, data.tested[:, 0] % 2 == 0)
    return data.percept[:, 0].int().tolist(), data.tested[:, 0].int().tolist()


def known(dataset: Dataset, aside: Dataset) -> Knowledge:
    nothing: Any = None
    return Knowledge(dataset, nothing, nothing, nothing, nothing, nothing, aside)


@pytest.fixture(scope="module")
def more() -> Iterator[list[tuple[Any, ...]]]:
    """What is learned in addition to what stays."""
    with pytest.MonkeyPatch.context() as patch:
        given_: list[tuple[Any, ...]] = []
        patch.setattr(learned, "learn_more", lambda *about: given_.append(about) or "more")
        yield given_


@given(COUNTS, COUNTS, st.integers(0, 99))
def test_a_tenth_is_held_out_as_soon_as_it_can_be_spared(
    transitions: int, tests: int, seed: int
) -> None:
    domain: Any = Counting()
    data = numbered(transitions, tests)
    found = domain.fit(data, seed)
    assert found.gamma is found.swift
    assert [s for _, s in domain.fits] == [seed, seed]
    assert all(fitted is found.dataset for fitted, _ in domain.fits)
    many = max(transitions, tests) >= SPARE
    rows = rows_of(found.dataset), rows_of(found.aside)
    for whole, kept, aside in zip((transitions, tests), *rows, strict=True):
        assert sorted(kept + aside) == [*range(whole)]
        assert kept == sorted(kept)
        assert len(aside) == (pytest.approx(whole / ASIDE, abs=2) if many else 0)
    assert found.acceptances is None


@given(st.tuples(*[COUNTS] * 6), st.integers(0, 2**31))
def test_few_rows_are_fitted_anew_and_to_many_more_are_added(
    more: list[tuple[Any, ...]], counts: tuple[int, ...], seed: int
) -> None:
    domain: Any = Counting()
    more.clear()
    before = known(numbered(*counts[:2]), numbered(*counts[2:4], begin=2000))
    experience, generator = numbered(*counts[4:], begin=4000), seeded(seed)
    after: Any = domain.learn(before, experience, generator)
    moves, tests = (sum(counts[i::2]) for i in (0, 1))
    if max(moves, tests) >= FEW:
        assert after == "more"
        assert not domain.fits
        ((same, new, drawn),) = more
        assert same is before
        assert new is experience
        assert drawn is generator
        return
    assert not more
    assert len(domain.fits) == 2
    assert len({s for _, s in domain.fits}) == 1
    every = rows_of(before.dataset), rows_of(before.aside), rows_of(experience)
    for i, (kept, aside) in enumerate(
        zip(rows_of(after.dataset), rows_of(after.aside), strict=True)
    ):
        assert sorted(kept + aside) == sorted(row for part in every for row in part[i])


def test_what_is_held_out_leaves_c_enough_to_learn_from() -> None:
    """Three successes among 300 tests, two of which would be held out."""
    data = driven(40, 900, 0)
    yes, no = data.tested[data.succeeded], data.tested[~data.succeeded]
    order = torch.arange(300)
    met = (order == ASIDE - 1) | (order == 2 * ASIDE - 1) | (order == 100)
    tested = no[:300].clone()
    tested[met] = yes[:3]
    rare = Dataset(data.percept, data.control, data.next_percept, tested, met)
    found = models_of(Cart()).fit(rare, 0)
    assert int(found.dataset.succeeded.sum()) >= 2
