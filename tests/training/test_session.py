"""What is asked of a training, and what a run that goes on tells of its changes."""

from pathlib import Path
from typing import Any

import pytest
import torch
from support import create_run

from cgtorch.ground.asked import NAMES, Purse
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.journal import TakenOver
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.session import (
    TrainingRequest,
    Work,
    _changes,
    _earlier_stages,
    _one_thread_each,
)


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
