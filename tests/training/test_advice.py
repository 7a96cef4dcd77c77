"""What is blamed and advised, in sentences about failures whose causes are known."""

from dataclasses import replace

import pytest
import torch
from reaching import TABLE
from walking import Walking

from cgtorch.domains.failures import CAUSES, Cause, Failure, Failures, Searched, Tried
from cgtorch.domains.way import Act, Motion, Way
from cgtorch.training.advice import (
    TOLD,
    about_gamma,
    about_search,
    advice_about,
    blame_of,
    unskilled,
    worst_of,
    wrong_numbers,
)
from cgtorch.training.evaluate import Score

ZERO = torch.zeros(7)
NAMES = [field.name for field in TABLE.percept]


def motion(*errors: float, novelty: float | None = 0.0) -> Motion:
    """A motion after which Γ errs by so much in the numbers of a percept."""
    return Motion(ZERO[:3], ZERO, ZERO, max(errors), torch.tensor(errors), novelty)


def kind(cause: str, count: int, *acts: tuple[Motion, ...], first: int = 0) -> Failure:
    """So many failures because of a cause, after acts with these motions."""
    numbers = tuple(range(first, first + count))
    way = Way(ZERO, tuple(Act("Step", "success", ZERO, motions) for motions in acts), "failure")
    return Failure("failure", "Step → success", numbers, (Cause(cause, numbers),), (), way)


def failing(*causes: str) -> Failures:
    """Failures of which one has the first cause, two the second, and so on."""
    kinds = tuple(kind(cause, count) for count, cause in enumerate(causes, 1))
    return Failures("any", looked=sum(range(len(causes) + 1)), kinds=kinds)


def test_without_failures_nobody_is_to_blame() -> None:
    assert blame_of(failing(), modelled=True) == blame_of(failing(), modelled=False) == ""


@pytest.mark.parametrize(
    ("causes", "modelled", "blame"),
    [
        (
            ("gamma", "classifier", "search"),
            True,
            "The models are to blame for 3 of 6 (Γ for 1, C for 2): there the skill succeeds in Γ "
            "and C, but not in the world. The search is to blame for 3 of 6: there the skill fails "
            "in Γ and C, too.",
        ),
        (
            ("classifier",),
            True,
            "The models are to blame for 1 of 1 (C for 1): there the skill succeeds in Γ and C, "
            "but not in the world.",
        ),
        (
            ("open", "unreachable"),
            True,
            "For 1 of 3 it is open: the models in which the skill was evolved are not in the run's "
            "folder, or have rewards, so they are not asked here. Neither is to blame for 2 that "
            "nothing can solve.",
        ),
        (
            ("world", "limit", "noise"),
            False,
            "The skill was evolved in the world itself, so no model is to blame. The search is to "
            "blame for 1 of 6: it has found nothing better. Neither is to blame for 3 that the "
            "skill solves under most other noise, 2 that it solves with more transitions.",
        ),
    ],
)
def test_who_is_to_blame_for_how_many(causes: tuple[str, ...], modelled: bool, blame: str) -> None:
    assert blame_of(failing(*causes), modelled) == blame


SOME = Score(None, torch.zeros(2, 7), torch.tensor([True, False]))


def test_each_cause_has_advice_and_the_most_frequent_comes_first() -> None:
    found = failing(*CAUSES)
    said = advice_about(found, TABLE, SOME, None)
    assert [(each.cause, each.count) for each in said] == list(found.causes().items())
    assert [each.count for each in said] == sorted((each.count for each in said), reverse=True)
    texts = {each.cause: each.text for each in said}
    for cause, part in {
        "unreachable": "so leave such scenarios out",
        "noise": "More practice (--practice)",
        "limit": "raise --max-transitions",
        "gamma": "small errors of Γ add up",
        "classifier": "C says success where a test in the world fails",
        "search": "Go on training",
        "world": "Go on training",
        "open": "Evaluate the run where its models are",
    }.items():
        assert part in texts[cause]


def test_what_succeeds_when_it_is_met_again_is_said_to_be_luck() -> None:
    found = replace(failing("search"), lucky=3)
    *_, last = advice_about(found, TABLE, SOME, None)
    assert (last.cause, last.count) == ("noise", 3)
    assert last.text.startswith("They succeeded when they were met again")


@pytest.mark.parametrize(("mean", "reached"), [(0.001, True), (0.5, True), (-0.001, False)])
def test_a_mean_that_reaches_the_target_needs_no_other_advice(mean: float, reached: bool) -> None:
    """Less its standard error, which is 1 here, and unless nothing fails."""
    score = replace(SOME, returns=torch.tensor([mean - 1, mean + 1]))
    found = replace(failing("world"), tried=(Tried("any", 2, 1),))
    said = advice_about(found, Walking(), score, None)
    assert [each.cause for each in said] == ["goal" if reached else "world"]
    if reached:
        assert f"the mean return of {mean:.5g} reaches the target of -1," in said[0].text
    none = Failures("any", tried=(Tried("any", 2, 2),))
    assert advice_about(none, Walking(), score, None) == ()


