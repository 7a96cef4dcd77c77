"""Runs as folders: whole or not at all, made alike from the same seed, and never led astray."""

import errno
import itertools
import json
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from support import create_run, random_skill
from told_by_runs import asked_at_start, result_of
from trained import SMALL, Trained, copied, without_success

from cgtorch.graphs import save_skill, skill_to_dict
from cgtorch.ground.asked import NAMES, Asked, Purse
from cgtorch.ground.errors import ActionError, GraphError, RunError
from cgtorch.ground.files import whole_folder
from cgtorch.improvement.events import (
    Event,
    EvolutionRecalled,
    GenerationDone,
    ModelsFitted,
    Practised,
    StageStarted,
    WorldAsked,
    WorldTested,
)
from cgtorch.runs.chosen import last_skill, lone_skill
from cgtorch.runs.log import Row, read_log
from cgtorch.runs.storage import load_progress
from cgtorch.runs.stored_run import read_run
from cgtorch.simulation import Recording
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.domain import ACTIONS, Tabletop
from cgtorch.training.context import Training
from cgtorch.training.train import NotImprovedError, train


def listing(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def quietly(message: str) -> nullcontext[None]:
    return nullcontext()


def test_a_folder_appears_with_all_its_files(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "S0") as folder:
        (folder / "one").write_text("1")
        assert not (tmp_path / "S0").exists()
        (folder / "two").write_text("2")
    assert listing(tmp_path) == {"S0", "S0/one", "S0/two"}


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "full"), ValueError(), KeyboardInterrupt()]
)
def test_or_not_at_all(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)), whole_folder(tmp_path / "S0") as folder:  # noqa: PT012
        (folder / "one").write_text("1")
        raise error
    assert listing(tmp_path) == set()


@pytest.mark.parametrize("place", ["S0", "none/S0", "file/S0", "nul\0"])
def test_where_no_folder_can_be(tmp_path: Path, place: str) -> None:
    """One that is there is not replaced."""
    (tmp_path / "file").write_text("text")
    (tmp_path / "S0" / "mine").mkdir(parents=True)
    with pytest.raises(RunError, match="cannot write"), whole_folder(tmp_path / place) as folder:
        (folder / "one").write_text("1")
    assert listing(tmp_path) == {"file", "S0", "S0/mine"}


def test_a_run_is_opened_as_it_was_begun(tmp_path: Path) -> None:
    run = create_run(tmp_path / "runs" / "one", SMALL)
    assert listing(run.folder) == {"run.json", "robot", "robot/robot.urdf", "robot/robot.json"}
    again = read_run(run.folder)
    assert again.settings == SMALL
    assert again.stages == ()
    assert again.actions.names == run.actions.names
    assert isinstance(run.domain, Tabletop)
    assert isinstance(again.domain, Tabletop)
    assert again.domain.robot.description == run.domain.robot.description
    with pytest.raises(RunError, match="is not empty and holds no run"):
        create_run(run.folder, SMALL)


def test_a_run_may_begin_in_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert read_run(create_run(tmp_path / "empty", SMALL).folder).settings == SMALL


def test_a_run_is_moved_as_a_whole(trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "elsewhere")
    assert last_skill(folder)[1].name == "S1"
    assert last_skill(folder / "S0")[1].name == "S0"
    with pytest.raises(RunError, match="is no run and no stage of one"):
        last_skill(folder / "S2")
    shutil.copytree(folder / "S1", tmp_path / "alone" / "S1")
    with pytest.raises(RunError, match=r"its run\.json is lost"):
        last_skill(tmp_path / "alone" / "S1")


def with_action(trained: Trained, target: Path, spec: str) -> Path:
    """A copy of the run whose file names an action."""
    folder = copied(trained, target)
    about = json.loads((folder / "run.json").read_text())
    about["settings"]["actions"] = [spec]
    (folder / "run.json").write_text(json.dumps(about))
    return folder


