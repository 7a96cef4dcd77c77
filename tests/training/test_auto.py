"""The autonomous loop: what it keeps, how it goes on, and when it says that it is done."""

import json
import shutil
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from members import nearly
from support import create_run, seeded
from told_by_runs import asked_at_start, logged
from trained import SMALL, Trained, copied, without_success

from cgtorch.graphs import Skill
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.improvement.events import Event, FreshTested, StageStarted, WorldAsked
from cgtorch.improvement.setup import Progress
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import StoredRun, read_run
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training.auto import EPISODES, TESTING, _tested, _with, act, reached, train_until
from cgtorch.training.context import Training
from cgtorch.training.evaluate import check_percepts
from cgtorch.training.train import NotImprovedError, train

GOAL = Goal(target=0.99, rounds=2)
"""More than two small rounds can reach."""


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def ignore(event: Event) -> None:
    """Nobody watches."""


def prepared(
    trained: Trained, folder: Path, stages: tuple[str, ...] = (), **settings: Any
) -> StoredRun:
    """A copy of the small run under settings of its own."""
    copied(trained, folder, stages)
    about = json.loads((folder / "run.json").read_text())
    about["settings"].update(settings)
    (folder / "run.json").write_text(json.dumps(about))
    return read_run(folder)


Made = tuple[StoredRun, list[Event], list[dict[str, Any]]]


def rounds_of(run: StoredRun, goal: Goal) -> Made:
    """A run with what is told of its rounds, and their results."""
    events: list[Event] = []
    return run, events, train_until(Training(run, events.append, quietly), goal)


