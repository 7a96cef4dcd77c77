"""What is asked of a training, and what a run that goes on tells of its changes."""

import json
import os
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from members import nearly
from reaching import TABLE
from support import create_run, seeded
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from told_by_runs import logged
from walking import StagedWalking, Walking

import cgtorch
from cgtorch import native, write_data
from cgtorch.domains.settings import LAST, DomainSettings
from cgtorch.evolution.population import random_population
from cgtorch.ground import distributed as ranks
from cgtorch.ground.asked import NAMES, Purse
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DataError, RunError, SettingsError
from cgtorch.improvement.checkpoint import Found
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    SkillAccepted,
    StageStarted,
    TrainingEnded,
)
from cgtorch.report import ProgressDisplay
from cgtorch.report.messages import message_of
from cgtorch.runs.journal import FileJournal, TakenOver, goes_on_to, remember_goal
from cgtorch.runs.settings import Goal, RunSettings
from cgtorch.runs.stored_run import AUTO, StoredRun, read_about
from cgtorch.runs.writer import WRITER, sole_writer
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.training import session
from cgtorch.training import train as module
from cgtorch.training.session import (
    TrainingRequest,
    Work,
    _board,
    _changes,
    _earlier_stages,
    _one_thread_each,
    _stage,
    begun,
    carry_out,
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
        with pytest.raises(SettingsError, match="is no limit; give whole numbers of"):
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
    compiled = native.use_threads(99)
    with _one_thread_each():
        assert torch.get_num_threads() == 1
        assert native.use_threads(compiled) == ranks.cores(), "compiled code has all of its cores"
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
    assert goes_on_to(run)["goal"] == {"target": 0.9, "minutes": Goal().minutes, "rounds": 3}
    other = prepared(run, run.settings, TrainingRequest("auto", {"rounds": 3}))
    assert other.goal == Goal(rounds=3), "as who names the stage begins anew"
    stage = prepared(run, run.settings, TrainingRequest("S1"))
    assert (stage.stage, stage.auto, stage.goal) == ("S1", False, Goal())
    assert goes_on_to(run) == {"stage": "S1"}
    assert prepared(run, run.settings, TrainingRequest()).stage == "S1"


@pytest.mark.parametrize("part", ["start", "journal"])
def test_work_on_what_has_begun_is_not_new(part: str, run: StoredRun) -> None:
    (run.folder / part).mkdir()
    assert not prepared(run, run.settings, TrainingRequest()).new


@dataclass(frozen=True)
class Staged(DomainSettings):
    """Settings under which all stages are made by default."""

    usual_stage: ClassVar[str] = LAST


def test_the_usual_stage_is_that_of_the_domain(run: StoredRun) -> None:
    assert prepared(run, run.settings, TrainingRequest()).stage == "S2"
    staged = StagedWalking()
    object.__setattr__(staged, "stages", {"first": "short", "second": "any"})
    walks = replace(run, domain=staged)
    assert _stage(walks, TrainingRequest(), {}) == "auto"
    staged.settings = Staged()
    assert _stage(walks, TrainingRequest(), {}) == "second"
    assert _stage(walks, TrainingRequest(), {"stage": "first"}) == "first"
    object.__setattr__(staged, "stages", {})
    assert _stage(walks, TrainingRequest(), {}) == "auto"


def test_with_rewards_the_target_is_a_return(run: StoredRun) -> None:
    walks = replace(run, domain=Walking())
    for given, target in (({}, Walking.target_return), ({"target": -7.0}, -7.0)):
        assert prepared(walks, run.settings, TrainingRequest("auto", given)).goal.target == target


def test_a_run_that_has_produced_nothing_takes_other_settings(tmp_path: Path) -> None:
    """One that has done so is not changed."""
    folder, own, request = tmp_path / "run", DomainSettings(), TrainingRequest()
    settings = RunSettings(domain="examples.cart:Cart")
    for population in (30, 40):
        with begun(folder, replace(settings, population=population), own, request) as run:
            assert (folder / WRITER).exists()  # nobody else writes
            assert read_about(folder)["settings"]["population"] == population
            assert run.settings.population == population
    (folder / "start").mkdir()
    with begun(folder, replace(settings, population=40), own, request) as run:
        assert run.settings.population == 40
    other = replace(settings, population=50)
    says = r"has population 40, not 50; choose another run folder \(folder, --run-dir\)"
    with pytest.raises(SettingsError, match=says), begun(folder, other, own, request):
        pass
    assert read_about(folder)["settings"]["population"] == 40
    assert not (folder / WRITER).exists()


def test_the_second_to_begin_a_run_is_told_who_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, folder = RunSettings(domain="examples.cart:Cart"), tmp_path / "run"
    plan = session.planned_run
    monkeypatch.setattr(session, "SOON", 0)
    with ExitStack() as first:

        def second(*about: Any, **how: Any) -> StoredRun:
            create_run(folder, settings)
            first.enter_context(sole_writer(folder))
            return plan(*about, **how)

        monkeypatch.setattr(session, "planned_run", second)
        asked = folder, settings, DomainSettings(), TrainingRequest()
        with pytest.raises(RunError, match="is written by process"), begun(*asked):
            pass


def test_a_run_whose_name_is_no_text_is_not_begun(tmp_path: Path) -> None:
    folder = Path(os.fsdecode(bytes(tmp_path) + b"/M\xfcller"))
    asked = folder, RunSettings(domain="examples.cart:Cart"), DomainSettings(), TrainingRequest()
    with pytest.raises(RunError, match="is no valid UTF-8; rename"), begun(*asked):
        pass
    assert not folder.exists()


@pytest.mark.parametrize(
    ("settings", "request_", "error"),
    [
        ({}, TrainingRequest("S9"), SettingsError),
        ({}, TrainingRequest("auto", {"target": 1.5}), SettingsError),
        ({"data": ("none.csv",)}, TrainingRequest(), DataError),
    ],
)
def test_what_cannot_work_leaves_no_folder(
    settings: dict[str, Any], request_: TrainingRequest, error: type[Exception], tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    with (
        pytest.raises(error),
        begun(folder, RunSettings(**settings), TabletopSettings(), request_),
    ):
        pass
    assert not folder.exists()


def test_data_of_a_run_that_begins_are_in_the_form_that_it_reads(tmp_path: Path) -> None:
    data = Dataset(torch.rand(3, 7), torch.rand(3, 3), torch.rand(3, 7), torch.rand(2, 7),
                   torch.tensor([True, False]))  # fmt: skip
    write_data(tmp_path / "log.csv", data, TABLE.percept, TABLE.control)
    settings = RunSettings(data=(str(tmp_path / "log.csv"),))
    with begun(tmp_path / "run", settings, TabletopSettings(), TrainingRequest()) as run:
        assert run.settings.data == settings.data


def accepts(setup: Any, progress: Any, tests: Any, draw: Any) -> Any:
    """A method that finds a skill for all tests at once."""
    skill = replace(nearly(0.5), name=setup.name)
    everything, every = tests.joined(progress.missed), torch.ones(len(tests), dtype=torch.bool)
    every = torch.ones(len(everything), dtype=torch.bool)
    setup.watch(SkillAccepted(setup.name, skill, everything, every, ~every, every, 1.0))
    return replace(progress, skill=skill, solved=progress.solved.joined(everything))


def work_of(run: StoredRun, stage: str, purse: Purse) -> Work:
    taken = TakenOver(run, {"practice": (5, 6)}, "S0", None)
    return Work(run, stage, Goal(), taken, TrainingRequest(), False, purse)


@pytest.fixture
def plain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StoredRun:
    """A run that is trained in a moment."""
    monkeypatch.setitem(module.METHODS, "compose", accepts)
    run = create_run(tmp_path / "run", RunSettings(models="none"))
    return replace(run, domain=TABLE)


def test_a_training_says_what_is_made_and_changed_and_tells_everything(
    plain: StoredRun, capfd: pytest.CaptureFixture[str]
) -> None:
    told, threads = list[Event](), set[int]()

    def watch(event: Event) -> str:
        told.append(event)
        threads.add(torch.get_num_threads())
        return "only True ends it"

    purse = Purse()
    with ProgressDisplay(quiet=False) as display:
        found = carry_out(work_of(plain, "S1", purse), display, watch)
    text = "".join(capfd.readouterr())
    accepted = [message_of(event) for event in told if isinstance(event, SkillAccepted)]
    assert len(accepted) == 2
    assert all(line in text for line in accepted)
    assert text.index("S1 builds on S0") < text.index("practice is 6 instead of 5 from S0 on")
    assert [result["stage"] for result in found] == ["S0", "S1"]
    assert found == plain.results
    assert threads == {1}
    assert [e.stage for e in told if isinstance(e, StageStarted)] == ["S0", "S1"]
    assert not any(isinstance(event, TrainingEnded) for event in told)
    assert list(plain.folder.glob("*.tfevents.*"))


def test_rounds_for_which_there_is_no_time_end_all_the_same(plain: StoredRun) -> None:
    work = replace(work_of(plain, AUTO, Purse()), goal=Goal(target=0.75, minutes=0))
    with ProgressDisplay(quiet=True) as display:
        assert carry_out(work, display, None) == []
    (ended,) = logged(plain.folder, "ended")
    assert (ended["stage"], ended["reached"], ended["target"]) == ("auto", False, 0.75)


def test_a_training_that_is_stopped_returns_what_it_has(plain: StoredRun) -> None:
    def stop(event: Event) -> bool:
        return isinstance(event, SkillAccepted) and event.stage == "S1"

    with ProgressDisplay(quiet=True) as display:
        found = carry_out(work_of(plain, "S3", Purse()), display, stop)
    assert [result["stage"] for result in found] == ["S0"]


def test_pictures_and_numbers_go_on_where_an_interruption_has_left_them(run: StoredRun) -> None:
    """First models are one step, and what is recalled counts once it is told."""
    (run.folder / "start").mkdir()
    journal = FileJournal(run.folder / "journal" / "S0")
    journal.record("evolution", {"generations": torch.tensor(5)})
    champion = random_population(1, run.actions, 4, (2, 4), seeded(0))
    found = Found(champion, torch.zeros(0), 0.5, 2, generations=5, transitions=30, seconds=1.5)
    with _board(run, {"population": 4321}) as board:
        assert board.step == 1  # type: ignore[attr-defined]
        board(StageStarted("S0", ("S0",), 0, 5, 3))
        board(EvolutionRecalled("S0", "S0.1", found))
        assert board.step == 6  # type: ignore[attr-defined]
        tests = TABLE.tests("near")
        good = torch.ones(5, dtype=torch.bool)
        board(SkillAccepted("S0", nearly(0.5), tests, good, ~good, good, 1.5))
    written = EventAccumulator(str(run.folder), size_guidance={"images": 0, "tensors": 0}).Reload()
    tags = written.Tags()
    assert tags["images"] == ["graph/best", "scenarios/solved"]
    assert "4321" in str(written.Tensors("settings/text_summary"))


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
