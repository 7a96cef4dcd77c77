"""A budget of world actions ends a stage with the best skill so far, and is never exceeded."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from members import nearly
from reaching import unrepeatable, world_of
from support import seeded
from watched import (
    NONE,
    Watched,
    Worlds,
    along,
    first_stage,
    improved,
    keys,
    known,
    of_kind,
    recruited,
    stage_of,
    without_models,
)

from cgtorch.evolution import EvolutionSettings
from cgtorch.graphs import skill_to_dict
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.improvement.events import (
    Event,
    GenerationDone,
    SkillAccepted,
    WorldAsked,
    WorldTested,
)
from cgtorch.improvement.grow import grow
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Budget, Progress
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios, stage_scenarios

MEMBERS = [replace(nearly(ahead), name=f"ahead {ahead}") for ahead in (0.45, 0.6)]
LIMITED = [
    "actions",
    "tests",
    "looks",
    pytest.param("motions", marks=pytest.mark.hostile),
    pytest.param("episodes", marks=pytest.mark.hostile),
]
EARLIER = nearly(0.25)
MANY = random_scenarios("left", 60, seeded(0))
_DONE = try_skill(EARLIER, world_of(MANY)).succeeded
BEFORE = known(world_of, EARLIER, MANY[_DONE][:9], MANY[~_DONE][:9])


def composed(limits: dict[str, float], told: list[Event], worlds: Worlds) -> Progress[Any]:
    """A stage with specialists that are made by hand, of which several are tried."""
    with pytest.MonkeyPatch.context() as patch:
        recruited(patch, *MEMBERS)
        setup = without_models(
            world_of=worlds, practice=4, looks=4, core=4, attempts=4, purse=Purse(limits)
        )
        return improve(stage_of(setup, told.append), BEFORE, MANY[50:], along("left"))


def grown(limits: dict[str, float], told: list[Event], worlds: Worlds) -> Progress[Any]:
    """A stage of the paper's method, whose graph improves in several attempts."""
    setup = without_models(
        world_of=worlds, attempts=4, budget=Budget(generations=2), purse=Purse(limits),
        evolution=EvolutionSettings(population=30, capacity=12),
    )  # fmt: skip
    return grow(stage_of(setup, told.append), BEFORE, MANY[50:], along("left"))


@cache
def unlimited(method: Callable[..., Any]) -> tuple[Progress[Any], Asked]:
    """The result without a budget, and what it costs."""
    told = list[Event]()
    after = method({}, told, Watched())
    return after, sum((e.asked for e in of_kind(told, WorldAsked)), Asked())


@pytest.mark.parametrize("name", LIMITED)
@pytest.mark.parametrize("method", [composed, pytest.param(grown, marks=pytest.mark.hostile)])
def test_no_more_is_asked_than_is_allowed(method: Callable[..., Any], name: str) -> None:
    """And what is solved under the skill with which the stage ends, is."""
    (whole, needs), accepted = unlimited(method), 0
    assert whole.skill is not EARLIER
    for share in (0.0, 0.4, 0.95, 1.0):
        limit, told, watched = int(share * getattr(needs, name)), [], Watched()
        after = method({name: limit}, told, watched)
        counted = {
            "actions": watched.asked,
            "looks": sum(each.looks.total() for each in watched.log),
            "episodes": len(watched.acted),
        }
        assert counted.get(name, 0) <= limit
        evolved = {event.candidate for event in of_kind(told, GenerationDone)}
        assert len(evolved) <= len(of_kind(told, WorldTested)) + 1  # the last one was not tried
        asked = sum((e.asked for e in of_kind(told, WorldAsked)), Asked())
        assert getattr(asked, name) <= limit
        if share == 1:
            assert skill_to_dict(after.skill) == skill_to_dict(whole.skill)
            assert keys(after.solved) == keys(whole.solved)
        if after.skill is EARLIER:
            assert after.solved is BEFORE.solved
            assert not of_kind(told, SkillAccepted)
            continue
        accepted += 1
        assert set(keys(after.solved)) > set(keys(BEFORE.solved))
        assert try_skill(after.skill, world_of(after.solved)).succeeded.all()
        assert of_kind(told, SkillAccepted)[0].skill is after.skill
    assert accepted >= 1


