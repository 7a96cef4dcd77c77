"""Γ and C of a domain: which rows they are fitted to, how they learn on, and what is told."""

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rail import LAMP, Cart, SeeingCart, driven
from support import models_of, seeded

from cgtorch.domains import knowledge as learned
from cgtorch.domains.knowledge import (
    ASIDE,
    FEW,
    MOST_NEW,
    SHOWN,
    SPARE,
    Knowledge,
    learn_more,
    rows_of,
    sampled,
    scalars_of,
    summary_of,
)
from cgtorch.domains.models import Models
from cgtorch.ground.environment import Dataset
from cgtorch.ground.statistics import Acceptance


def test_models_are_fitted_with_the_features_of_their_domain() -> None:
    data = driven(80, 120, 1)
    knowledge = models_of(SeeingCart()).fit(data, 0)
    assert type(knowledge.gamma).__name__ == "KernelTransitionModel"
    assert len(knowledge.dataset.percept) == knowledge.gamma_report.rows == 80
    assert len(knowledge.dataset.tested) == knowledge.classifier_report.rows == 120
    assert len(knowledge.aside.percept) == len(knowledge.aside.tested) == 0
    assert knowledge.acceptances is None
    assert knowledge.gamma.features(data.percept, data.control).shape[1] == 10
    assert knowledge.classifier.features(data.tested).shape[1] == 6


@pytest.mark.parametrize(("most", "worse"), [(60, 1.6), (5000, 1.0)])
def test_good_data_are_taken(
    known: Knowledge, monkeypatch: pytest.MonkeyPatch, most: int, worse: float
) -> None:
    """New rows follow the old ones, or a coreset of them where these are too many."""
    for name in ("MOST_TRANSITIONS", "MOST_LABELS"):
        monkeypatch.setattr(learned, name, most)
    new, fresh = (driven(300, 300, s) for s in (3, 4))
    after = learn_more(known, new, seeded(5))
    assert after.acceptances is not None
    assert all(a.accepted for a in after.acceptances)
    assert errors(after, fresh) < worse * errors(known, fresh)
    assert after.gamma_report is known.gamma_report
    for name, rows in vars(known.aside).items():
        assert torch.equal(vars(after.aside)[name][: len(rows)], rows)
    gained = [len(vars(d).get("percept")) for d in (known.aside, after.aside)]
    assert 0 < gained[1] - gained[0] <= MOST_NEW // ASIDE
    new_rows = MOST_NEW - (gained[1] - gained[0])
    kept = min(most, len(known.dataset.percept))
    assert len(after.dataset.percept) == kept + new_rows
    if most > kept:
        for name, rows in vars(known.dataset).items():
            assert torch.equal(vars(after.dataset)[name][: len(rows)], rows)


def test_nothing_experienced_changes_nothing_much(known: Knowledge) -> None:
    data = known.dataset
    after = learn_more(known, Dataset(*(rows[:0] for rows in vars(data).values())), seeded(0))
    said = (each.gamma(data.percept, data.control) for each in (after, known))
    torch.testing.assert_close(*said, atol=0.01, rtol=0)
    assert len(after.dataset.percept) == len(data.percept)


def test_few_rows_are_all_fitted_anew(known: Knowledge) -> None:
    """With hyper-parameters of their own, and errors that are cross-validated again."""
    new, fresh = (driven(300, 300, s) for s in (3, 4))
    after = models_of(Cart()).learn(known, new, seeded(5))
    assert after.acceptances is None
    rows = len(after.dataset.percept), len(after.dataset.tested)
    assert rows == (after.gamma_report.rows, after.classifier_report.rows)
    assert rows == pytest.approx((540, 540), abs=2)
    assert rows[0] + len(after.aside.percept) == rows[1] + len(after.aside.tested) == 600
    assert errors(after, fresh) < errors(known, fresh)
    assert sum(after.gamma_report.error) < sum(known.gamma_report.error)


