"""Where nothing can be tried twice, skills are judged by replays, and hopeless trials end early."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import FRESH_NOISE, reachable, unrepeatable, world_of
from support import FOOTPRINT, seeded
from torch import Tensor
from watched import (
    NONE,
    Watched,
    along,
    first_stage,
    improved,
    keys,
    known,
    of_kind,
    recruited,
    stage_of,
    state_of,
    without_models,
)

from cgtorch.graphs import Skill
from cgtorch.ground.asked import Purse
from cgtorch.ground.environment import Lanes
from cgtorch.improvement.events import ChanceFound, Event, Practised, SkillAccepted, WorldAsked
from cgtorch.improvement.improve import DECISIVE, improve
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.state import FEWEST, MOST, PATIENCE, StageState
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import Scenarios, TabletopWorld, random_scenarios, stage_scenarios

MEMBER = nearly(0.3)


def test_nothing_repeats_its_noise() -> None:
    scenarios = random_scenarios("near", 400, seeded(0))
    exact = TabletopWorld(scenarios, reachable, FOOTPRINT, replace(FRESH_NOISE, position=0.0))
    torch.manual_seed(0)
    one = first_percepts(unrepeatable(scenarios))
    torch.manual_seed(0)
    other = first_percepts(unrepeatable(scenarios))
    off = torch.stack([one, other]) - first_percepts(exact)
    assert float((off != 0).float().mean()) > 0.99  # float32 may round one away
    assert off.std(1).flatten().tolist() == pytest.approx([FRESH_NOISE.position] * 14, rel=0.2)
    assert float((off[0] * off[1]).mean()) < 0.2 * FRESH_NOISE.position**2
    assert torch.equal(*(first_percepts(world_of(scenarios)) for _ in range(2)))


@pytest.mark.hostile
def test_no_scenario_is_tried_twice(setup: Setup, nothing_yet: Progress) -> None:
    """Neither in its own stage nor in a later one, and none that was only looked at."""
    watched, progress = Watched(unrepeatable), nothing_yet
    fresh = replace(setup, world_of=watched, repeats=False, attempts=12, purse=Purse())
    for name, edge in (("S0", "near"), ("S1", "left")):
        told: list[Event] = []
        about = stage_of(fresh, told.append, name)
        after = improve(about, progress, stage_scenarios(edge), along(edge))
        assert after.skill is not progress.skill
        assert not of_kind(told, ChanceFound)
        (accepted,) = of_kind(told, SkillAccepted)
        assert set(keys(after.solved)) >= set(keys(progress.solved))
        assert int(accepted.keep.sum()) == len(progress.solved)
        assert set(keys(stage_scenarios(edge))) <= set(watched.acted)
        progress = after
    looked = [each.keys[i] for each in watched.log for i in each.looks.elements()]
    assert len(looked) == len(set(looked))
    assert len(watched.acted) == len(set(watched.acted)) == fresh.purse.total.episodes
    assert len(looked) == fresh.purse.total.looks
    both = keys(progress.solved) + keys(progress.missed)
    assert sorted(both) == sorted(watched.acted)


def usual(successes: list[int]) -> float:
    """What nine of ten successes take at most, between two neighbours in proportion."""
    ordered, place = sorted(successes), 0.9 * (len(successes) - 1)
    low = int(place)
    return ordered[low] + (place - low) * (ordered[min(low + 1, len(ordered) - 1)] - ordered[low])


def allows(most: int, successes: list[int]) -> bool:
    """Whether a trial may take so many world actions, given those of the successes so far."""
    if len(successes) < FEWEST:
        return most == MOST
    wanted = max(FEWEST, PATIENCE * usual(successes))
    return most - 1e-3 <= wanted < most + 1 + 1e-3


@given(st.lists(st.integers(1, 40), max_size=30))
def test_a_trial_may_take_twice_what_almost_all_successes_take(actions: list[int]) -> None:
    assert allows(state_of(NONE, actions=tuple(actions)).most, actions)


def test_hopeless_trials_are_broken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody who grasps at nothing twenty times does so a few times only."""
    idle = nearly(-0.4)
    for repeats, actions in ((False, MOST), (True, 40)):
        watched = Watched(unrepeatable if not repeats else world_of)
        purse, how = Purse(), {"practice": 3, "looks": 2, "attempts": 1, "repeats": repeats}
        recruited(monkeypatch, idle)
        how |= {"world_of": watched, "purse": purse}
        improved(first_stage(), stage_scenarios("near"), along("near"), **how)
        spent = [n for each in watched.trials for n in each.actions.values()]
        assert len(spent) >= 1
        assert max(spent) <= actions
        assert (max(spent) == MOST) is not repeats
        assert purse.total.actions == sum(spent)


