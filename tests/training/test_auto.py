"""The autonomous loop: what it keeps, how it goes on, and when it says that it is done."""

import json
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from support import create_run, seeded
from trained import SMALL, Trained, copied

from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.improvement.events import Event, FreshTested, StageStarted
from cgtorch.improvement.trial import try_skill
from cgtorch.runs.goal import Goal
from cgtorch.runs.run import Run, open_run
from cgtorch.runs.skills import last_skill
from cgtorch.runs.storage import load_progress, load_result
from cgtorch.training.auto import BATCH, act, reached, train_until
from cgtorch.training.context import Training
from cgtorch.training.evaluate import check_percepts
from cgtorch.training.train import NotImprovedError, train

GOAL = Goal(target=0.99, rounds=2)
"""More than two small rounds can reach."""


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def ignore(event: Event) -> None:
    """Nobody watches."""


def prepared(trained: Trained, folder: Path, stages: tuple[str, ...] = (), **settings: Any) -> Run:
    """A copy of the small run under settings of its own."""
    copied(trained, folder, stages)
    about = json.loads((folder / "run.json").read_text())
    about["settings"].update(settings)
    (folder / "run.json").write_text(json.dumps(about))
    return open_run(folder)


Made = tuple[Run, list[Event], list[dict[str, Any]]]