@pytest.mark.parametrize("networks", ACTIONS)
@pytest.mark.parametrize(("size", "percept"), [(7, "box"), (9, "yaw"), (11, "box"), (13, "yaw")])
def test_a_skill_file_tells_what_it_reads(
    tmp_path: Path, size: int, percept: str, networks: str
) -> None:
    path = tmp_path / "skill.json"
    skill = random_skill(4, "some", ACTIONS[networks](size))
    save_skill(path, skill)
    wanted = "perimeter" if percept == "box" else "general"
    domain, kind, again = lone_skill(path, kind=wanted)
    assert isinstance(domain, Tabletop)
    assert (domain.tabletop, kind) == (percept, wanted)
    # Networks in the edge's frame are those of the domain, whatever their percepts were.
    one, other = ({**skill_to_dict(each), "actions": {}} for each in (skill, again))
    assert one == other


def test_a_skill_file_of_no_percept(tmp_path: Path) -> None:
    path = tmp_path / "skill.json"
    save_skill(path, random_skill(4, "some", paper_actions(8)))
    with pytest.raises(GraphError, match="parameters"):
        lone_skill(path)


MARKING = """
import pathlib
pathlib.Path(__file__).with_name("imported").write_text("yes")
from cgtorch.tabletop.actions import Detect
class Look(Detect): pass
"""


def test_code_is_imported_only_if_it_is_trusted(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "marking.py").write_text(MARKING)
    monkeypatch.syspath_prepend(tmp_path)
    folder = with_action(trained, tmp_path / "run", "marking:Look")
    for trusted in ((), ("other:Look",), ("marking",), ("marking:look",)):
        with pytest.raises(ActionError):
            read_run(folder, trusted)
        assert not (tmp_path / "imported").exists()
        assert "marking" not in sys.modules
    assert "Look" in read_run(folder, ("marking:Look",)).actions.names
    assert (tmp_path / "imported").exists()


@pytest.mark.parametrize("spec", ["Fly", "../x:Y", "/etc/passwd", ":", "a:b:c", "", "os:system"])
def test_actions_that_lead_nowhere(trained: Trained, tmp_path: Path, spec: str) -> None:
    folder = with_action(trained, tmp_path / "run", spec)
    with pytest.raises(ActionError) as caught:
        read_run(folder, (spec,))
    assert "\n" not in str(caught.value)


def test_what_was_told_while_it_was_made(trained: Trained) -> None:
    events = trained.events
    started = [e for e in events if isinstance(e, StageStarted)]
    assert [(e.stage, e.stages) for e in started] == [("S0", ("S0", "S1")), ("S1", ("S0", "S1"))]
    assert started[0].size_w == 0
    assert [type(e) for e in events[:2]] == [WorldAsked, ModelsFitted]
    assert any(isinstance(e, WorldTested) for e in events)
    practised = [e for e in events if isinstance(e, Practised)]
    assert {e.wanted for e in practised} == {SMALL.practice}
    assert any(e.in_a_row == SMALL.practice for e in practised)
    assert not any(e.recalled for e in events if isinstance(e, WorldAsked))


def test_data_grow_and_nothing_is_lost(trained: Trained) -> None:
    """All that was asked is learned from, except after a stage's last candidate."""
    run = read_run(trained.folder)
    known = [load_progress(run, run.folder / s).knowledge for s in ("start", "S0", "S1")]
    data = [each.dataset.extended(each.aside) for each in known]
    asked = [run_asked(run.folder, s) for s in ("start", "S0", "S1")]
    assert len(data[0].percept) <= asked[0]["motions"] <= SMALL.transitions + 1
    for before, after in pairwise(data):
        for name in ("percept", "tested"):
            old, new = (set(map(tuple, vars(each)[name].tolist())) for each in (before, after))
            assert old <= new
    for each, counts in zip(data, asked, strict=True):
        assert len(each.percept) <= counts["motions"]
        assert len(each.succeeded) <= counts["tests"]
    assert len(data[0].succeeded) == asked[0]["tests"]
    assert len(data[2].percept) > len(data[0].percept)


def asked_by(run: Path, stage: str) -> dict[str, dict[str, int]]:
    """What a run had asked of its world when a stage was finished, by phase."""
    return asked_at_start(run) if stage == "start" else result_of(run, stage)["asked"]