def test_a_budget_that_is_spent_in_practice_leaves_the_skill_that_practised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    member = nearly(0.3)
    many = random_scenarios("near", 60, seeded(0))
    good = many[try_skill(member, world_of(many)).succeeded]

    def draw(count: int, generator: Any) -> Scenarios:
        return good[:count]

    for repeats in (True, False):
        recruited(monkeypatch, member)
        purse, worlds = Purse({"episodes": 9}), world_of if repeats else unrepeatable
        how = {"world_of": worlds, "practice": 30, "looks": 2, "repeats": repeats}
        after, _ = improved(first_stage(), good[:4], draw, purse=purse, **how)
        assert purse.exhausted
        assert after.skill is not None
        assert 4 <= len(after.solved) + len(after.missed) <= 9


@pytest.mark.parametrize("left", [0, 1, 5])
def test_a_budget_that_is_spent_on_other_noise_leaves_the_skill(
    left: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether success is chance stays unknown, and what was solved stays solved."""
    member = nearly(0.3)
    many = random_scenarios("near", 80, seeded(0))
    tests = many[try_skill(member, world_of(many)).succeeded][:40]

    def stage(limits: dict[str, float]) -> tuple[Progress[Any], list[Event]]:
        recruited(monkeypatch, member)
        how = {"practice": 0, "looks": 2, "purse": Purse(limits)}
        return improved(first_stage(), tests, along("near"), **how)

    _, told = stage({})
    asked: list[WorldAsked] = of_kind(told, WorldAsked)
    assert asked[-1].phase == "other noise"
    before = sum(e.asked.actions for e in asked[:-1])
    after, _ = stage({"actions": before + left})
    assert after.skill is not None
    assert keys(after.solved) == keys(tests)


def test_a_candidate_that_the_budget_stops_before_all_of_w_is_no_skill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Eq. 1a is not known to hold, so the earlier skill stays."""
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    scenarios = random_scenarios("perimeter", 60, seeded(0))
    first, second = (try_skill(m, world_of(scenarios)).succeeded for m in (earlier, far))
    progress = known(world_of, earlier, scenarios[first], scenarios[second & ~first])
    assert len(progress.missed)
    for core in (2, 1000):
        recruited(monkeypatch, far)
        purse = Purse({"actions": 3})
        how = {"core": core, "practice": 2, "looks": 2}
        after, _ = improved(progress, NONE, along("near"), purse=purse, **how)
        assert purse.exhausted
        assert after.skill is earlier
        assert after.solved is progress.solved


def test_what_is_refused_is_an_error_of_its_own() -> None:
    setup = without_models(purse=Purse({"actions": 0}))
    with pytest.raises(BudgetSpentError, match="budget of 0 actions is spent"):
        try_skill(nearly(0.3), setup.world_of(stage_scenarios("near")), setup.purse)


@pytest.mark.parametrize("repeats", [True, False])
def test_where_no_trial_is_allowed_the_models_have_the_last_word(
    repeats: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They choose the best of some candidates; a skill that has acted is not replaced by any."""
    tests = random_scenarios("near", 10, seeded(0))
    best = nearly(0.3)
    recruited(monkeypatch, replace(nearly(0.6), name="worse"), best)
    purse = Purse({"actions": 0})
    how = {"practice": 4, "looks": 20, "repeats": repeats}
    after, _ = improved(first_stage(), tests, along("near"), attempts=3, purse=purse, **how)
    assert purse.exhausted
    assert not purse.total.actions
    assert after.skill is not None
    assert not len(after.solved) + len(after.missed)
    assert not after.chance
    share = [
        float(try_skill(skill, world_of(MANY)).succeeded.float().mean())
        for skill in (after.skill, best)
    ]
    assert share[0] >= share[1]
    purse = Purse({"actions": 0})
    kept, _ = improved(BEFORE, tests, along("near"), attempts=3, purse=purse, **how)
    assert kept.skill is BEFORE.skill
    assert kept.solved is BEFORE.solved