def test_the_numbers_about_which_gamma_errs_are_named_with_the_step() -> None:
    """Those that are usual are left out, but for the worst."""
    far, near = motion(0, 3, 1, 0, 2, 0, 0, novelty=0.6), motion(0, 0.5, 0, 9, 0, 0, 0)
    calm = motion(0.1, 0.9, 0, 0, 0, 0, 0)
    assert worst_of((calm, near, far)) is near
    assert worst_of((replace(calm, error=None), far)) is far
    assert wrong_numbers(far, TABLE) == [NAMES[1], NAMES[4]]
    assert wrong_numbers(calm, TABLE) == [NAMES[1]]
    assert wrong_numbers(motion(2, 3, 4, 5, 6, 7, 8), TABLE) == [NAMES[6], NAMES[5], NAMES[4]]
    assert wrong_numbers(motion(0, 5, 7), TABLE) == ["number 2", "number 1"]
    assert wrong_numbers(replace(near, errors=None), TABLE) == []
    found = Failures("any", kinds=(
        kind("search", 9, (far,)),
        kind("gamma", 5, (calm,), (calm, far)),
        kind("gamma", 4, (), (near,)),
        kind("gamma", 3, (calm,)),
        kind("gamma", 2, (far,)),
    ))  # fmt: skip
    first, second, third = about_gamma(found, TABLE)
    assert TOLD == 3
    assert first.startswith(f"In kind 2 Γ is wrong about {NAMES[1]}, {NAMES[4]} in step 1; there")
    assert "there are no data like it" in first
    assert second.startswith(f"In kind 3 Γ is wrong about {NAMES[3]} in step 1; although there")
    assert third.startswith("In kind 4 no prediction is far off: small errors of Γ add up")


def test_at_the_edge_of_the_data_of_gamma_there_are_data_like_it() -> None:
    for novelty, told in ((0.5, "although there are data"), (0.51, "no data"), (None, "although")):
        found = Failures("any", kinds=(kind("gamma", 1, (motion(0, 2, novelty=novelty),)),))
        assert told in " ".join(about_gamma(found, TABLE))


def test_of_other_kinds_it_is_not_said_that_errors_add_up() -> None:
    both = replace(
        kind("search", 3, (motion(0.5),)), causes=(Cause("search", (0, 1)), Cause("gamma", (2,)))
    )
    assert about_gamma(Failures("any", kinds=(both,)), TABLE) == [
        "Γ is wrong: collect more data (--transitions, or go on training)."
    ]


S = Searched("auto-1", 40, 20, 0.5, False, "finished", imagined=(10, 24), met=(0, 27))


@pytest.mark.parametrize(
    ("searched", "where", "begins"),
    [
        (None, "Γ and C", "Γ and C could not be learned from the first data"),
        (S, "Γ and C", "Collect more data, and nearer to success"),
        (replace(S, imagined=(0, 24)), "Γ and C", "Raise --population"),
        (replace(S, met=(0, 0)), "Γ and C", "Raise --population"),
        (replace(S, met=(1, 27)), "Γ and C", "Raise --population"),
        (S, "the world itself", "Raise --population"),
        (None, "the world itself", "Go on training"),
    ],
)
def test_a_run_without_a_skill_is_told_what_to_change(
    searched: Searched | None, where: str, begins: str
) -> None:
    (advice,) = unskilled(searched, where).advice
    assert (advice.cause, advice.count) == ("search", 0)
    assert advice.text.startswith(begins)


def test_a_search_with_little_is_given_the_usual_first() -> None:
    """Even if nothing was solved, or its fitness still rose; the goal that is reached counts."""
    scarce = replace(S, scarce=("--attempts 1 (usually 24)", "--generations 2 (usually 150)"))
    first = (
        "The search had little: --attempts 1 (usually 24), --generations 2 (usually 150). Give it "
        "the usual first."
    )
    assert about_search(scarce) == [first]
    assert about_search(replace(scarce, solving=0.0)) == [first]
    assert about_search(replace(scarce, rising=True)) == [
        first,
        "The fitness still rose when the last evolution ended after 20 generations: raise "
        "--generations.",
    ]
    for ended in ("goal", "practice"):
        assert first not in about_search(replace(scarce, ended=ended, value=4.0))
    assert "no individual solved anything" not in str(about_search(replace(S, generations=0)))
