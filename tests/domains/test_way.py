"""What Γ and C say of a way, and what is told of failures."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from rail import Cart, Rail, cart_with, driven
from support import circle, seeded

from cgtorch.domains.failures import Cause, Explained, Failure, Failures, Tried
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.way import HELD_OUT, LEAST, ROWS, USUAL, Act, Judge, Motion, Way, way_of
from cgtorch.ground.environment import Lanes
from cgtorch.ground.fields import wrapped

NOTHING = torch.zeros(1)


def motion(error: float | None = None) -> Motion:
    return Motion(NOTHING, NOTHING, error=error)


def way(*motions: tuple[Motion, ...]) -> Way:
    return Way(NOTHING, tuple(Act("Step", "success", NOTHING, each) for each in motions), "failure")


def test_a_way_parts_from_the_models_at_the_first_large_error() -> None:
    assert way().parts is None
    assert way((motion(),), (), (motion(1.0), motion(0.5))).parts is None
    assert way((motion(0.9),), (), (motion(0.1), motion(1.1)), (motion(9.0),)).parts == 2


def test_a_way_is_still_after_the_last_motion() -> None:
    assert way().still == 0
    assert way((), ()).still == 0
    assert way((motion(),), (), (motion(), motion()), (), ()).still == 3


@pytest.mark.parametrize("aside", [HELD_OUT - 1, HELD_OUT])
def test_usual_errors_are_measured_on_held_out_rows_if_there_are_enough(
    known: Knowledge, aside: int
) -> None:
    """A motion's error has the unit of what 1 % of those rows exceed."""
    held_out = driven(aside, 5, 8)
    judge = Judge(replace(known, aside=held_out), Cart.percept)
    rows = held_out if aside >= HELD_OUT else known.dataset
    p, u, q = (x[:ROWS] for x in (rows.percept, rows.control, rows.next_percept))
    gamma, angle = known.gamma, torch.tensor([f.kind == "angle" for f in Cart.percept])
    with torch.no_grad():
        predicted = gamma(p, u)
    apart = torch.where(angle, wrapped(predicted - q).abs(), (predicted - q).abs())
    usual = float(gamma.errors(predicted, q).quantile(USUAL))
    each = apart.quantile(USUAL, 0).maximum(LEAST * (q.amax(0) - q.amin(0)))
    fresh = driven(3, 5, 9)
    for before, control, became in zip(
        fresh.percept, fresh.control, fresh.next_percept, strict=True
    ):
        found: Any = judge.of_motion(before, control, became)
        assert torch.equal(found.control, control)
        assert torch.equal(found.became, became)
        with torch.no_grad():
            said, novelty = gamma.predict_with_novelty(before[None], control[None])
        assert torch.equal(found.predicted, said[0])
        assert found.novelty == pytest.approx(float(novelty))
        wrong = float(gamma.errors(said, became[None]))
        assert found.error == pytest.approx(wrong / usual, rel=1e-4)
        off = torch.where(angle, wrapped(said[0] - became).abs(), (said[0] - became).abs())
        torch.testing.assert_close(found.errors, off / each, rtol=1e-3, atol=1e-3)
    with torch.no_grad():
        assert judge.chances(fresh.percept) == known.classifier(fresh.percept).tolist()