def run_asked(run: Path, stage: str) -> Counter[str]:
    """The same of all phases."""
    phases = asked_by(run, stage).values()
    return Counter({name: sum(phase[name] for phase in phases) for name in NAMES})


def test_results_are_what_the_world_says(trained: Trained) -> None:
    for result, stage, edge in zip(trained.results, ("S0", "S1"), ("near", "left"), strict=True):
        assert (result["stage"], result["scenarios"]) == (stage, edge)
        assert result["targets"] == 5
        assert 0 <= result["targets_succeeded"] <= 5
        assert result["w_lost"] == 0
        assert result["fresh"]["tried"] == result["overall"]["tried"] == 40
        assert result["generations"] > 0
    assert trained.results[0]["w_size"] == 0
    run = read_run(trained.folder)
    first = load_progress(run, run.folder / "S0")
    assert trained.results[1]["w_size"] == len(first.solved)
    assert run.results == trained.results


def test_results_count_what_was_asked_of_the_world(trained: Trained) -> None:
    """Every trial and every look was told, and counts add up over the stages, by phase."""
    spent: dict[str, Asked] = {}
    told = [event for event in trained.events if isinstance(event, WorldAsked)]
    for name in ("start", "S0", "S1"):
        for event in told:
            if event.stage == name:
                spent[event.phase] = spent.get(event.phase, Asked()) + event.asked
        found = asked_by(trained.folder, name)
        assert found == {phase: vars(asked) for phase, asked in spent.items()}
    assert {"exploration", "looks", "trials", "practice"} <= set(spent)
    assert {"exploration", "looks", "trials", "practice", "other noise"} >= set(spent)
    for phase in ("exploration", "looks"):
        assert spent[phase].episodes == 0 < spent[phase].looks
    assert spent["looks"].actions == 0
    for phase in ("trials", "practice"):
        assert spent[phase].looks == spent[phase].episodes > 0
    assert trained.results[1]["asked"] == found


def made_again(trained: Trained, folder: Path, seed: int) -> bytes:
    """The skill of S0 when it is made from the same start under a seed."""
    run = read_run(copied(trained, folder, ()))
    run = replace(run, settings=replace(run.settings, seed=seed))
    events: list[Event] = []
    train(Training(run, events.append, quietly), "S0")
    return (folder / "S0" / "skill.json").read_bytes()


def test_another_seed_makes_another_skill(trained: Trained, tmp_path: Path) -> None:
    """The same seed makes the same skills, which the test of the command shows."""
    was = (trained.folder / "S0" / "skill.json").read_bytes()
    assert made_again(trained, tmp_path / "other", SMALL.seed + 1) != was


FILES = "data.safetensors", "seen.safetensors", "scenarios.json", "skill.json"
TIMED = {"seconds": 0, "search_seconds": 0}
OF_INTERRUPTIONS = ("recalled", "ended")


def timeless(row: Row) -> Row:
    return row | TIMED | {"time": 0}


def ends_as(trained: Trained, folder: Path) -> None:
    """S1 in a folder is that of the run that nothing interrupted, but for times."""
    for name in FILES:
        assert (folder / "S1" / name).read_bytes() == (trained.folder / "S1" / name).read_bytes()
    result = read_run(folder).results[1]
    assert result | TIMED == trained.results[1] | TIMED  # also in what was asked
    one, other = (
        [timeless(row) for row in read_log(place) if row["event"] not in OF_INTERRUPTIONS]
        for place in (folder, trained.folder)
    )
    assert one == other


class Interrupted(Exception):  # noqa: N818
    """What stops a run in a test."""


def in_order(events: Iterable[Event]) -> list[WorldAsked]:
    """What was asked in S1."""
    return [e for e in events if isinstance(e, WorldAsked) and e.stage == "S1"]


