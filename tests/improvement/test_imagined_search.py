"""The steps of a search in imagined episodes: what is judged, played, explored and told."""

from dataclasses import replace
from math import inf
from typing import Any

import pytest
import torch
from imagining import EARLIER, EPISODES, GOOD, KNOWN, LOOKS, POOR, Beginning, search_of, told_skill
from rewarded_cart import LIMIT, CartModels, GivenModels, Track
from support import same, seeded
from torch import Tensor
from watched import of_kind

from cgtorch.evolution import Generation, evolve
from cgtorch.graphs import Graphs
from cgtorch.ground.asked import Asked
from cgtorch.improvement import imagined_search
from cgtorch.improvement.events import EpisodePlayed, Event, MeanTested, ModelsFitted
from cgtorch.improvement.imagined_search import FRESH, HORIZON, MOST_CAUTIOUS, SHORT, Search
from cgtorch.improvement.imagined_state import CHAMPIONS, CURIOUS, PATIENCE, RANDOM, STARTS, State
from cgtorch.improvement.paired_race import Holder


def test_it_begins_with_looks_and_episodes_of_random_controls(beginning: Beginning) -> None:
    search, state, told = beginning
    asked = search.setup.purse.total - EARLIER
    steps = asked.motions
    assert asked == Asked(looks=LOOKS, episodes=EPISODES, motions=steps)
    assert state.asked[STARTS] == Asked(looks=LOOKS)
    assert state.asked[RANDOM] == Asked(episodes=EPISODES, motions=steps)
    assert (state.episodes, state.steps, len(state.known.steps)) == (EPISODES, steps, steps)
    assert EPISODES * SHORT >= steps > (EPISODES - 1) * SHORT / 2
    (fitted,) = of_kind(told, ModelsFitted)
    assert fitted.summary.first
    assert 0 <= fitted.seconds < 100
    control = state.known.steps.control[:, 0]
    same_one = (control[1:] == control[:-1]).float()
    # The first of the episodes draws each control anew, and later ones do so less often.
    assert CartModels.changes[0] == 1
    assert same_one[:10].sum() == 0
    assert same_one.sum() > 10


class Backwards(Track):
    """A track on which every push goes the other way."""

    def next_state(self, state: Tensor, control: Tensor, scenario: Tensor) -> Tensor:
        return super().next_state(state, -control, scenario)


class LongModels(GivenModels):
    """Those of a world whose episodes take twice as many steps as imagined ones."""

    most_steps = 2 * HORIZON


