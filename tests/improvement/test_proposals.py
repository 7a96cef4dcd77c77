"""Which candidate acts next, where nothing can be tried twice: the best that the models know."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from members import nearly
from reaching import unrepeatable, world_of
from support import seeded
from watched import (
    NONE,
    first_stage,
    improved,
    of_kind,
    recruited,
    stage_of,
    state_of,
    without_models,
)

from cgtorch.ground.asked import Purse
from cgtorch.improvement import team
from cgtorch.improvement.events import Practised
from cgtorch.improvement.team import REFLECT, WORTH, Candidate
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.world import Scenarios, random_scenarios

POOR, BEST = nearly(0.5), nearly(0.35)
MANY = random_scenarios("near", 2000, seeded(0))
BY_POOR, BY_BEST = (try_skill(each, world_of(MANY)).succeeded for each in (POOR, BEST))
BOTH, ONLY_BEST, NEITHER = (
    MANY[rows] for rows in (BY_POOR & BY_BEST, ~BY_POOR & BY_BEST, ~BY_POOR & ~BY_BEST)
)


def test_what_the_world_has_shown_of_a_skill_counts_whatever_the_models_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They deny all of it. A candidate has to solve it in them, and may then replace the skill."""
    recruited(monkeypatch)  # nobody else can be evolved
    idle = Candidate(nearly(-0.4))
    for w, taken in ((BOTH[:20], True), (NEITHER[:20], False)):
        scenarios, keep = w.joined(ONLY_BEST[:40]), torch.arange(60) < 20
        state = state_of(scenarios, (BEST,), keep, current=idle, repeats=False)
        chosen, _ = team._candidate(stage_of(without_models(max_transitions=6)), state)
        assert (chosen is not idle) is taken


def test_a_skill_that_does_not_fail_gives_way_to_one_that_is_clearly_better() -> None:
    for more, in_a_row, taken in (
        (1, 0, True),
        (1, REFLECT - 1, True),
        (1, REFLECT, False),
        (5, REFLECT, True),
    ):
        scenarios = BOTH[: 100 - more].joined(ONLY_BEST[:more])
        assert (more / 100 > WORTH) is (more == 5)
        poor = Candidate(POOR)
        about: dict[str, Any] = {"current": poor, "repeats": False, "in_a_row": in_a_row}
        state = state_of(scenarios, (BEST,), **about)
        chosen, after = team._candidate(stage_of(without_models(max_transitions=6)), state)
        assert (chosen is not poor) is taken
        assert after.number == state.number + 1


@pytest.mark.parametrize("thoughts", [1, 3])
def test_a_stage_ends_when_the_models_know_nobody_better(
    thoughts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though the first skill has solved all that came; the better one has to show that it can."""
    recruited(monkeypatch, POOR, BEST)
    monkeypatch.setattr(team, "THOUGHTS", thoughts)

    def draw(count: int, generator: torch.Generator) -> Scenarios:
        return ONLY_BEST[:10].joined(BOTH[: count - 10]) if count == 30 else BOTH[30:][:count]

    purse = Purse()
    how = {"practice": 4, "looks": 30, "max_transitions": 6, "attempts": 6}
    how |= {"world_of": unrepeatable, "repeats": False, "replays": 1, "purse": purse}
    after, told = improved(first_stage(), NONE, draw, **how)
    assert after.skill is not None
    assert try_skill(after.skill, world_of(ONLY_BEST[:10])).succeeded.all()
    practised: list[Practised] = of_kind(told, Practised)
    names = {each.skill.name for each in practised}
    assert len(names) == len(practised) == (2 if thoughts == 1 else 1)
    assert [each.in_a_row for each in practised] == ([6, 4] if thoughts == 1 else [6])
    assert purse.total.episodes == (10 if thoughts == 1 else 6)


def test_where_the_world_repeats_itself_one_candidate_is_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The world judges it at once, and what it loses is seen there."""
    left = recruited(monkeypatch, POOR, BEST)
    state = replace(state_of(BOTH[:5].joined(ONLY_BEST[:5])), repeats=True)
    _, after = team.proposed(stage_of(without_models(max_transitions=6)), state)
    assert after.number == 1
    assert left == [BEST]