def test_what_successes_take_says_what_others_may(monkeypatch: pytest.MonkeyPatch) -> None:
    recruited(monkeypatch, nearly(0.2))
    watched = Watched(unrepeatable)
    how = {"world_of": watched, "repeats": False, "practice": 20, "looks": 2, "attempts": 12}
    improved(first_stage(), NONE, along("near"), **how)
    successes, broken = list[int](), 0
    for each in watched.trials:
        state = state_of(NONE, actions=tuple(successes))
        assert max(each.actions.values()) <= state.most
        broken += sum(n == state.most for i, n in each.actions.items() if i not in each.succeeded)
        successes += [each.actions[i] for i in sorted(each.succeeded)]
    assert broken >= 1
    assert len(successes) > FEWEST


@pytest.mark.parametrize(("share", "taken"), [(1.0, True), (0.5, False)])
def test_a_candidate_that_is_worse_on_w_in_replays_does_not_act(
    share: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though it would solve more elsewhere, and nothing is tried again to find out."""
    earlier, far = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    first, second = (try_skill(m, world_of(scenarios)).succeeded for m in (earlier, far))
    progress = known(world_of, earlier, scenarios[first], scenarios[second & ~first])

    def shares(setup: Setup[Any], state: StageState[Any], skills: list[Skill]) -> Tensor:
        """Whoever is not the earlier skill solves all but W, of which it solves this share."""
        w = state.keep.float()
        other = torch.where(state.keep, share, 1.0)
        return torch.stack([w if skill.name == "S0" else other for skill in skills], 1)

    monkeypatch.setattr("cgtorch.improvement.team.shares", shares)
    recruited(monkeypatch, far)
    watched = Watched(unrepeatable)
    how = {"world_of": watched, "repeats": False, "practice": 2, "looks": 2, "attempts": 1}
    _, told = improved(progress, NONE, along("near"), **how)
    (practised,) = of_kind(told, Practised)
    assert practised.skill.name == ("S1-1" if taken else "S0")
    assert not set(watched.acted) & set(keys(progress.solved) + keys(progress.missed))


class Coin(TabletopWorld):
    """Within reach, a grasp succeeds if the scenario's number says so."""

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        after, chance = super().success(lanes)
        lucky = ((self.scenarios.seed[lanes.scenario] * 40503) >> 8) % 2
        return after, chance * lucky


def coin(scenarios: Scenarios) -> Coin:
    return Coin(scenarios, reachable, FOOTPRINT)


def many(count: int) -> Scenarios:
    """Scenarios that the member solves."""
    found = random_scenarios("near", 2 * count, seeded(0))
    return found[try_skill(MEMBER, world_of(found)).succeeded][:count]


def test_success_that_is_chance_is_found_out_and_no_fact_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stage ends there with all that it has solved, and a next one tries nothing again."""
    watched = Watched(coin)
    told, before = list[Event](), list[int]()

    def watch(event: Event) -> None:
        told.append(event)
        if isinstance(event, ChanceFound):
            before.append(len(watched.log))

    recruited(monkeypatch, MEMBER, replace(nearly(0.35), name="another"))
    setup = without_models(world_of=watched, practice=8, looks=2, attempts=4, noisy=True)
    tests = many(90)
    after = improve(stage_of(setup, watch), first_stage(), tests, along("near"))
    (found,) = of_kind(told, ChanceFound)
    lucky = try_skill(MEMBER, coin(tests)).succeeded
    assert found.tried >= int(lucky.sum()) >= DECISIVE
    assert 0.3 < found.succeeded / found.tried < 0.7
    assert len([e for e in of_kind(told, WorldAsked) if e.phase == "other noise"]) == 1
    assert before == [len(watched.log)]  # as means count from then on, which others look for
    assert after.skill is not None
    assert set(keys(after.solved)) >= set(keys(tests[lucky]))
    # It stays so in the next stage, which is told by nobody again.
    assert after.chance
    begin = len(watched.log)
    told.clear()
    improve(stage_of(setup, told.append, "S2", 1), after, stage_scenarios("left"), along("left"))
    assert not of_kind(told, ChanceFound)
    known_before = set(keys(after.solved) + keys(after.missed))
    later = [key for each in watched.log[begin:] for key in each.keys]
    assert later
    assert len(set(later)) == len(later)
    assert not set(later) & known_before


@pytest.mark.parametrize(
    ("count", "world", "asked"),
    [
        (40, {"noisy": True}, 1),
        (DECISIVE - 20, {"noisy": True}, 1),
        (40, {"noisy": False}, 0),
        (60, {"repeats": False, "world_of": coin}, 0),
    ],
)
def test_success_that_is_none_stays_a_fact(
    count: int, world: dict[str, Any], asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is asked for once, as soon as enough is solved to tell, and where it can be."""
    recruited(monkeypatch, MEMBER)
    how = {"practice": 5, "looks": 2, "attempts": 3, **world}
    after, told = improved(first_stage(), many(count), along("near"), **how)
    assert not of_kind(told, ChanceFound)
    assert len([e for e in of_kind(told, WorldAsked) if e.phase == "other noise"]) == asked
    assert not after.chance
    if "noisy" in world:
        assert after.skill is not None
        assert try_skill(after.skill, world_of(after.solved)).succeeded.all()