def test_what_is_wanted_of_an_episode_that_is_broken_off_is_less() -> None:
    search = search_of(satisfied=8.0)
    assert (search.wanted(LIMIT // 2), search.wanted(2 * LIMIT)) == (4, 8)
    assert search_of(satisfied=8.0, kind=LongModels).wanted(HORIZON) == 4


def test_the_search_in_models_plays_what_is_imagined_and_never_has_enough(begun: State) -> None:
    inner = search_of(satisfied=8.0).in_models(begun.known)
    assert inner.setup.budget.satisfied == inf
    values = inner.fresh.of_skills([told_skill(GOOD)], 60, seeded(1))[0]
    assert torch.equal(
        values, search_of().imagined(GOOD, begun.known.world(60, HORIZON, seeded(1)))
    )


def test_a_holder_is_promising_if_enough_values_are_surely_enough(begun: State) -> None:
    """A mean of 9 with a standard deviation of 10 has an error of 1 on 100 fresh episodes."""
    total, squares = 9.0 * KNOWN, (100 * (KNOWN - 1) / KNOWN + 81) * KNOWN

    def promising(satisfied: float, count: int = KNOWN) -> bool:
        share = count / KNOWN
        holder = Holder(told_skill(GOOD), total * share, squares * share, count)
        state = replace(begun, inner=replace(begun.inner, holder=holder))
        return search_of(satisfied=satisfied).promising(state)

    assert promising(7.9)
    assert not promising(8.1)
    assert not promising(7.9, count=KNOWN - 1)
    assert not search_of(satisfied=7.9).promising(begun)
    exactly = Holder(told_skill(GOOD), 8.0 * KNOWN, 64.0 * KNOWN, KNOWN)
    assert search_of(8.0).promising(replace(begun, inner=replace(begun.inner, holder=exactly)))


def test_a_holder_that_was_lucky_is_known_better_and_not_played(begun: State) -> None:
    lucky = Holder(told_skill(GOOD), 20.0 * KNOWN, 400.0 * KNOWN, KNOWN)
    search = search_of(satisfied=15.0)
    state = replace(begun, inner=replace(begun.inner, holder=lucky), mark=inf)
    state, offered = search.after(state, generation_of(search, begun, POOR), seeded(1))
    assert not offered
    assert search.setup.purse.total == Asked()
    assert state.inner.holder is not None
    assert state.inner.holder.count >= KNOWN + imagined_search.SURE
    assert (state.inner.spent.tuned, state.inner.spent.rivals) == (0, 0)


def test_a_graph_promises_a_mean_with_an_error_on_fresh_episodes(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = search_of()
    values = search.imagined(GOOD, begun.known.world(200, HORIZON, seeded(1))).double()
    mean, error = search.promised(GOOD, begun.known.world(200, HORIZON, seeded(1)))
    assert mean == pytest.approx(float(values.mean()))
    assert error == pytest.approx(float(values.std()) / FRESH**0.5)
    monkeypatch.setattr(Search, "imagined", lambda *_: torch.tensor([-inf, 1.0]))
    assert search.promised(GOOD, begun.known.world(2, HORIZON, seeded(1))) == (-inf, inf)


def test_each_refused_offer_asks_for_more_up_to_a_limit(begun: State) -> None:
    worlds = begun.known.world(imagined_search.SURE, HORIZON, seeded(1))
    mean, error = search_of().promised(GOOD, worlds)
    state = begun
    for errors in (1, 2, MOST_CAUTIOUS, MOST_CAUTIOUS):
        for more, sure in ((1.05, True), (0.95, False)):
            search = search_of(satisfied=mean - more * errors * error)
            assert search.surely(state, told_skill(GOOD), seeded(1)) is sure
        state = replace(state, known=state.known.refused())


def test_an_episode_is_worth_playing_if_it_tells_enough(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, steps = search_of(), LIMIT  # as no episode is longer
    world = begun.known.curious(imagined_search.SURE, imagined_search.CURIOUS_STEPS, seeded(1))
    value = float(search.imagined(GOOD, world).mean()) / steps
    for share, telling in ((0.99, True), (1.01, False)):
        monkeypatch.setattr(imagined_search, "TELLING", share * value)
        assert search.telling(GOOD, begun.known, seeded(1)) is telling


def generation_of(search: Search, state: State, champion: Graphs) -> Generation:
    """A generation in what is imagined, with this champion."""
    inner = search.in_models(state.known)
    world = state.known.world(2, HORIZON, seeded(0))
    about = world, search.setup.actions, inner.structures, seeded(0)
    found = next(evolve(*about, max_transitions=500))
    return replace(found, champion=replace(found.champion, graphs=champion))


def after(
    search: Search, state: State, champion: Graphs = POOR, holder: Graphs | None = None
) -> tuple[State, bool]:
    if holder is not None:
        values = torch.full((500,), 12.0)
        known = Holder(told_skill(holder)).met(values)
        state = replace(state, inner=replace(state.inner, holder=known))
    return search.after(state, generation_of(search, state, champion), seeded(1))


def test_a_good_champion_is_played_and_offered(begun: State) -> None:
    told: list[Event] = []
    search = search_of(told=told)
    state, offered = after(search, begun, holder=GOOD)
    assert offered
    assert state.skill is not None
    assert same(state.skill.graph, GOOD)
    (episode,), (mean,) = of_kind(told, EpisodePlayed), of_kind(told, MeanTested)
    assert episode.phase == CHAMPIONS
    assert mean.mean == episode.returned
    assert mean.skill is state.skill
    assert (mean.new, mean.tried, mean.episodes) == (True, 1, begun.episodes + 1)
    assert search.setup.purse.total.episodes == 1
    more = search.setup.purse.total.motions
    assert state.asked[CHAMPIONS].motions == more == len(state.known.steps) - len(begun.known.steps)
    assert episode.total == begun.steps + more


def test_a_champion_that_the_world_disproves_is_not_offered(begun: State) -> None:
    """It is believed to be good, as its values are those of others."""
    told: list[Event] = []
    search = search_of(satisfied=11.9, told=told)
    hopeless = replace(search, setup=replace(search.setup, world_of=Backwards))
    state, offered = after(hopeless, begun, holder=GOOD)
    assert not offered
    assert state.skill is None
    (mean,) = of_kind(told, MeanTested)
    assert not mean.new
    assert mean.mean == -LIMIT


def test_there_is_no_episode_before_patience_is_over(begun: State) -> None:
    search = search_of(satisfied=1e6)
    waiting = replace(begun, patience=3, waited=1, mark=inf)
    state, offered = after(search, waiting)
    assert (offered, state.waited, state.patience) == (False, 2, 3)
    assert search.setup.purse.total == Asked()
    late = search_of(satisfied=1e6)
    late.setup.purse.until = 0.0
    state, _ = after(late, replace(begun, waited=9, mark=inf))
    assert (state.waited, late.setup.purse.total) == (10, Asked())


@pytest.fixture
def impatient(begun: State) -> State:
    """A state after which nothing counts as progress."""
    return replace(begun, patience=1, mark=inf)


@pytest.mark.parametrize(("champion", "other"), [(True, False), (False, False), (False, True)])
def test_what_tells_something_is_played_the_champion_first(
    impatient: State, champion: bool, other: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Event] = []
    search = search_of(satisfied=1e6, told=told)
    monkeypatch.setattr(Search, "exploring", lambda *_: GOOD)
    monkeypatch.setattr(Search, "telling", lambda self, graphs, *_: (
        other if same(graphs, GOOD) else champion
    ))  # fmt: skip
    state, offered = after(search, impatient)
    assert not offered
    assert state.waited == 0
    assert [each.phase for each in of_kind(told, EpisodePlayed)] == [CURIOUS] * (champion or other)
    assert state.patience == impatient.patience + (0 if champion or other else PATIENCE)
    if other:  # it is better than the champion
        assert state.seed is not None
        assert same(state.seed, GOOD)
    else:
        assert state.seed is None


def test_who_explores_is_offered_if_it_reaches_the_target(
    impatient: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Search, "exploring", lambda *_: GOOD)
    monkeypatch.setattr(Search, "telling", lambda self, graphs, *_: same(graphs, GOOD))
    state, offered = after(search_of(), impatient)
    assert offered
    assert state.skill is not None
    assert same(state.skill.graph, GOOD)
    state, offered = after(search_of(satisfied=30.0), impatient, champion=GOOD)
    assert (offered, state.skill, state.seed) == (False, None, None)
    told: list[Event] = []
    assert search_of(told=told)._explored(impatient, POOR, GOOD, seeded(1))[1]
    good = of_kind(told, EpisodePlayed)[0].returned
    for satisfied, sure in ((30.0, True), (8.0, False), (good, True)):
        monkeypatch.setattr(Search, "surely", lambda *_, sure=sure: sure)
        found = search_of(satisfied)._explored(impatient, POOR, GOOD, seeded(1))
        assert found[1] is (satisfied == good)


def test_a_search_begins_again_with_who_explores_if_more_is_imagined_for_it(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Search, "_played", lambda *_: (begun, 0.0, 0.0))
    for said, better in (((2.0, 1.0), True), ((1.0, 1.0), False), ((-5.0, -4.0), False)):
        monkeypatch.setattr(
            Search, "promised", lambda _, graphs, *__, said=said: (said[same(graphs, POOR)], 0.5)
        )
        state, offered = search_of(satisfied=30.0)._explored(begun, POOR, GOOD, seeded(1))
        assert not offered
        assert (state.seed is not None) is better


def test_a_champion_is_kept_if_the_world_gives_what_was_imagined_or_what_is_wanted(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, table = search_of(), [(9, 8, 1.5, 1), (9, 7.5, 1, 1), (9, 7.5, 1.1, 0), (8, 7.5, 0, 1)]
    for said, reached, short, kept in (*table, (7.5, 7.5, -1, 0)):
        found = begun, float(reached), float(short)
        monkeypatch.setattr(Search, "promised", lambda *_, said=said: (said, 0.0))
        monkeypatch.setattr(Search, "_played", lambda *_, found=found: found)
        for sure in (True, False):
            monkeypatch.setattr(Search, "surely", lambda *_, sure=sure: sure)
            state, offered = search._champion_played(begun, told_skill(GOOD), seeded(1))
            assert offered is (state.skill is not None) is (bool(kept) and sure)


def test_an_episode_that_is_not_finished_has_no_return(begun: State) -> None:
    told: list[Event] = []
    search = search_of(told=told)
    short = replace(search, setup=replace(search.setup, max_transitions=2))
    assert not short._champion_played(begun, told_skill(GOOD), seeded(1))[1]
    (episode,), (mean,) = of_kind(told, EpisodePlayed), of_kind(told, MeanTested)
    assert (episode.returned, mean.mean) == (None, None)


def test_it_is_told_how_much_more_was_imagined_from_where_an_episode_began(begun: State) -> None:
    search, generator = search_of(), seeded(2)
    _, reached, short = search._played(begun, GOOD, CHAMPIONS, HORIZON, seeded(2))
    start = search._episode(CHAMPIONS, HORIZON, generator).world.start(torch.arange(1))[1]
    here = begun.known.begun_at(start, imagined_search.SURE, HORIZON, generator)
    assert short == pytest.approx(float(search.imagined(GOOD, here).mean()) - reached)


def test_who_explores_is_evolved_for_some_generations_in_other_episodes_each(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, curious, late = list[int](), type(begun.known).curious, search_of()

    def counted(known: Any, count: int, *about: Any) -> Any:
        told.append(count)
        return curious(known, count, *about)

    monkeypatch.setattr(imagined_search, "EXPLORING", 1)
    monkeypatch.setattr(type(begun.known), "curious", counted)
    found = search_of().exploring(begun.known, seeded(1))
    late.setup.purse.until = 0.0
    late.exploring(begun.known, seeded(1))
    assert told == [imagined_search.EACH] * 3
    world = curious(begun.known, 20, imagined_search.CURIOUS_STEPS, seeded(2))
    worth, others = (float(late.imagined(each, world).mean()) for each in (found, POOR))
    assert worth > 2 * others  # as its episodes are not ended by the number of transitions


def test_nothing_is_searched_for_where_no_reward_so_far_adds_up_to_what_is_wanted(
    begun: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Event] = []
    search = search_of(satisfied=11.0, told=told)
    monkeypatch.setattr(Search, "exploring", lambda *_: GOOD)
    monkeypatch.setattr(Search, "telling", lambda *_: True)
    monkeypatch.setattr(type(begun.known), "most", lambda *_: 10.9)
    state, offered = after(search, begun)
    assert (offered, state.inner.spent.rivals) == (False, 0)
    assert state.generations == begun.generations + 1
    assert [each.phase for each in of_kind(told, EpisodePlayed)] == [CURIOUS]
    monkeypatch.setattr(type(begun.known), "most", lambda *_: 11.0)
    for begin in (begun, replace(begun, patience=2 * PATIENCE)):
        state, _ = after(search, begin)
        assert state.inner.spent.rivals > 0
        monkeypatch.setattr(type(begun.known), "most", lambda *_: 10.9)
    assert len(of_kind(told, EpisodePlayed)) == 1
