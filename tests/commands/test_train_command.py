"""`cgtorch-train`: new runs, going on with runs, actions of one's own, giving up."""

import json
from pathlib import Path

import pytest
from command_line import EVALUATE, TRAIN, Shell, about, as_options, edited, in_a_shell, listing
from told_by_runs import logged
from trained import SMALL, Trained, copied

from cgtorch.tabletop.kinematics import robots_folder

OPTIONS = as_options(SMALL)
HASTY = ["--population=2", "--generations=1", "--attempts=1", "--tournament=1", "--practice=4"]
OWN = ["--actions", "own_actions:Wait"]
ACTIONS = '''
from cgtorch.graphs import Action
from cgtorch.tabletop.actions import MoveBase

RUNS = []


class Wait(Action):
    """Does nothing, now or later."""

    outcomes = ("done", "bored")
    num_parameters = 2

    def forward(self, lanes, parameters, environment):
        RUNS.append(len(lanes))
        return lanes, (parameters[:, 0] > parameters[:, 1]).long()


class Stride(MoveBase):
    """A step."""
'''
HOPELESS = '''

from cgtorch.improvement import trial


class Never(trial.Recording):
    """The world of a trial, in which nothing succeeds; exploration has one of its own."""

    def success(self, lanes):
        lanes, result = super().success(lanes)
        return lanes, 0 * result


trial.Recording = Never
'''


@pytest.mark.hostile
def test_a_run_that_gives_up_can_be_told_by_its_exit_code(tmp_path: Path) -> None:
    """A fresh run says what it makes; what it has made is kept.

    A module in the current folder is enough for an action of one's own.
    """
    (tmp_path / "own_actions.py").write_text(ACTIONS + HOPELESS)
    words = ["--stage", "S2", "--run-dir", "run", *HASTY, "--transitions=50", *OWN]
    ended = in_a_shell(TRAIN, *words, folder=tmp_path)
    assert (ended.code, ended.out) == (1, ""), ended
    assert "New run run: evolve one skill for each of S0, S1, S2" in ended.err
    assert "builds on" not in ended.err
    last = ended.err.splitlines()[-1]
    assert last.startswith("cgtorch-train: stage S0 and S1 and S2 found no skill that keeps")
    assert "raise attempts, generations or population" in last
    assert "Traceback" not in ended.err
    left = {name for name in listing(tmp_path / "run") if "tfevents" not in name}
    models = ("data", "aside", "gamma", "classifier")
    assert left == {
        *("run.json", "log.jsonl", "by_rows", "robot", "robot/robot.urdf", "robot/robot.json"),
        *("start", "start/scenarios.json"),
        *(f"start/{name}.safetensors" for name in models),
    }
    settings = about(tmp_path / "run")["settings"]
    assert (settings["population"], settings["actions"]) == (2, ["own_actions:Wait"])


def test_a_finished_stage_is_not_made_again(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run")
    was = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    for words in (["--resume", folder], ["--run-dir", folder, *OPTIONS]):
        ended = shell.does(TRAIN, *words, "--stage", "S1", "--quiet")
        assert ended.err == ""  # quiet: the table alone, where results go
        assert "S0" in ended.out
        assert "S1" in ended.out
    before = json.loads(was.pop(folder / "run.json"))
    assert {p: p.read_bytes() for p in was} == was
    assert about(folder) == {**before, "goes_on_to": {"stage": "S1"}}


def test_the_stages_that_a_run_lacks_are_made(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    """The run is begun elsewhere and ended here: the skills are the same, bit for bit."""
    folder = copied(trained, tmp_path / "run", ())
    edited(folder, goes_on_to={"stage": "S1"})
    ended = shell.does(TRAIN, "--resume", folder)
    assert "S1 builds on S0, which is made first\n" in ended.err
    for stage in ("S0", "S1"):
        for name in ("skill.json", "scenarios.json"):
            made = (folder / stage / name).read_bytes()
            assert made == (trained.folder / stage / name).read_bytes()
    assert not any(name.endswith(".tmp") for name in listing(folder))


@pytest.fixture
def own_actions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module with actions of one's own."""
    (tmp_path / "own_actions.py").write_text(ACTIONS)
    monkeypatch.syspath_prepend(tmp_path)


def test_an_action_of_ones_own_takes_part(
    shell: Shell, trained: Trained, tmp_path: Path, own_actions: None
) -> None:
    """A run remembers its name, not its code."""
    import own_actions as module  # which was just written

    folder = copied(trained, tmp_path / "run", ())
    edited(folder, {"actions": ["own_actions:Wait"]})
    shell.does(TRAIN, "--resume", folder, *OWN, "--stage", "S0", "--quiet")
    assert sum(module.RUNS) > 1000
    own = (folder / "S0" / "skill.json").read_bytes()
    assert own != (trained.folder / "S0" / "skill.json").read_bytes()
    assert shell.told(EVALUATE, folder, *OWN, "--count", 10)["tried"] == 10


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Wait", "No node of S1 is Wait: the search found no use for it."),
        ("Stride", "S1 uses the action Stride.\nNext:"),
    ],
)
def test_whether_an_action_of_ones_own_is_used_is_told(
    shell: Shell, trained: Trained, tmp_path: Path, own_actions: None, name: str, says: str
) -> None:
    folder = copied(trained, tmp_path / "run")
    edited(folder, {"actions": [f"own_actions:{name}"]})
    skill = folder / "S1" / "skill.json"  # as if it had been evolved with Stride
    if name == "Stride":
        skill.write_text(skill.read_text().replace('"action": "MoveBase"', '"action": "Stride"'))
    words = ["--resume", folder, "--actions", f"own_actions:{name}", "--stage", "S1"]
    assert says in shell.does(TRAIN, *words).err


