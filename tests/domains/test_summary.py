"""What is told of models in words and numbers, given what their fits found."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rail import Cart, driven
from support import models_of

from cgtorch.domains.knowledge import SHOWN, Knowledge, rows_of, scalars_of, summary_of
from cgtorch.ground.statistics import Acceptance


@pytest.fixture(scope="module")
def known() -> Knowledge:
    return models_of(Cart()).fit(driven(60, 80, 0), 0)


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
    told = summary_of(with_numbers(known, ("lamp", 0.1234, "rad"), ("gear", 2.0, "")))
    right = 100 * known.classifier_report.balanced_accuracy
    assert told.text == (
        f"Γ errs by 2 on gear, 0.12 rad on lamp, the balanced accuracy of C is {right:.1f} %; "
        "60 transitions and 80 labels"
    )
    assert told.first
    assert told.curves == {
        "gamma": known.gamma_report.learning_curve,
        "classifier": known.classifier_report.learning_curve,
    }
    assert told.reliability == known.classifier_report.reliability


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
    assert scalars["models/rows"] == 60
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
        f"{said[gamma].format('Γ')}; {said[classifier].format('C')}; "
        "now from 60 transitions and 80 labels"
    )
    assert not told.first
    assert told.scalars == {"models/rows": 60}
    assert not told.curves


def test_rows_are_those_that_were_learned_from(known: Knowledge) -> None:
    assert rows_of(known) == "60 transitions and 80 labels"
    doubled = known.dataset.extended(known.dataset)
    assert rows_of(replace(known, dataset=doubled)) == "120 transitions and 160 labels"
    assert torch.equal(doubled.percept[60:], known.dataset.percept)
