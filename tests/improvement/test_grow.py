"""The paper's method: a graph that meets eq. 1 is where the next attempt starts."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from members import nearly
from reaching import world_of
from support import seeded
from watched import NONE, along, first_stage, keys, known, of_kind, stage_of, without_models

from cgtorch.evolution import Population, initial_strategy
from cgtorch.ground.asked import Purse
from cgtorch.improvement import grow as module
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import Event, SkillAccepted, WorldTested
from cgtorch.improvement.grow import grow
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import random_scenarios

MEMBER, IDLE = nearly(0.3), nearly(-1.0)
MANY = random_scenarios("near", 60, seeded(0))
_DONE = try_skill(MEMBER, world_of(MANY)).succeeded
GOOD, BAD = MANY[_DONE], MANY[~_DONE]


@pytest.fixture
def evolved(monkeypatch: pytest.MonkeyPatch) -> tuple[list[Any], list[Any]]:
    """Skills that evolutions are to find, one after the other, and what each was given."""
    left, given = list[Any](), list[Any]()

    def evolve(
        setup: Any, name: str, environment: Any, *, keep: torch.Tensor, seeds: Population | None
    ) -> Found:
        given.append((name, keep.tolist(), seeds))
        champion = Population(left.pop(0).graph, initial_strategy(1))
        return Found(champion, torch.zeros_like(keep), 0.5)

    monkeypatch.setattr(module, "evolve_candidate", evolve)
    return left, given


def test_only_who_keeps_w_and_solves_more_is_where_the_next_attempt_starts(
    evolved: tuple[list[Any], list[Any]],
) -> None:
    left, given = evolved
    left += [IDLE, MEMBER, IDLE]
    told, learned = list[Event](), list[int]()

    def learn(models: Any, experience: Any, generator: Any) -> Any:
        learned.append(len(experience.tested))
        return len(learned)

    setup = stage_of(replace(without_models(attempts=3), learn=learn), told.append)
    tests = BAD[:1].joined(GOOD[:2])
    after = grow(setup, first_stage(), tests, along("near"))
    assert [name for name, *_ in given] == ["S1.1", "S1.2", "S1.3"]
    assert [keep for _, keep, _ in given] == [[False] * 3] * 2 + [[False, True, True]]
    assert [seeds is None for *_, seeds in given] == [True, True, False]
    assert torch.equal(given[2][2].graphs.parameters, MEMBER.graph.parameters)
    assert len(learned) == after.knowledge == 3
    (event,) = of_kind(told, SkillAccepted)
    assert after.skill is event.skill
    assert after.skill is not None
    assert torch.equal(after.skill.graph.parameters, MEMBER.graph.parameters)
    assert (after.skill.name, after.skill.max_transitions) == ("S1", setup.max_transitions)
    assert keys(after.solved) == keys(GOOD[:2])
    assert keys(after.missed) == keys(BAD[:1])
    assert after.seen is not None
    assert torch.equal(after.seen, first_percepts(world_of(after.solved.joined(after.missed))))
    assert event.succeeded.tolist() == [False, True, True]
    assert (event.keep.any(), event.targets.all(), event.parent) == (False, True, None)
    tested = [(e.solved_w, e.size_w, e.solved_m, e.size_m) for e in of_kind(told, WorldTested)]
    assert tested == [(0, 0, 0, 3), (0, 0, 2, 3), (0, 0, 0, 3)]


def test_it_ends_once_all_is_solved_and_knows_its_parent(
    evolved: tuple[list[Any], list[Any]],
) -> None:
    left, given = evolved
    left += [MEMBER, MEMBER]
    told = list[Event]()
    setup = stage_of(without_models(attempts=9), told.append)
    before = known(world_of, replace(MEMBER, name="earlier"), GOOD[:2])
    idle = replace(before, skill=replace(IDLE, name="earlier"), seen=None)
    after = grow(setup, idle, GOOD[2:4], along("near"))
    assert len(given) == 1
    assert given[0][1] == [True, True, False, False]
    (event,) = of_kind(told, SkillAccepted)
    assert (event.parent, event.keep.tolist()) == ("earlier", [True, True, False, False])
    assert event.targets.tolist() == [False, False, True, True]
    assert (len(after.solved), len(after.missed)) == (4, 0)
    worse = grow(setup, before, GOOD[2:4], along("near"))  # which solves as much as before
    assert worse.skill is before.skill
    assert worse.solved is before.solved


def test_without_a_budget_nothing_changes(evolved: tuple[list[Any], list[Any]]) -> None:
    evolved[0].append(MEMBER)
    for limits in ({"looks": 1}, {"actions": 0}):
        setup = stage_of(without_models(attempts=2, purse=Purse(limits)))
        after = grow(setup, first_stage(), GOOD[:2], along("near"))
        assert (after.skill, after.solved) == (None, NONE)
    assert len(evolved[1]) == 1
