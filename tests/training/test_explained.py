"""What a run's folder says of its last skill, and of the search for it."""

import json
from pathlib import Path

import pytest
import torch
from driven_cart import CartDriver
from support import seeded
from told_by_runs import generation_rows
from trained import Trained, copied, interrupted

import cgtorch
from cgtorch import open_run
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
)
from cgtorch.training.searched import searched_of
from cgtorch.training.train import FRESH, FRESH_SEED


def test_half_of_the_usual_is_little(tmp_path: Path) -> None:
    for population, scarce in ((200, ("--population 200 (usually 400)",)), (201, ())):
        run = planned_run(tmp_path / "run", RunSettings(population=population))
        found = _searched(run, generation_rows(3, 20, [0.5]), "S0")
        assert found is not None
        assert found.scarce == scarce
        assert _searched(run, [], "S0") is None


def test_limits_and_low_settings_are_known(trained: Trained) -> None:
    """The small run has a population of 60 in place of 400, and so on."""
    ended = {"event": "ended", "stage": "auto", "reached": False, "target": 0.9}
    log = [*generation_rows(3, 20, [0.5]), {**ended, "minutes": 0.5, "rounds": 30}]
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
    (run.folder / "S1" / "seen.safetensors").unlink()  # which was about others
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
