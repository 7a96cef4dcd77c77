"""The autonomous loop where the mean counts: with rewards, and where success is chance."""

import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from lottery import PaidTombola, Tombola
from support import create_run, same

from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.events import (
    ChanceFound,
    Event,
    EvolutionRecalled,
    FreshTested,
    GenerationDone,
    MeanTested,
)
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, planned_run, read_run, write_run
from cgtorch.training.auto import DECISIVE_EPISODES, EPISODES, SHARE, train_until
from cgtorch.training.context import Training
from cgtorch.training.train import NotImprovedError

gymnasium = pytest.importorskip("gymnasium")

LIMIT = 50  # of the pole's steps, a tenth of the usual ones
POLE = "gymnasium.envs.classic_control.cartpole:CartPole"
gymnasium.register(
    "ShortPole-v0",
    f"{POLE}Env",
    vector_entry_point=f"{POLE}VectorEnv",
    max_episode_steps=LIMIT,
    reward_threshold=LIMIT - 1,
)


def begun(
    folder: Path, attempts: int = 3, transitions: int = 2000, pole: str = "ShortPole-v0"
) -> StoredRun:
    settings = RunSettings(
        domain=f"gymnasium:{pole}",
        population=12,
        generations=3,
        attempts=attempts,
        max_transitions=transitions,
    )
    return create_run(folder, settings, GymnasiumSettings(pole))


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def of(events: list[Event], kind: type[Event]) -> list[Any]:
    return [event for event in events if isinstance(event, kind)]


