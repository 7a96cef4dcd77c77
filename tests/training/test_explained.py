"""What a run's folder says of its last skill, and of the search for it."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import CartDriver
from support import seeded
from trained import Trained, copied, interrupted

import cgtorch
from cgtorch import open_run
from cgtorch.runs.log import read_log
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import save_scenarios
from cgtorch.runs.stored_run import planned_run, read_run
from cgtorch.training.explained import (
    EPISODES,
    KNOWN,
    MISSED,
    _searched,
    _wanted,
    background_of,
    explained,
    searched_of,
)
from cgtorch.training.train import FRESH, FRESH_SEED


def rows(count: int, limit: int, best: list[float], **more: Any) -> list[dict[str, Any]]:
    about = {"solved_w": 1, "size_w": 2, "solved_m": 0, "size_m": 3, "unsolved": 0.5, **more}
    return [
        {
            "event": "generation", "stage": "S0", "candidate": "S0.1", "limit": limit,
            "best": best[i * len(best) // count], **about,
        }
        for i in range(count)
    ]  # fmt: skip


def test_a_trained_stage_has_ended_with_practice(trained: Trained) -> None:
    log = read_log(trained.folder)
    found = searched_of(log, "S1")
    assert found is not None
    own = [row for row in log if row["event"] == "generation" and row["stage"] == "S1"]
    assert (found.stage, found.generations, found.limit) == ("S1", len(own), 15)
    assert (found.ended, found.value) == ("practice", 4)
    assert found.solving == pytest.approx(1 - min(row["unsolved"] for row in own))
    assert found.imagined[0] == max(row["solved_w"] + row["solved_m"] for row in own)
    met = [row for row in log if row["event"] == "asked" and row["stage"] == "S1"]
    assert found.met == (sum(r["succeeded"] for r in met), sum(r["episodes"] for r in met))
    assert searched_of(log, "") == found, "the last one"


@pytest.mark.parametrize(
    ("best", "count", "rising"),
    [
        ([0.1, 0.2, 0.3, 0.4], 20, True),
        ([0.1, 0.4, 0.4, 0.4], 20, False),
        ([0.1, 0.2, 0.3, 0.4], 12, False),  # it ended before its limit
    ],
)
def test_fitness_rises_where_it_is_still_better_in_the_last_quarter(
    best: list[float], count: int, rising: bool
) -> None:
    found = searched_of(rows(count, 20, best), "S0")
    assert found is not None
    assert found.rising == rising
    assert found.best == 0.4


@pytest.mark.parametrize(
    ("more", "ended"),
    [
        ([], ("interrupted", 0)),
        ([{"event": "result", "stage": "S0"}], ("finished", 0)),
        ([{"event": "failed", "stage": "S0"}], ("failed", 0)),
        ([{"event": "failed", "stage": "S1"}], ("interrupted", 0)),
        ([{"event": "practised", "stage": "S0", "wanted": 4, "in_a_row": 4}], ("practice", 4)),
        ([{"event": "practised", "stage": "S0", "wanted": 4, "in_a_row": 3}], ("interrupted", 0)),
        ([{"event": "practised", "stage": "S0", "wanted": 0, "in_a_row": 0}], ("interrupted", 0)),
        ([{"event": "ended", "stage": "auto", "reached": True, "target": 0.9}], ("goal", 0.9)),
        ([{"event": "ended", "stage": "auto", "reached": False, "target": 0.9}], ("limits", 0)),
        ([{"event": "ended", "stage": "S0"}], ("interrupted", 0)),
    ],
)
def test_why_a_search_ended(more: list[dict[str, Any]], ended: tuple[str, float]) -> None:
    found = searched_of([*rows(3, 20, [0.5]), *more], "S0")
    assert found is not None
    assert (found.ended, found.value) == ended
    alone = searched_of(more, "S0")
    told = ended[0] != "interrupted" or any(row["stage"] == "S0" for row in more)
    assert (alone and alone.ended) == (ended[0] if told else None)


def test_the_last_evolution_tells_whether_fitness_rises_and_all_of_them_the_rest() -> None:
    first = rows(20, 30, [0.1, 0.2, 0.3, 0.9], solved_w=2, solved_m=1)
    last = [row | {"candidate": "S0.2"} for row in rows(8, 8, [0.1, 0.1, 0.1, 0.4], unsolved=0.2)]
    other = [row | {"stage": "S1"} for row in rows(5, 40, [1.0], solved_m=3)]
    found = searched_of([*first, *other, *last], "S0")
    assert found is not None
    assert (found.generations, found.limit, found.rising, found.best) == (28, 8, True, 0.9)
    assert (found.solving, found.imagined, found.met) == (0.8, (3, 5), (0, 0))
    later = searched_of([*first, *last, *other], "")
    assert later is not None
    assert (later.stage, later.generations, later.imagined) == ("S1", 5, (4, 5))
    few = searched_of(rows(1, 1, [0.5]), "S0")
    assert few is not None
    assert not few.rising, "there is nothing before it"
    none = searched_of([row | {"best": None} for row in first], "S0")
    assert none is not None
    assert (none.best, none.rising) == (float("-inf"), False)


def test_a_stage_that_has_begun_without_a_generation_may_have_solved_anything() -> None:
    begun = {"event": "stage", "stage": "S0"}
    found = searched_of([begun], "")
    assert found is not None
    assert (found.stage, found.generations, found.limit, found.solving) == ("S0", 0, 0, 1.0)
    assert (found.ended, found.rising, found.best) == ("interrupted", False, float("-inf"))
    assert searched_of([begun], "S1") is None
    assert searched_of([], "") is None


def test_half_of_the_usual_is_little(tmp_path: Path) -> None:
    for population, scarce in ((200, ("--population 200 (usually 400)",)), (201, ())):
        run = planned_run(tmp_path / "run", RunSettings(population=population))
        found = _searched(run, rows(3, 20, [0.5]), "S0")
        assert found is not None
        assert found.scarce == scarce
        assert _searched(run, [], "S0") is None


def test_limits_and_low_settings_are_known(trained: Trained) -> None:
    """The small run has a population of 60 in place of 400, and so on."""
    ended = {"event": "ended", "stage": "auto", "reached": False, "target": 0.9}
    log = [*rows(3, 20, [0.5]), {**ended, "minutes": 0.5, "rounds": 30}]
    found = searched_of(log, "S0")
    assert found is not None
    assert found.limits == "--minutes 0.5, --rounds 30"
    run = read_run(trained.folder)
    searched = background_of(run, run.folder / "S1").searched
    assert searched is not None
    assert searched.limits == ""
    assert searched.scarce == (
        "--generations 15 (usually 150)", "--attempts 5 (usually 24)",
        "--population 60 (usually 400)",
    )  # fmt: skip


def test_kinds_of_stages_that_were_not_made_are_marked(trained: Trained, tmp_path: Path) -> None:
    run = interrupted(trained, tmp_path / "run")
    why = explained(run)
    assert why is not None
    assert why.seed == FRESH_SEED + run.settings.seed
    made = {each.kind: each.made for each in why.found.tried}
    assert made["near"]
    assert not made["left"]


@pytest.mark.parametrize("count", [0, 3, KNOWN + 2])
def test_the_last_that_training_missed_are_tried_too(
    count: int, trained: Trained, tmp_path: Path
) -> None:
    run = read_run(copied(trained, tmp_path / "run"))
    solved = run.like()
    missed = run.domain.draw("far", count, seeded(0))
    save_scenarios(run.folder / "S1" / "scenarios.json", solved, missed)
    why = explained(run)
    assert why is not None
    tried = {each.kind: each.tried for each in why.found.tried}
    assert tried.get(MISSED, 0) == min(count, KNOWN)
    if count:
        last = why.scenarios[-tried[MISSED] :]
        assert torch.equal(last.seed, missed.seed[-KNOWN:])
    (run.folder / "S1" / "scenarios.json").unlink()
    why = explained(run)
    assert why is not None
    assert MISSED not in {each.kind for each in why.found.tried}


@pytest.mark.parametrize(
    ("name", "models", "says"),
    [
        ("examples.cart:Cart", "auto", "Nothing was searched so far."),
        ("gymnasium:CartPole-v1", "auto", "in the world itself, so no model is to blame."),
        ("gymnasium:MountainCarContinuous-v0", "learned", "none in a Γ with rewards."),
    ],
)
def test_a_run_that_has_not_begun_tells_where_it_would_search(
    name: str, models: str, says: str, tmp_path: Path
) -> None:
    run = planned_run(tmp_path / "run", RunSettings(domain=name, models=models))
    (tmp_path / "run").mkdir()
    why = explained(run)
    assert why is not None
    assert why.found.blame.startswith("There is no skill yet.")
    assert why.found.blame.endswith(says)


def test_how_many_scenarios_are_tried(tmp_path: Path) -> None:
    """Those of all stages that have begun, or of the run's kind."""
    cart = planned_run(tmp_path / "run", RunSettings(domain="examples.cart:Cart"))
    assert _wanted(cart, []) == {cart.kind: EPISODES}
    arm = planned_run(tmp_path / "run", RunSettings(domain="metaworld:reach-v3"))
    assert _wanted(arm, []) == {arm.kind: FRESH}
    table = planned_run(tmp_path / "run", RunSettings())
    begun = [{"event": "stage", "stage": name} for name in ("S0", "S1", "auto-1")]
    assert _wanted(table, begun) == {"near": FRESH, "left": FRESH}


def test_a_run_without_a_skill_and_a_run_on_a_robot(tmp_path: Path) -> None:
    run = cgtorch.train(
        "examples.cart:Cart", tmp_path / "cart", stage="auto", minutes=1e-9, quiet=True
    )
    why = explained(run)
    assert why is not None
    assert why.skill is None
    assert why.found.blame.startswith("There is no skill yet.")
    on_robot = open_run(tmp_path / "cart", "examples.cart:Cart")
    object.__setattr__(on_robot.settings, "driver", f"driven_cart:{CartDriver.__name__}")
    assert explained(on_robot) is None


def test_of_a_last_skill_it_is_the_search_for_a_better_one_that_is_told(
    trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    begun = {"event": "stage", "stage": "S2", "stages": ["S2"], "size_w": 0, "size_m": 0}
    with (folder / "log.jsonl").open("a") as log:
        log.write(json.dumps({**begun, "time": 0, "attempts": 1}) + "\n")
    run = open_run(folder)
    searched = [background_of(run, run.folder / name).searched for name in ("S0", "S1")]
    assert [each and each.stage for each in searched] == ["S0", "S2"]
    assert searched[1]
    assert searched[1].ended == "interrupted"