def test_going_on_until_a_goal_is_met(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    """What was reached is said; that more was wanted is no error.

    What is given anew is another goal from then on, and the rest of the goal stays.
    """
    folder = copied(trained, tmp_path / "run", ("S0",))  # which fails often, so tests are short
    edited(folder, {"attempts": 1, "generations": 2})
    words = [TRAIN, "--resume", folder]
    goal = ["--stage", "auto", "--target", 0.999]
    late = shell.does(*words, *goal, "--minutes", 0).said
    assert "first round in time; the best skill so far is kept; continue with --resume" in late
    assert not (folder / "auto-1").exists()
    ended = shell.does(*words, *goal, "--rounds", 1)
    assert "fresh scenarios = " in ended.err
    said = f"run {folder} has not reached its goal of 0.999; continue with --resume"
    assert said in ended.said
    asked = {"target": 0.999, "minutes": 10.0, "rounds": 1}
    assert about(folder)["goes_on_to"] == {"stage": "auto", "goal": asked}
    assert said in shell.does(*words).said
    assert not (folder / "auto-2").exists()
    assert said in shell.does(*words, "--minutes", 0).said
    assert about(folder)["goes_on_to"]["goal"] == {**asked, "minutes": 0}
    shell.does(*words, "--target", 0.5, "--minutes", 9)
    assert about(folder)["goes_on_to"]["goal"] == {"target": 0.5, "minutes": 9, "rounds": 1}
    end = logged(folder, "ended")[-1]
    assert (end["target"], end["rounds"]) == (0.5, 1)
    found = shell.told(EVALUATE, folder, "--count", 5)
    kept = json.loads((folder / "auto-1" / "skill.json").read_text())["name"]
    assert found["skill"] == kept in ("S0", "auto-1")  # so few attempts may improve nothing
    assert shell.told(EVALUATE, folder / "auto-1", "--count", 5) == found
    before = about(folder)
    assert "cannot make a single stage any more" in shell.refuses(*words, "--stage", "S2")
    assert about(folder) == before


def test_a_small_run_of_the_fetch_reaches_the_near_edge(shell: Shell, tmp_path: Path) -> None:
    """The name of another robot than the PR2 is all that changes."""
    run = tmp_path / "run"
    words = [TRAIN, "--stage", "S0", "--run-dir", run, "--quiet", *OPTIONS]
    shell.does(*words, "--robot", "fetch")
    for kept, source in (("robot.urdf", "fetch.urdf"), ("robot.json", "robot.json")):
        kept_bytes = (run / "robot" / kept).read_bytes()
        assert kept_bytes == (robots_folder() / "fetch" / source).read_bytes()
    assert shell.told(EVALUATE, run, "--scenarios", "near", "--count", 200)["rate"] > 0.8
    message = shell.refuses(*words)
    assert "has robot fetch, not pr2, and cannot change it, as the run has its robot" in message
    shell.does(*words, "--robot", "fetch")