def errors(knowledge: Knowledge, data: Dataset) -> float:
    gamma = knowledge.gamma
    with torch.no_grad():
        return float(gamma.errors(gamma(data.percept, data.control), data.next_percept).mean())


def test_wrong_data_are_refused_and_leave_everything_as_it_was(
    known: Knowledge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned, "MOST_NEW", 300)
    new = driven(300, 300, 3)
    wrong = replace(new, control=-new.control, succeeded=~new.succeeded)
    after = learn_more(known, wrong, seeded(5))
    assert after.acceptances is not None
    for each in after.acceptances:
        assert not each.accepted
        assert each.after > each.before
        assert "refused" in each.reason
    for name in ("gamma", "swift", "classifier"):
        assert getattr(after, name) is getattr(known, name)
    for old, now in ((known.dataset, after.dataset), (known.aside, after.aside)):
        assert all(torch.equal(rows, vars(now)[name]) for name, rows in vars(old).items())


def test_a_refused_update_loses_no_rows(known: Knowledge, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though a coreset was made for it, which is smaller."""
    monkeypatch.setattr(learned, "MOST_NEW", 300)
    monkeypatch.setattr(learned, "MOST_TRANSITIONS", len(known.dataset.percept) - 20)
    monkeypatch.setattr(learned, "MOST_LABELS", len(known.dataset.tested) - 20)
    new = driven(300, 300, 3)
    wrong = replace(new, control=-new.control, succeeded=~new.succeeded)
    after = learn_more(known, wrong, seeded(5))
    assert after.acceptances is not None
    assert not any(each.accepted for each in after.acceptances)
    assert all(torch.equal(a, b) for a, b in zip(*map(every_row, (known, after)), strict=True))


def every_row(knowledge: Knowledge) -> list[torch.Tensor]:
    return list(vars(knowledge.dataset).values())


def test_tests_that_were_got_wrong_are_learned_first(
    known: Knowledge, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[torch.Tensor]()

    def noted(dataset: Dataset, surprise: torch.Tensor, *how: Any) -> Dataset:
        asked.append(surprise)
        return sampled(dataset, surprise, *how)

    monkeypatch.setattr(learned, "sampled", noted)
    data = driven(60, 60, 4)
    with torch.no_grad():
        right = (known.classifier(data.tested) > 0.5) == data.succeeded
    assert right[:40].any()
    wrong = torch.arange(60) < 7
    truth = torch.where(right == wrong, ~data.succeeded, data.succeeded)
    learn_more(known, replace(data, succeeded=truth), seeded(0))
    assert torch.equal(asked[0], wrong)


def test_errors_of_an_angle_go_the_shorter_way() -> None:
    gamma = models_of(Cart())._transition_model()
    one, other = torch.zeros(1, 4), torch.zeros(1, 4)
    one[:, LAMP], other[:, LAMP] = 3.0, -3.0
    assert gamma.difference(one, other)[0, LAMP].item() == pytest.approx(2 * torch.pi - 6, abs=1e-6)
    assert gamma.difference(other, one)[0, LAMP].item() == pytest.approx(6 - 2 * torch.pi, abs=1e-6)


@given(st.integers(0, 30), st.integers(0, 20), st.integers(0, 2**31))
def test_samples(most: int, odd: int, seed: int) -> None:
    """So many transitions, so many grasps that were a surprise, and so many others."""
    rows = torch.arange(30.0)[:, None]
    data = Dataset(rows, rows + 100, rows + 200, rows[:20], torch.arange(20) % 2 == 0)
    some = sampled(data, torch.arange(20) < odd, most, seeded(seed))
    assert len(some.percept) == min(most, 30)
    assert len(set(some.percept[:, 0].tolist())) == len(some.percept)
    assert torch.equal(some.control, some.percept + 100)
    assert torch.equal(some.next_percept, some.percept + 200)
    grasps = some.tested[:, 0]
    assert int((grasps < odd).sum()) == min(most, odd)
    assert int((grasps >= odd).sum()) == min(most, 20 - odd)
    assert len(set(grasps.tolist())) == len(grasps)
    assert torch.equal(some.succeeded, grasps % 2 == 0)
    assert (grasps[: min(most, odd)] < odd).all()  # surprises come first


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


def rows_in(data: Dataset) -> tuple[list[int], list[int]]:
    assert torch.equal(data.percept, data.control)
    assert torch.equal(data.percept, data.next_percept)
    assert torch.equal(data.succeeded, data.tested[:, 0] % 2 == 0)
    return data.percept[:, 0].int().tolist(), data.tested[:, 0].int().tolist()


def knowing(dataset: Dataset, aside: Dataset) -> Knowledge:
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
    rows = rows_in(found.dataset), rows_in(found.aside)
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
    before = knowing(numbered(*counts[:2]), numbered(*counts[2:4], begin=2000))
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
    every = rows_in(before.dataset), rows_in(before.aside), rows_in(experience)
    for i, (kept, aside) in enumerate(
        zip(rows_in(after.dataset), rows_in(after.aside), strict=True)
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


def with_numbers(known: Knowledge, *numbers: tuple[str, float, str]) -> Knowledge:
    """The same with other names, errors and units of a percept."""
    names, errors, units = zip(*numbers, strict=True)
    report: Any = replace(
        known.gamma_report,
        coordinates=names,
        error=errors,
        baseline_error=(4.0,) * len(names),
        units=units,
    )
    return replace(known, gamma_report=report)


def test_first_models_are_told_of_with_their_errors(known: Knowledge) -> None:
    renamed = with_numbers(known, ("lamp", 0.1234, "rad"), ("gear", 2.0, ""))
    told = summary_of(renamed)
    right = 100 * known.classifier_report.balanced_accuracy
    assert told.text == (
        f"Γ errs by 2 on gear, 0.12 rad on lamp, the balanced accuracy of C is {right:.1f} %; "
        f"{len(known.dataset.percept)} transitions and {len(known.dataset.tested)} labels"
    )
    assert told.first
    assert told.reports["gamma"] is renamed.gamma_report
    assert told.reports["classifier"] is known.classifier_report


@given(st.integers(1, 20))
def test_of_many_numbers_some_are_told(known: Knowledge, count: int) -> None:
    told = summary_of(with_numbers(known, *((f"x{i}", 1.0, "m") for i in range(count))))
    assert told.text.count(" m on x") == min(count, SHOWN)
    others = f" and less on {count - SHOWN} others (see TensorBoard), the balanced"
    assert (others in told.text) == (count > SHOWN)
    assert "\n" not in told.text


def test_scalars_have_tags_without_spaces(known: Knowledge) -> None:
    scalars = scalars_of(with_numbers(known, ("object x", 0.5, "m"), ("gear", 2.0, "")))
    assert scalars["gamma/error_object_x"] == 0.5
    assert scalars["gamma/error_gear"] == 2.0
    assert scalars["models/rows"] == len(known.dataset.percept)
    report = known.classifier_report
    assert scalars["classifier/balanced_accuracy"] == report.balanced_accuracy
    assert scalars["classifier/calibration_error"] == report.calibration_error
    assert len(scalars) == 5
    assert not any(" " in tag for tag in scalars)


@pytest.mark.parametrize("gamma", [True, False])
@pytest.mark.parametrize("classifier", [True, False])
def test_later_it_is_told_what_was_accepted(
    known: Knowledge, gamma: bool, classifier: bool
) -> None:
    accepted = tuple(Acceptance(yes, 9, 0.25, 0.5, 0.125) for yes in (gamma, classifier))
    told = summary_of(replace(known, acceptances=accepted))
    said = {
        True: "{} was trained on more data",
        False: "{} stays as it was, since its error on earlier data would be 0.5000 instead of "
        "0.2500",
    }
    assert told.text == (
        f"{said[gamma].format('Γ')}; {said[classifier].format('C')}; now from {rows_of(known)}"
    )
    assert not told.first
    assert told.reports["gamma"] is known.gamma_report  # of the last cross-validation
    assert told.scalars == {"models/rows": len(known.dataset.percept)}
