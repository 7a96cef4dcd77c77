"""Which candidate acts next, where nothing can be tried twice: the best that the models know."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import unrepeatable, world_of
from support import seeded
from torch import Tensor
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
from cgtorch.improvement.state import Candidate
from cgtorch.improvement.team import (
    CLEAR,
    ERRORS,
    MOST_WORSE,
    REFLECT,
    WORTH,
    no_worse,
)
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


SHARE = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])


def decided(old: list[float], new: list[float], keep: list[int]) -> bool:
    return no_worse(torch.tensor(old), torch.tensor(new), torch.tensor(keep) > 0)


def test_who_loses_much_of_w_is_not_taken_however_much_it_gains() -> None:
    for n in (1, 2, 5, 40):
        old, keep = [1.0] * n + [0.0] * 9 * n, [1] * n + [0] * 9 * n
        assert decided(old, [1.0] * 10 * n, keep)
        all_lose = [0.75] * n + [1.0] * 9 * n
        some_lose = [0.5 if i % 3 == 0 else 1.0 for i in range(n)] + [1.0] * 9 * n
        assert not decided(old, all_lose, keep)
        assert not decided(old, some_lose, keep)


def test_who_loses_a_little_of_w_is_taken_if_that_may_be_chance() -> None:
    """One of forty: the mean loss is as large as its standard error, and less than 5 %."""
    old, keep = [1.0] * 40 + [0.0] * 40, [1] * 40 + [0] * 40
    assert decided(old, [0.0] + [1.0] * 79, keep)
    # As much from all of them is no chance.
    assert not decided(old, [1 - 1 / 40] * 40 + [1.0] * 40, keep)


def plainly(old: Tensor, new: Tensor, keep: Tensor) -> bool:
    """The rule in so many words."""

    def mean(values: list[float]) -> float:
        return sum(values) / len(values)

    def error(values: list[float]) -> float:
        return (mean([(x - mean(values)) ** 2 for x in values]) / len(values)) ** 0.5

    rows = range(len(keep))
    change = [float(new[i] - old[i]) for i in rows]
    inside = [change[i] for i in rows if keep[i]]
    outside = [change[i] for i in rows if not keep[i]]
    if inside and mean(inside) < -min(ERRORS * error(inside), MOST_WORSE) - 1e-6:
        return False
    return sum(outside) > 0 and mean(change) > CLEAR * error(change)


@given(st.lists(st.tuples(SHARE, SHARE, st.booleans()), min_size=1, max_size=30))
def test_the_rule_is_what_it_is_said_to_be(rows: list[tuple[float, float, bool]]) -> None:
    old, new, keep = (torch.tensor([row[i] for row in rows]) for i in range(3))
    found = no_worse(old, new, keep.bool())
    assert found == plainly(old, new, keep.bool())
    change = new - old
    assert not found or (change[~keep.bool()].sum() > 0 and change.sum() > 0)
    enough = float(change.mean())
    assert no_worse(old, new, keep.bool(), enough - 0.01) is found
    assert not no_worse(old, new, keep.bool(), enough)