def test_a_stage_that_is_interrupted_leaves_its_journal_and_goes_on_with_it(
    trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run", ("S0",))
    before = listing(folder)

    def stop(event: Event) -> None:
        if isinstance(event, WorldTested):
            raise Interrupted

    with pytest.raises(Interrupted):
        train(Training(read_run(folder), stop, quietly), "S1")
    left = listing(folder) - before
    assert all(name.startswith("journal") for name in left)
    assert "journal/S1/00000.safetensors" in left
    told: list[Event] = []
    train(Training(read_run(folder), told.append, quietly), "S1")
    assert [type(event) for event in told[:3]] == [StageStarted, WorldAsked, EvolutionRecalled]
    wanted = in_order(trained.events)
    assert in_order(told) == [replace(e, recalled=i < 2) for i, e in enumerate(wanted)]
    assert not (folder / "journal").exists()
    ends_as(trained, folder)


@pytest.mark.parametrize(
    "kind",
    [
        WorldAsked,
        *(
            pytest.param(e, marks=pytest.mark.hostile)
            for e in (GenerationDone, Practised, ModelsFitted)
        ),
    ],
)
def test_a_stage_that_is_killed_anywhere_ends_as_one_that_was_not(
    trained: Trained, tmp_path: Path, kind: type[Event]
) -> None:
    """It is killed at the second event of a kind, gone on with, and killed at the second then."""
    every: list[Any] = [e for e in trained.events if isinstance(e, kind)]
    number = min(2, len([e for e in every if e.stage == "S1"]))
    assert number

    def ends(count: Iterator[int], event: Event) -> None:
        if isinstance(event, kind) and next(count) == number:
            raise Interrupted

    folder = copied(trained, tmp_path / "run", ("S0",))
    for _ in range(2):
        stop = partial(ends, itertools.count(1))
        with pytest.raises(Interrupted):
            train(Training(read_run(folder), stop, quietly, checkpoint_seconds=0), "S1")
    told: list[Event] = []
    training = Training(read_run(folder), told.append, quietly)
    train(training, "S1")
    wanted = in_order(trained.events)
    assert [replace(e, recalled=False) for e in in_order(told)] == wanted
    assert vars(training.purse.total) == dict(run_asked(trained.folder, "S1"))
    ends_as(trained, folder)


@pytest.mark.parametrize("motion", [pytest.param(1, marks=pytest.mark.hostile), 40])
def test_a_trial_that_is_killed_is_made_again_and_counted_once(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, motion: int
) -> None:
    """The world, which repeats itself, was asked for it in vain, and nobody knows any more."""
    folder, step = copied(trained, tmp_path / "run", ("S0",)), Recording.step
    purse, count = Purse(), itertools.count(1)

    def ends(self: Recording, *given: Any) -> Any:
        if next(count) == motion:
            self.purse.pay(self.phase, Asked(motions=1))
            raise Interrupted
        return step(self, *given)

    with monkeypatch.context() as patch:
        patch.setattr(Recording, "step", ends)
        with pytest.raises(Interrupted):
            train(Training(read_run(folder), lambda e: None, quietly, purse=purse), "S1")
    assert purse.total.motions > run_asked(folder, "S0")["motions"]
    train(Training(read_run(folder), lambda e: None, quietly), "S1")
    ends_as(trained, folder)


def test_a_stage_that_finds_nothing_leaves_nothing(
    trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_success(monkeypatch)
    folder = copied(trained, tmp_path / "run", ())
    about = json.loads((folder / "run.json").read_text())
    about["settings"].update(generations=1, attempts=2)
    (folder / "run.json").write_text(json.dumps(about))
    before = listing(folder)
    with pytest.raises(NotImprovedError, match="raise attempts") as caught:
        train(Training(read_run(folder), lambda event: None, quietly), "S0")
    assert "\n" not in str(caught.value)
    assert listing(folder) == before


def test_a_journal_that_a_finished_stage_has_left_goes(trained: Trained, tmp_path: Path) -> None:
    """As after a kill between the end of a stage and that of its journal."""
    run = read_run(copied(trained, tmp_path / "run"))
    left = run.folder / "journal" / "S1"
    left.mkdir(parents=True)
    (left / "00001.safetensors").write_bytes(b"x")
    train(Training(run, lambda event: None, quietly), "S1")
    assert not left.parent.exists()
