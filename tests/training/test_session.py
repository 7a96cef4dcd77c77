"""What is asked of a training, and what a run that goes on tells of its changes."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from support import create_run

import cgtorch
from cgtorch.ground.asked import NAMES, Purse
from cgtorch.ground.errors import RunError, SettingsError
from cgtorch.runs.journal import TakenOver, remember_goal
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.session import (
    TrainingRequest,
    Work,
    _changes,
    _earlier_stages,
    _one_thread_each,
    continued,
    prepared,
    resumed,
)

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


def test_a_goal_asks_for_rounds_unless_a_stage_is_given() -> None:
    values = {"target": 0.9, "seed": 3, "budget": {"motions": 5}, "device": None, "minutes": None}
    request, others = TrainingRequest.taken_from(values)
    assert request == TrainingRequest("auto", {"target": 0.9}, {"motions": 5})
    assert others == {"seed": 3}
    request, others = TrainingRequest.taken_from({"stage": "S2", "rounds": 2})
    assert (request.stage, request.goal, others) == ("S2", {"rounds": 2}, {})
    request, _ = TrainingRequest.taken_from({"seed": 1})
    assert request == TrainingRequest()


def test_limits_are_numbers_of_what_can_be_asked() -> None:
    for name in NAMES:
        assert TrainingRequest(budget={name: 0}).budget == {name: 0}
    for bad in ({"motions": -1}, {"motions": float("nan")}, {"grasps": 3}):
        with pytest.raises(SettingsError, match="is no limit; give numbers of"):
            TrainingRequest(budget=bad)
    with pytest.raises(SettingsError, match="did you mean 'target'"):
        TrainingRequest(goal={"traget": 1})


@pytest.fixture
def run(tmp_path: Path) -> StoredRun:
    return create_run(tmp_path / "run", RunSettings())


def told(run: StoredRun, changed: dict[str, Any], aside: str | None = None) -> list[str]:
    return list(_changes(TakenOver(run, changed, "S2", aside)))


def test_changes_are_told_and_where_they_begin(run: StoredRun) -> None:
    assert told(run, {}) == []
    assert told(run, {"practice": (5, 6)}) == ["practice is 6 instead of 5 from S2 on"]
    (versions,) = told(run, {"torch": ("2.4", "2.5"), "cgtorch": ("1", "2")})
    assert versions == (
        f"run {run.folder} was made with cgtorch 1 and torch 2.4 so far, this is cgtorch 2 and "
        "torch 2.5: finished stages stay, later results may differ from those of cgtorch 1 and "
        "torch 2.4 from S2 on"
    )
    one, two = told(run, {"practice": (5, 6)}, "aside/1")
    assert one == "practice is 6 instead of 5; S2 begins again"
    assert two == f"the unfinished work on S2 is in {run.folder / 'aside/1'}"


@pytest.mark.parametrize(
    ("stage", "new", "says"),
    [
        ("S0", False, []),
        ("S1", False, ["S1 builds on S0, which is made first"]),
        ("S3", False, ["S3 builds on S0, S1, S2, which are made first"]),
        ("S3", True, []),
        ("auto", False, []),
    ],
)
def test_stages_that_come_first_are_told(
    run: StoredRun, stage: str, new: bool, says: list[str]
) -> None:
    taken = TakenOver(run, {}, "S0", None)
    work = Work(run, stage, Goal(), taken, TrainingRequest(), new, Purse())
    assert list(_earlier_stages(work)) == says


def test_torch_has_one_thread_for_a_while() -> None:
    torch.set_num_threads(2)
    with _one_thread_each():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2


def test_a_goal_is_for_rounds(run: StoredRun) -> None:
    request = TrainingRequest("S1", {"target": 0.9})
    with pytest.raises(SettingsError, match="target, minutes and rounds are for stage 'auto'"):
        prepared(run, run.settings, request)
    work = prepared(run, run.settings, TrainingRequest("auto", {"target": 0.9, "rounds": 2}))
    assert (work.stage, work.auto, work.new) == ("auto", True, True)
    assert (work.goal.target, work.goal.rounds) == (0.9, 2)
    again = prepared(run, run.settings, TrainingRequest(goal={"rounds": 3}, budget={"motions": 4}))
    assert (again.stage, again.goal.target, again.goal.rounds) == ("auto", 0.9, 3)
    assert again.purse.limits == {"motions": 4}
    stage = prepared(run, run.settings, TrainingRequest("S1"))
    assert (stage.stage, stage.auto, stage.goal) == ("S1", False, Goal())
    assert prepared(run, run.settings, TrainingRequest()).stage == "S1"


def test_a_goal_that_is_damaged_is_refused(run: StoredRun) -> None:
    remember_goal(run, {"stage": "auto", "goal": {"traget": 0.9}})
    with pytest.raises(SettingsError, match=r"the goal of run .* is damaged \(.*traget"):
        prepared(run, run.settings, TrainingRequest())


def test_a_run_without_data_cannot_go_on() -> None:
    run = cgtorch.open_run(REFERENCE)
    with pytest.raises(RunError, match="is stored without its data and models"):
        resumed(run, {}, {})


def test_a_run_goes_on_under_its_settings_or_those_that_replace_them(run: StoredRun) -> None:
    assert resumed(run, {}, {}) == run.settings
    assert resumed(run, {"seed": run.settings.seed}, {"practice": 7}).practice == 7
    with pytest.raises(SettingsError, match="leave it out"):
        resumed(run, {"seed": 5}, {})
    with continued(run):
        pass
    about = json.loads((run.folder / "run.json").read_text())
    about["settings"]["practice"] = 77
    (run.folder / "run.json").write_text(json.dumps(about))
    with pytest.raises(RunError, match="has other settings by now; open it again"), continued(run):
        pass