@pytest.fixture(scope="module")
def made(trained: Trained, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A run of two rounds, from the start on."""
    run = prepared(trained, tmp_path_factory.mktemp("auto") / "run", attempts=2)
    events: list[Event] = []
    return run, events, train_until(Training(run, events.append, quietly), GOAL)


def test_rounds_are_stages_of_the_run(made: Made) -> None:
    run, events, results = made
    assert run.stages == run.rounds == ("auto-1", "auto-2")
    assert [r["stage"] for r in results] == ["auto-1", "auto-2"]
    assert [load_result(run.folder / r["stage"] / "result.json") for r in results] == results
    assert last_skill(run.folder)[1].name == results[-1]["skill"]
    assert [e.stage for e in events if isinstance(e, StageStarted)] == ["auto-1", "auto-2"]
    summary = json.loads((run.folder / "summary.json").read_text())
    assert summary["stages"] == results
    assert summary["reached"] == reached(GOAL, results)
    assert summary["target"] == GOAL.target


def test_every_round_keeps_w_and_what_it_saw(made: Made) -> None:
    """Eq. 1 over the rounds; whatever was met is in W or in M."""
    run, _, results = made
    before, missed, met = 0, BATCH, BATCH
    for result in results:
        progress = load_progress(run, run.folder / result["stage"])
        assert progress.skill is not None
        assert try_skill(progress.skill, run.domain.world(progress.solved)).succeeded.all()
        assert not try_skill(progress.skill, run.domain.world(progress.missed)).succeeded.any()
        assert (result["w_size"], result["w_lost"], result["targets"]) == (before, 0, missed)
        assert result["targets_succeeded"] > 0
        met += result["fresh"]["tried"] + (result["decisive"] or {"tried": 0})["tried"]
        before, missed = len(progress.solved), len(progress.missed)
        assert before + missed == met
    assert torch.unique(progress.solved.object, dim=0).shape[0] == before


def test_fresh_placements_are_told(made: Made) -> None:
    _, events, results = made
    told = [e for e in events if isinstance(e, FreshTested) and not e.decisive]
    assert [(e.stage, e.skill, e.succeeded, e.tried) for e in told] == [
        (r["stage"], r["skill"], r["fresh"]["succeeded"], r["fresh"]["tried"]) for r in results
    ]


def test_a_run_goes_on_from_its_last_round(made: Made, tmp_path: Path) -> None:
    """A run that lost its second round makes the same again."""
    folder = tmp_path / "run"
    shutil.copytree(made[0].folder, folder, ignore=shutil.ignore_patterns("auto-2", "summary.json"))
    results = train_until(Training(open_run(folder), ignore, quietly), GOAL)
    timed = {"seconds": 0, "search_seconds": 0}
    assert [r | timed for r in results] == [r | timed for r in made[2]]
    for name in ("skill.json", "scenarios.json", "data.safetensors"):
        was = (made[0].folder / "auto-2" / name).read_bytes()
        assert (folder / "auto-2" / name).read_bytes() == was


def test_without_time_or_rounds_nothing_is_begun(made: Made) -> None:
    run, _, results = made
    events: list[Event] = []
    for goal in (Goal(target=0.95, minutes=0), GOAL, Goal(target=0.95, rounds=1)):
        assert train_until(Training(run, events.append, quietly), goal) == results
    assert events == []


def test_a_run_with_rounds_has_no_further_stages(made: Made) -> None:
    with pytest.raises(
        RunError, match="cannot make a single stage any more; continue with --stage auto"
    ):
        train(Training(made[0], ignore, quietly), "S0")


def test_rounds_go_on_after_stages_and_end_at_the_goal(trained: Trained, tmp_path: Path) -> None:
    """The loop ends with the first test that decides; a run that is done makes no more rounds."""
    run = prepared(trained, tmp_path / "run", ("S0", "S1"), attempts=2)
    goal = Goal(target=0.5, rounds=6)
    events: list[Event] = []
    results = train_until(Training(run, events.append, quietly), goal)
    assert [r["stage"] for r in results[:2]] == ["S0", "S1"]
    assert reached(goal, results[2:])
    last = results[-1]
    assert last["decisive"]["tried"] == goal.decisive == 80
    assert last["decisive"]["succeeded"] >= 40
    assert last["overall"] == last["decisive"]
    assert [e.decisive for e in events if isinstance(e, FreshTested)][-2:] == [False, True]
    assert train_until(Training(run, events.append, quietly), goal) == results
    kept = load_progress(run, run.folder / "S1")
    final = last_skill(run.folder)[1]
    assert try_skill(final, run.domain.world(kept.solved)).succeeded.all()


def test_a_round_that_finds_nothing_at_all(trained: Trained, tmp_path: Path) -> None:
    """One generation of two individuals can be lucky, but not under every seed."""
    hasty = {"population": 2, "generations": 1, "attempts": 1}

    def error(seed: int) -> str:
        run = prepared(trained, tmp_path / str(seed), seed=seed, **hasty)
        try:
            train_until(Training(run, ignore, quietly), Goal(target=0.5, rounds=1))
        except NotImprovedError as e:
            return "" if run.stages else str(e)
        return ""

    message = next(filter(None, map(error, range(20))))
    assert "stage auto-1 found no skill" in message


def decided(succeeded: int, tried: int) -> dict[str, Any]:
    return {"decisive": {"scenarios": "perimeter", "tried": tried, "succeeded": succeeded}}


def test_only_the_last_round_can_reach_the_goal() -> None:
    goal, none = Goal(target=0.99), {"decisive": None}
    assert not reached(goal, [])
    assert not reached(goal, [none])
    assert reached(goal, [none, decided(3970, 4000)])
    assert not reached(goal, [decided(3990, 4000), none])
    assert not reached(goal, [decided(3900, 4000)])
    many = [decided(3900, 4000)] * 20
    assert not reached(goal, [*many, decided(3970, 4000)])  # luck has had many chances
    assert reached(goal, [*many, decided(3985, 4000)])


@pytest.mark.parametrize(
    ("most", "enough", "tried"), [(50, 12, 50), (850, 10**6, 850), (850, 1, 400), (850, 401, 800)]
)
def test_acting_ends_where_enough_was_missed(
    made: Made, most: int, enough: int, tried: int
) -> None:
    score = act(made[0], None, most, seeded(3), enough=enough)
    assert score.tried == len(score.scenarios) == tried
    assert score.successes == 0
    assert len(score.scenarios.seed.unique()) == tried


def test_acting_is_trying_in_the_world(made: Made) -> None:
    run, _, _ = made
    skill = last_skill(run.folder)[1]
    score = act(run, skill, 20, seeded(3))
    again = try_skill(skill, run.domain.world(score.scenarios))
    assert torch.equal(again.succeeded, score.succeeded)


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A round on tables of any kind with things in the way, seen from their edges."""
    settings = replace(
        SMALL,
        scenarios="general-clutter",
        transitions=100,
        labels=300,
        attempts=1,
    )
    run = create_run(tmp_path_factory.mktemp("wide") / "run", settings)
    events: list[Event] = []
    return (
        run,
        events,
        train_until(Training(run, events.append, quietly), Goal(target=0.5, rounds=1)),
    )


def test_rounds_on_tables_of_any_kind(wide: Made) -> None:
    """Everything is drawn from the run's scenarios, and all of a skill reads all of a percept."""
    run, _, results = wide
    assert {results[0][name]["scenarios"] for name in ("fresh", "overall")} == {"general-clutter"}
    again, skill = last_skill(run.folder)
    check_percepts(skill, 13, "the run's scenarios")
    progress = load_progress(again, again.folder / "auto-1")
    met = [results[0]["fresh"], *filter(None, [results[0]["decisive"]])]
    succeeded = sum(each["succeeded"] for each in met)
    assert len(progress.solved) == results[0]["targets_succeeded"] + succeeded
    assert progress.knowledge.dataset.percept.shape[1] == 13
    both = torch.cat([progress.solved.obstacles, progress.missed.obstacles])
    assert 0.3 < float((both[:, 0, 3] > 0).float().mean()) < 0.7
    for scenarios, solved in ((progress.solved, True), (progress.missed, False)):
        assert len(scenarios.table[:, 2:].unique(dim=0)) == len(scenarios) > 0
        succeeded = try_skill(skill, again.domain.world(scenarios)).succeeded
        assert succeeded.eq(solved).all()


def test_tables_of_any_kind_have_no_stages(wide: Made) -> None:
    with pytest.raises(SettingsError, match="use --stage auto"):
        train(Training(wide[0], ignore, quietly), "S0")


VALUES: list[Callable[[Any], Any]] = [
    lambda d: 3,
    lambda d: {},
    lambda d: {**d, "tried": -1},
    lambda d: {**d, "succeeded": d["tried"] + 1},
    lambda d: {**d, "scenarios": 3},
    lambda d: {**d, "mean_return": "much"},
    lambda d: {**d, "mean_return": [1.0]},
]


@pytest.mark.parametrize("change", VALUES)
def test_a_damaged_decision(tmp_path: Path, made: Made, change: Callable[[Any], Any]) -> None:
    path = tmp_path / "result.json"
    score = decided(3, 4)["decisive"]
    path.write_text(json.dumps({**made[2][0], "decisive": score}))
    assert load_result(path)["decisive"] == score
    path.write_text(json.dumps({**made[2][0], "decisive": change(score)}))
    with pytest.raises(RunError, match="decisive of "):
        load_result(path)