@pytest.fixture(scope="module")
def made(trained: Trained, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A run of two rounds, from the start on."""
    return rounds_of(prepared(trained, tmp_path_factory.mktemp("auto") / "run", attempts=2), GOAL)


def test_rounds_are_stages_of_the_run(made: Made) -> None:
    run, events, results = made
    assert run.stages == run.rounds == ("auto-1", "auto-2")
    assert [r["stage"] for r in results] == ["auto-1", "auto-2"]
    assert read_run(run.folder).results == results
    assert last_skill(run.folder)[1].name == results[-1]["skill"]
    assert [e.stage for e in events if isinstance(e, StageStarted)] == ["auto-1", "auto-2"]
    ended = logged(run.folder, "ended")[-1]
    assert ended["reached"] == reached(GOAL, results)
    assert ended["target"] == GOAL.target
    told = [e for e in events if isinstance(e, FreshTested) and not e.decisive]
    assert [(e.stage, e.skill, e.succeeded, e.tried) for e in told] == [
        (r["stage"], r["skill"], r["fresh"]["succeeded"], r["fresh"]["tried"]) for r in results
    ]
    for result in results:
        assert result["practice"] == run.settings.practice == 4
        assert 0 <= result["in_a_row"] <= 4
        assert result["mean_holds"] is None  # as shares count
    with pytest.raises(
        RunError, match="cannot make a single stage any more; continue with stage 'auto'"
    ):
        train(Training(run, ignore, quietly), "S0")


def practised(events: list[Event], name: str) -> int:
    """Number of fresh scenarios that a round has practised on."""
    asked = [e for e in events if isinstance(e, WorldAsked) and e.stage == name]
    return sum(e.asked.episodes for e in asked if e.phase == "practice")


def tries_of(result: dict[str, Any]) -> int:
    """Number of fresh scenarios that a round's skill was tested on."""
    return sum(test["tried"] for test in (result["fresh"], result["decisive"]) if test)


def test_every_round_keeps_w_and_what_it_saw(made: Made) -> None:
    """Eq. 1 over the rounds; whatever was met is in W or in M, with its first percept."""
    run, events, results = made
    before = missed = met = 0
    open_before = set[int]()
    for result in results:
        progress = load_progress(run, run.folder / result["stage"])
        assert progress.skill is not None
        assert try_skill(progress.skill, run.domain.world(progress.solved)).succeeded.all()
        assert not try_skill(progress.skill, run.domain.world(progress.missed)).succeeded.any()
        assert (result["w_size"], result["w_lost"], result["targets"]) == (before, 0, missed)
        solved = set(progress.solved.seed.tolist())
        assert result["targets_succeeded"] == len(open_before & solved)
        open_before = set(progress.missed.seed.tolist())
        met += practised(events, result["stage"]) + tries_of(result)
        before, missed = len(progress.solved), len(progress.missed)
        assert before + missed == met
        every = progress.solved.joined(progress.missed)
        assert progress.seen is not None
        assert torch.equal(progress.seen, first_percepts(run.domain.world(every)))
    assert torch.unique(progress.solved.object, dim=0).shape[0] == before


def test_what_was_asked_adds_up_over_the_rounds(made: Made) -> None:
    """Tests on fresh scenarios ask a simulated world only; a robot is not asked for them."""
    run, events, results = made
    told = [e for e in events if isinstance(e, WorldAsked)]
    spent = {name: Asked(**counts) for name, counts in asked_at_start(run.folder).items()}
    assert set(spent) == {"exploration"}
    for result in results:
        for event in told:
            if event.stage == result["stage"]:
                spent[event.phase] = spent.get(event.phase, Asked()) + event.asked
        assert result["asked"] == {phase: vars(asked) for phase, asked in spent.items()}
    assert {"looks", "practice"} <= set(spent)


@pytest.mark.hostile
def test_a_round_that_is_interrupted_asks_no_more_than_one_that_is_not(
    made: Made, tmp_path: Path
) -> None:
    """It is stopped after each trial in turn; what the journal has is not asked again.

    It ends as the one that was not, from the first round on: the same results and files.
    """
    run, events, results = made
    folder = tmp_path / "run"
    shutil.copytree(run.folder, folder, ignore=shutil.ignore_patterns("auto-2"))
    wanted = [e for e in events if isinstance(e, WorldAsked) and e.stage == "auto-2"]
    asked: list[WorldAsked] = []
    for _ in wanted:

        def stop(event: Event) -> None:
            if isinstance(event, WorldAsked) and not event.recalled:
                asked.append(event)
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            train_until(Training(read_run(folder), stop, quietly), GOAL)
    assert asked == wanted
    _, told, found = rounds_of(read_run(folder), GOAL)
    again = [e for e in told if isinstance(e, WorldAsked)]
    assert again == [replace(e, recalled=True) for e in wanted]
    timed = {"seconds": 0, "search_seconds": 0}
    assert [r | timed for r in found] == [r | timed for r in results]
    for name in ("skill.json", "scenarios.json", "data.safetensors", "seen.safetensors"):
        was = (run.folder / "auto-2" / name).read_bytes()
        assert (folder / "auto-2" / name).read_bytes() == was


def test_without_time_or_rounds_nothing_is_begun(made: Made) -> None:
    run, _, results = made
    events: list[Event] = []
    for goal in (Goal(target=0.95, minutes=0), GOAL, Goal(target=0.95, rounds=1)):
        assert train_until(Training(run, events.append, quietly), goal) == results
    assert events == []


def test_rounds_go_on_after_stages_and_end_at_the_goal(trained: Trained, tmp_path: Path) -> None:
    """The loop ends with the first test that decides; a run that is done makes no more rounds."""
    run = prepared(trained, tmp_path / "run", ("S0", "S1"), attempts=2)
    goal = Goal(target=0.5, rounds=6)
    events: list[Event] = []
    results = train_until(Training(run, events.append, quietly), goal)
    assert [r["stage"] for r in results[:2]] == ["S0", "S1"]
    assert reached(goal, results[2:])
    last = results[-1]
    assert last["decisive"]["tried"] == goal.decisive == 200
    assert last["decisive"]["succeeded"] >= 100
    assert last["overall"] == last["decisive"]
    assert [e.decisive for e in events if isinstance(e, FreshTested)][-2:] == [False, True]
    assert train_until(Training(run, events.append, quietly), goal) == results
    kept = load_progress(run, run.folder / "S1")
    final = last_skill(run.folder)[1]
    assert try_skill(final, run.domain.world(kept.solved)).succeeded.all()


def test_a_round_that_finds_nothing_at_all(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_success(monkeypatch)
    run = prepared(trained, tmp_path / "run", attempts=2, generations=1)
    with pytest.raises(NotImprovedError, match="stage auto-1 found no skill"):
        train_until(Training(run, ignore, quietly), Goal(target=0.5, rounds=1))
    assert run.stages == ()


SCREENED = {"fresh": {"scenarios": "perimeter", "tried": 400, "succeeded": 300}}


def decided(succeeded: int, tried: int) -> dict[str, Any]:
    score = {"scenarios": "perimeter", "tried": tried, "succeeded": succeeded}
    return {**SCREENED, "decisive": score}


def test_only_the_last_round_can_reach_the_goal() -> None:
    goal, none = Goal(target=0.99), {**SCREENED, "decisive": None}
    assert not reached(goal, [])
    assert not reached(goal, [none])
    assert reached(goal, [none, decided(3970, 4000)])
    assert not reached(goal, [decided(3990, 4000), none])
    assert not reached(goal, [decided(3900, 4000)])
    many = [decided(3900, 4000)] * 20
    assert not reached(goal, [*many, decided(3970, 4000)])  # luck has had many chances
    assert reached(goal, [*many, decided(3985, 4000)])


def untested(in_a_row: int, practice: int = 24) -> dict[str, Any]:
    """A round in a world that does not repeat itself."""
    untested = dict.fromkeys(("fresh", "overall", "decisive"))
    return {**untested, "in_a_row": in_a_row, "practice": practice}


def test_where_no_world_can_be_put_back_practice_reaches_the_goal() -> None:
    """Whatever the goal's target: it is a share of fresh scenarios, of which none are tried."""
    for goal in (Goal(target=0.5), Goal(target=0.999)):
        assert reached(goal, [untested(24)])
        assert reached(goal, [untested(3), untested(30)])
        assert not reached(goal, [untested(23)])
        assert not reached(goal, [untested(24), untested(0)])
        assert not reached(goal, [untested(0, practice=0)])  # with rewards nothing is practised
        assert not reached(goal, [untested(24), {**SCREENED, "decisive": None}])


@pytest.mark.parametrize(
    ("most", "enough", "tried"), [(50, 12, 50), (850, 10**6, 850), (850, 1, 400), (850, 401, 800)]
)
def test_acting_ends_where_enough_was_missed(
    most: int, enough: int, tried: int, tmp_path: Path
) -> None:
    run, skill = create_run(tmp_path / "run", RunSettings()), nearly(0.3)
    score = act(run, None, most, seeded(3), enough=enough)
    assert score.tried == len(score.scenarios) == tried
    assert score.successes == 0
    assert len(score.scenarios.seed.unique()) == tried
    assert torch.equal(score.percepts, first_percepts(run.domain.world(score.scenarios)))
    some = act(run, skill, 20, seeded(3))
    again = try_skill(skill, run.domain.world(some.scenarios))
    assert torch.equal(some.succeeded, again.succeeded)
    assert torch.equal(some.percepts, again.percepts)


def test_acting_ends_early_once_the_time_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, purse = create_run(tmp_path / "run", RunSettings()), Purse()
    monkeypatch.setattr("cgtorch.training.auto.BATCH", 40)
    for ago, tried in ((2 * TESTING, EPISODES), (TESTING / 2, EPISODES + 50), (-99, EPISODES + 50)):
        purse.until = time.monotonic() - ago
        found = act(run, nearly(0.3), EPISODES + 50, seeded(0), 999, purse)
        assert found.tried == tried
    assert act(run, nearly(0.3), EPISODES + 50, seeded(0), 999).tried == EPISODES + 50


def test_what_was_tried_joins_w_and_m_with_what_was_seen(tmp_path: Path) -> None:
    run = create_run(tmp_path / "run", RunSettings())
    none = run.domain.draw(run.kind, 0, seeded(0))
    progress: Progress[Any] = Progress(None, none, none, None)
    for seed in (1, 2):
        score = act(run, nearly(0.3), 30, seeded(seed), 999)
        assert 0 < score.successes < 30
        before, progress = progress, _with(progress, score)
        assert len(progress.solved) == len(before.solved) + score.successes
        assert len(progress.missed) == len(before.missed) + 30 - score.successes
        world = run.domain.world(progress.solved.joined(progress.missed))
        assert progress.seen is not None
        assert torch.equal(progress.seen, first_percepts(world))
        assert try_skill(nearly(0.3), run.domain.world(progress.solved)).succeeded.all()


@pytest.mark.parametrize("skill", [None, nearly(0.3)])
def test_a_test_names_the_skill_that_is_tried(skill: Skill | None, tmp_path: Path) -> None:
    """It may be that of an earlier round; without one, all is missed."""
    run, events = create_run(tmp_path / "run", RunSettings()), list[Event]()
    none = run.domain.draw(run.kind, 0, seeded(0))
    progress: Progress[Any] = Progress(skill, none, none, None)
    training = Training(run, events.append, quietly)
    goal = Goal(target=0.5)
    _, (score, *_), _ = _tested(training, goal, "auto-7", 0, progress, seeded(1))
    first = events[0]
    assert isinstance(first, FreshTested)
    assert (first.stage, first.skill) == ("auto-7", "auto-7" if skill is None else skill.name)
    assert first.succeeded == score.successes
    assert (first.succeeded > 0) is (skill is not None)


@pytest.mark.hostile
def test_rounds_on_tables_of_any_kind(tmp_path: Path) -> None:
    """Everything is drawn from the run's scenarios, and all of a skill reads all of a percept.

    There are things in the way, which are seen from their edges.
    """
    settings = replace(SMALL, scenarios="general-clutter", population=100, generations=30)
    wide = None
    for seed in range(8):  # so small a search finds nothing under some seeds
        folder = tmp_path / str(seed)
        with suppress(NotImprovedError):
            made = create_run(folder, replace(settings, seed=seed))
            wide = rounds_of(made, Goal(target=0.5, rounds=1))
            break
    assert wide is not None, "no seed has found a skill"
    run, _, results = wide
    assert {results[0][name]["scenarios"] for name in ("fresh", "overall")} == {"general-clutter"}
    again, skill = last_skill(run.folder)
    check_percepts(skill, 13, "the run's scenarios")
    progress = load_progress(again, again.folder / "auto-1")
    met = practised(wide[1], "auto-1") + tries_of(results[0])
    assert len(progress.solved) + len(progress.missed) == met
    assert progress.knowledge.dataset.percept.shape[1] == 13
    both = torch.cat([progress.solved.obstacles, progress.missed.obstacles])
    assert 0.3 < float((both[:, 0, 3] > 0).float().mean()) < 0.7
    for scenarios, solved in ((progress.solved, True), (progress.missed, False)):
        assert len(scenarios.table[:, 2:].unique(dim=0)) == len(scenarios) > 0
        succeeded = try_skill(skill, again.domain.world(scenarios)).succeeded
        assert succeeded.eq(solved).all()
    with pytest.raises(SettingsError, match="use stage 'auto'"):
        train(Training(run, ignore, quietly), "S0")


@pytest.mark.hostile
def test_what_a_robots_world_was_asked_before_a_kill_is_not_asked_again(tmp_path: Path) -> None:
    """Nothing repeats itself there, so the rest of the round is another one; counts go on."""
    settings = replace(SMALL, attempts=3)
    run = create_run(tmp_path / "run", settings, TabletopSettings(noise="fresh"))
    told, again = list[WorldAsked](), list[Event]()

    def stop(event: Event) -> None:
        if isinstance(event, WorldAsked):
            told.append(event)
            if len(told) == 5:
                raise KeyboardInterrupt

    goal = Goal(target=0.5, rounds=1)
    with pytest.raises(KeyboardInterrupt):
        train_until(Training(run, stop, quietly), goal)
    (result,) = train_until(Training(read_run(run.folder), again.append, quietly), goal)
    asked = [e for e in again if isinstance(e, WorldAsked)]
    assert asked[:4] == [replace(e, recalled=True) for e in told[1:]]
    assert not any(e.recalled for e in asked[4:])
    spent: dict[str, Asked] = {}
    for event in (told[0], *asked):
        spent[event.phase] = spent.get(event.phase, Asked()) + event.asked
    assert result["asked"] == {phase: vars(each) for phase, each in spent.items()}
    progress = load_progress(run, run.folder / "auto-1")
    assert len(progress.solved) + len(progress.missed) == spent["practice"].episodes
    assert [result[name] for name in ("fresh", "overall", "decisive")] == [None] * 3
    assert result["practice"] == SMALL.practice


COUNTED = {"in_a_row": 3, "practice": 4}


@pytest.mark.parametrize("lost", ["in_a_row", "practice", "fresh"])
def test_a_round_that_does_not_say_how_it_was_tested_has_reached_nothing(
    made: Made, lost: str
) -> None:
    sound = {**made[2][0], **dict.fromkeys(("fresh", "overall", "decisive")), **COUNTED}
    assert not reached(GOAL, [{name: each for name, each in sound.items() if name != lost}])