def test_of_a_number_that_gamma_knows_the_range_decides_which_error_is_small(
    known: Knowledge,
) -> None:
    """Where all errors are nearly nothing, a millionth of the range has the error 1."""
    exact = replace(known.dataset, next_percept=known.dataset.percept)

    class Still:
        def __call__(self, percept: torch.Tensor, control: torch.Tensor) -> torch.Tensor:
            return percept

        def errors(self, one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
            return (one - other).abs().amax(1)

        def predict_with_novelty(self, p: torch.Tensor, u: torch.Tensor) -> tuple[Any, Any]:
            return p, torch.zeros(len(p))

    still: Any = replace(known, gamma=Still(), aside=replace(exact, percept=exact.percept[:0]))  # type: ignore[arg-type]
    judge = Judge(replace(still, dataset=exact), Cart.percept)
    width = exact.percept.amax(0) - exact.percept.amin(0)
    before = exact.percept[0].double()
    found = judge.of_motion(before, exact.control[0].double(), before + LEAST * width)
    assert found.errors is not None
    torch.testing.assert_close(found.errors.float(), torch.ones(4), rtol=0.01, atol=0.01)


class Stuck(Rail):
    """Each second push is refused."""

    pushes = 0

    def step(self, lanes: Lanes, control: torch.Tensor) -> tuple[Lanes, torch.Tensor]:
        self.pushes += 1
        after, done = super().step(lanes, control)
        return (after, done) if self.pushes % 2 else (lanes, ~done)


@pytest.mark.parametrize("judged", [True, False])
def test_each_act_has_its_motions_or_the_control_that_was_refused(
    known: Knowledge, judged: bool
) -> None:
    domain = cart_with(world=lambda self, scenarios: Stuck(scenarios))
    skill = replace(circle(domain.actions(), "Aim", "Step"), max_transitions=8)
    world, judge = domain.world(domain.draw("any", 1, seeded(0))), Judge(None, Cart.percept)
    if judged:
        judge = Judge(known, Cart.percept)
    found = way_of(skill, world, judge)
    assert found.end == "timeout"
    assert torch.equal(found.first, world.start(torch.tensor([0]))[1][0])
    assert [act.node for act in found.acts] == ["Aim_0", "Step_1"] * 4
    steps = found.acts[1::2]
    assert [act.outcome for act in steps] == ["success", "failure"] * 2
    assert [len(act.motions) for act in found.acts] == [0, 1, 0, 0] * 2
    for act in steps[::2]:
        assert torch.equal(act.motions[0].became, act.percept)
        assert act.refused is None
        assert (act.motions[0].predicted is not None) == judged
    for act in steps[1::2]:
        assert act.refused is not None
        assert torch.equal(act.refused, steps[0].motions[0].control)
        assert act.refused.shape == (3,)
    assert all(act.refused is None for act in found.acts[::2])
    chances = judge.chances(torch.stack([act.percept for act in found.acts]))
    assert [act.chance for act in found.acts] == (pytest.approx(chances) if judged else chances)


def test_without_models_nothing_is_said() -> None:
    judge = Judge(None, Cart.percept)
    found = judge.of_motion(NOTHING, NOTHING + 1, NOTHING + 2)
    assert (found.predicted, found.error, found.errors, found.novelty) == (None,) * 4
    assert found.control.tolist() == [1]
    assert found.became.tolist() == [2]
    assert judge.chances(torch.zeros(3, 4)) == [None] * 3


def failure(*causes: tuple[str, int]) -> Failure:
    several = tuple(Cause(name, tuple(range(count))) for name, count in causes)
    return Failure("failure", "Grasp", (0,), several, (), way())


def test_failures_are_counted_by_cause_and_scenarios_named_by_kind() -> None:
    tried = (Tried("near", 4, 1), Tried("", 2, 2), Tried("far", 3, 0, made=False))
    kinds = (failure(("gamma", 2), ("search", 1)), failure(("search", 4)), failure())
    found = Failures("S0", tried, kinds=kinds)
    assert found.failed == 6
    labels = [found.label(i) for i in range(10)]
    assert labels == [
        *(f"near {i}" for i in range(4)),
        "0",
        "1",
        *(f"far {i}" for i in range(3)),
        "0",
    ]
    assert list(found.causes().items()) == [("search", 5), ("gamma", 2)]


def test_before_anything_was_tried_there_is_nothing_to_explain() -> None:
    nothing = Explained(Failures(""))
    assert (nothing.seed, nothing.skill, nothing.scenarios, nothing.succeeded) == (0, *[None] * 3)
    found = nothing.found
    assert (found.looked, found.lucky, found.failed, found.causes()) == (0, 0, 0, {})
    assert found.split is None
    assert (found.kinds, found.blame, found.advice) == ((), "", ())
    assert Tried("near", 1, 0).made