Whole = tuple[StoredRun, list[Event], list[dict[str, Any]]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """A run of two rounds, what was told of it, and its results."""
    run, events = begun(tmp_path_factory.mktemp("whole") / "run"), list[Event]()
    goal = Goal(target=1e6, rounds=2)
    return run, events, train_until(Training(run, events.append, quietly), goal)


def test_rounds_go_on_from_the_best_skill_and_test_its_mean(whole: Whole) -> None:
    run, events, results = whole
    assert run.rounds == ("auto-1", "auto-2")
    assert [result["generations"] for result in results] == [9, 9]
    assert [result["in_a_row"] for result in results] == [0, 0]  # as nothing is practised
    assert [(r["w_size"], r["targets"], r["mean_holds"]) for r in results] == [(0, 0, False)] * 2
    for result, test in zip(results, of(events, FreshTested), strict=True):
        fresh = result["fresh"]
        played = [e.episodes for e in of(events, MeanTested) if e.stage == result["stage"]][-1]
        assert fresh["tried"] == max(EPISODES, played // SHARE)
        assert 1 < fresh["mean_return"] <= LIMIT
        assert 0 <= fresh["error"] < fresh["mean_return"]
        assert (test.mean_return, test.error) == (fresh["mean_return"], fresh["error"])
        assert (test.target, test.decisive) == (1e6, False)
    progress = load_progress(run, run.folder / "auto-2")
    assert progress.specialists is not None
    assert not len(progress.solved)
    assert not len(progress.missed)


def test_a_round_ends_and_the_goal_is_reached_once_a_second_test_holds(tmp_path: Path) -> None:
    run, events = begun(tmp_path / "run", attempts=300), list[Event]()
    results = train_until(Training(run, events.append, quietly), Goal(target=40.0, rounds=9))
    first, second = of(events, FreshTested)[-2:]
    assert (first.decisive, second.decisive) == (False, True)
    assert second.tried >= DECISIVE_EPISODES
    assert results[-1]["mean_holds"]
    assert results[-1]["decisive"]["mean_return"] - results[-1]["decisive"]["error"] >= 40
    assert len(of(events, GenerationDone)) < 300


@pytest.mark.parametrize("number", [2, pytest.param(7, marks=pytest.mark.hostile)])
def test_it_is_the_same_after_an_interruption(tmp_path: Path, number: int, whole: Whole) -> None:
    """What the journal has is not evolved again."""
    run, _, (first, _) = whole
    goal, stopped = Goal(target=1e6, rounds=1), begun(tmp_path / "stopped")
    met, again = 0, list[Event]()

    def stop(event: Event) -> None:
        nonlocal met
        met += isinstance(event, GenerationDone)
        if met == number:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_until(Training(stopped, stop, quietly, checkpoint_seconds=0), goal)
    assert not stopped.stages
    if number > 2:  # the best so far can be evaluated and exported
        assert last_skill(stopped.folder)[1].name == "auto-1"
    (found,) = train_until(Training(read_run(stopped.folder), again.append, quietly), goal)
    assert [e.found.generations for e in of(again, EvolutionRecalled)] == [number - 1]
    timed = {"seconds": 0, "search_seconds": 0}
    assert found | timed == first | timed
    skill = load_progress(run, run.folder / "auto-1").skill
    assert skill is not None
    assert same(last_skill(stopped.folder)[1].graph, skill.graph)


def made(folder: Path, domain: Tombola, **settings: Any) -> StoredRun:
    small = {"population": 24, "generations": 20, "attempts": 4, "max_transitions": 4, **settings}
    run = planned_run(
        folder, RunSettings(domain=f"lottery:{type(domain).__name__}", **small), domain=domain
    )
    write_run(run)
    return run


def test_chance_is_measured_and_then_means_count(tmp_path: Path) -> None:
    """The first round still believes in W, which keeps what luck has solved."""
    run, events = made(tmp_path / "run", Tombola()), list[Event]()
    results = train_until(Training(run, events.append, quietly), Goal(target=0.95, rounds=2))
    (found,) = of(events, ChanceFound)
    assert found.tried >= 30
    assert found.succeeded < 0.8 * found.tried
    after = events[events.index(found) :]
    assert len(of(after, MeanTested)) > 3
    assert results[-1]["mean_holds"] is False
    last = results[-1]["fresh"]
    assert last["succeeded"] / last["tried"] > 0.5  # where one that stakes nothing wins 0.35
    assert last["tried"] > EPISODES  # as a search has played many more
    assert load_progress(run, run.folder / run.rounds[-1]).chance


@pytest.mark.parametrize(("chance", "rounds"), [("yes", 1), ("no", 2)])
def test_the_user_may_overrule_it(tmp_path: Path, chance: str, rounds: int) -> None:
    few = made(tmp_path / "run", Tombola(), chance=chance, generations=3, attempts=2)
    run, events = few, list[Event]()
    train_until(Training(run, events.append, quietly), Goal(target=0.95, rounds=rounds))
    assert not of(events, ChanceFound)
    assert bool(of(events, MeanTested)) == (chance == "yes")


def test_with_rewards_it_is_the_target_return_that_counts_as_solved(tmp_path: Path) -> None:
    """Though nothing in this world ever tells of success."""
    run, events = made(tmp_path / "run", PaidTombola()), list[Event]()
    results = train_until(Training(run, events.append, quietly), Goal(target=9.0, rounds=1))
    fresh = results[0]["fresh"]
    assert fresh["mean_return"] == pytest.approx(2 * fresh["succeeded"] / fresh["tried"])
    assert fresh["succeeded"] > 0.7 * fresh["tried"]


def test_the_time_ends_a_round_within_seconds_and_keeps_its_best(tmp_path: Path) -> None:
    run = made(tmp_path / "run", PaidTombola(), generations=10_000)
    began = time.monotonic()
    results = train_until(Training(run, lambda _: None, quietly), Goal(target=9.0, minutes=0.05))
    assert 3 <= time.monotonic() - began < 40
    assert run.rounds == ("auto-1",)
    assert results[0]["generations"] < 10_000
    assert last_skill(run.folder, domain=run.domain)[1].num_nodes > 0


def test_a_search_in_which_no_episode_ends_says_so(tmp_path: Path) -> None:
    run, events = begun(tmp_path / "run", attempts=9, transitions=3), list[Event]()
    with pytest.raises(SettingsError, match="has ended within 3 transitions, so there is no"):
        train_until(Training(run, events.append, quietly), Goal(target=9.0, rounds=1))
    assert not run.rounds
    assert len(of(events, GenerationDone)) == 9  # the tenth decides


def test_time_that_was_too_short_is_told(tmp_path: Path) -> None:
    run = begun(tmp_path / "run", transitions=3)
    with pytest.raises(NotImprovedError, match="time was over before stage auto-1 had a skill"):
        train_until(Training(run, lambda _: None, quietly), Goal(target=9.0, minutes=1e-4))


def test_models_with_rewards_are_refused_for_the_papers_method(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"gives rewards, and a Γ .* with method 'paper'"):
        made(tmp_path / "run", PaidTombola(), models="learned", method="paper")
    assert made(tmp_path / "other", PaidTombola(), models="learned").imagines


def test_the_papers_method_ends_by_the_mean_return(tmp_path: Path) -> None:
    short = begun(tmp_path / "run")
    run = replace(short, settings=replace(short.settings, method="paper"))
    events = list[Event]()
    goal = Goal(target=LIMIT / 2, rounds=3)
    result = train_until(Training(run, events.append, quietly), goal)[-1]
    tests = of(events, FreshTested)
    assert tests[-1].mean_return >= LIMIT / 2
    assert tests[-1].decisive
    assert result["mean_holds"]
    assert result["skill"] == run.rounds[-1]
