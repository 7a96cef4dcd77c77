"""`cgtorch-train`: new runs, going on with runs, actions of one's own, giving up."""

import json
from pathlib import Path

import pytest
from command_line import Shell, as_options, in_a_shell, listing
from trained import SMALL, Trained, copied

TRAIN, EVALUATE = "cgtorch-train", "cgtorch-evaluate"
OPTIONS = as_options(SMALL)
HASTY = ["--population=2", "--generations=1", "--attempts=1", "--tournament=1", "--practice=4"]
LITTLE = ["--transitions=50"]


ACTIONS = '''
from torch import Tensor

from cgtorch.graphs import Action
from cgtorch.ground.environment import Environment, Lanes

RUNS = []


class Wait(Action):
    """Does nothing, now or later."""

    outcomes = ("done", "bored")
    num_parameters = 2

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        RUNS.append(len(lanes))
        return lanes, (parameters[:, 0] > parameters[:, 1]).long()
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


def test_help_has_examples() -> None:
    ended = in_a_shell(TRAIN, "--help")
    assert ended.code == 0
    assert ended.err == ""
    assert "Examples:" in ended.out
    assert "cgtorch-train --stage S2\n" in ended.out
    for option in ("stage", "seed", "run-dir", "population", "generations", "device", "actions"):
        assert f"--{option}" in ended.out
    assert "--resume" in ended.out
    assert "--quiet" in ended.out


def test_a_run_that_gives_up_can_be_told_by_its_exit_code(tmp_path: Path) -> None:
    """A fresh run says what it makes; what it has made is kept.

    A module in the current folder is enough for an action of one's own.
    """
    (tmp_path / "waiting_actions.py").write_text(ACTIONS + HOPELESS)
    own = ["--actions", "waiting_actions:Wait"]
    words = ["--stage", "S2", "--run-dir", "run", *HASTY, *LITTLE, *own]
    ended = in_a_shell(TRAIN, *words, folder=tmp_path)
    assert ended.code == 1, ended
    assert "New run run: evolve one skill for each of S0, S1, S2" in ended.err
    assert "builds on" not in ended.err
    last = ended.err.splitlines()[-1]
    assert last.startswith("cgtorch-train: stage S0 found no skill that keeps W and solves more")
    assert "raise --attempts, --generations or --population" in last
    assert "Traceback" not in ended.err
    assert ended.out == ""
    left = {name for name in listing(tmp_path / "run") if "tfevents" not in name}
    files = {
        "data.safetensors",
        "aside.safetensors",
        "gamma.safetensors",
        "classifier.safetensors",
        "scenarios.json",
    }
    assert left == {
        "run.json",
        "log.jsonl",
        "by_rows",
        "robot",
        "robot/robot.urdf",
        "robot/robot.json",
        "start",
        *(f"start/{name}" for name in files),
    }
    notes = json.loads((tmp_path / "run" / "run.json").read_text())
    assert notes["settings"]["population"] == 2
    assert notes["settings"]["actions"] == ["waiting_actions:Wait"]


def test_a_finished_stage_is_not_made_again(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "run")
    was = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    for words in (["--resume", folder], ["--run-dir", folder, *OPTIONS]):
        ended = shell(TRAIN, *words, "--stage", "S1", "--quiet")
        assert ended.code == 0, ended
        assert ended.err == ""  # quiet: the table alone, where results go
        assert "S0" in ended.out
        assert "S1" in ended.out
    about = json.loads(was.pop(folder / "run.json"))
    assert {p: p.read_bytes() for p in was} == was
    noted = json.loads((folder / "run.json").read_text())
    assert noted == {**about, "goes_on_to": {"stage": "S1"}}


def test_the_stages_that_a_run_lacks_are_made(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    """The run is begun elsewhere and ended here: the skills are the same, bit for bit."""
    folder = copied(trained, tmp_path / "run", ())
    ended = shell(TRAIN, "--resume", folder, "--stage", "S1")
    assert ended.code == 0, ended
    assert "S1 builds on S0, which is made first\n" in ended.err
    for stage in ("S0", "S1"):
        for name in ("skill.json", "scenarios.json"):
            made = (folder / stage / name).read_bytes()
            assert made == (trained.folder / stage / name).read_bytes()
    left = {Path(name).name for name in listing(folder)}
    assert not any(name.endswith(".tmp") for name in left)


def test_an_action_of_ones_own_takes_part(
    shell: Shell, trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run remembers its name, not its code."""
    (tmp_path / "waiting_actions.py").write_text(ACTIONS)
    monkeypatch.syspath_prepend(tmp_path)
    import waiting_actions  # the module that was just written

    folder = copied(trained, tmp_path / "run", ())
    about = json.loads((folder / "run.json").read_text())
    about["settings"]["actions"] = ["waiting_actions:Wait"]
    (folder / "run.json").write_text(json.dumps(about))
    words = ["--resume", folder, "--actions", "waiting_actions:Wait", "--stage", "S0", "--quiet"]
    ended = shell(TRAIN, *words)
    assert ended.code == 0, ended
    assert sum(waiting_actions.RUNS) > 1000
    own = (folder / "S0" / "skill.json").read_bytes()
    assert own != (trained.folder / "S0" / "skill.json").read_bytes()
    ended = shell(EVALUATE, folder, "--actions", "waiting_actions:Wait", "--count", 10, "--json")
    assert json.loads(ended.out)["tried"] == 10


def test_an_action_of_ones_own_that_no_node_has_is_told(
    shell: Shell, trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "waiting_actions.py").write_text(ACTIONS)
    monkeypatch.syspath_prepend(tmp_path)
    folder = copied(trained, tmp_path / "run")  # whose skills were evolved without it
    about = json.loads((folder / "run.json").read_text())
    about["settings"]["actions"] = ["waiting_actions:Wait"]
    (folder / "run.json").write_text(json.dumps(about))
    ended = shell(TRAIN, "--resume", folder, "--actions", "waiting_actions:Wait", "--stage", "S1")
    assert ended.code == 0, ended
    assert "No node of S1 is Wait: the search found no use for it." in ended.err


def test_an_action_of_ones_own_that_is_used_is_told(
    shell: Shell, trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_steps.py").write_text(
        "from cgtorch.tabletop.actions import MoveBase\n\nclass Stride(MoveBase):\n    'A step.'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    folder = copied(trained, tmp_path / "run")
    about = json.loads((folder / "run.json").read_text())
    about["settings"]["actions"] = ["own_steps:Stride"]
    (folder / "run.json").write_text(json.dumps(about))
    skill = folder / "S1" / "skill.json"  # as if it had been evolved with it
    skill.write_text(skill.read_text().replace('"action": "MoveBase"', '"action": "Stride"'))
    ended = shell(TRAIN, "--resume", folder, "--actions", "own_steps:Stride", "--stage", "S1")
    assert ended.code == 0, ended
    assert "S1 uses the action Stride.\nNext:" in ended.err


def test_going_on_until_a_goal_is_met(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    """What was reached is said; that more was wanted is no error."""
    folder = copied(trained, tmp_path / "run")
    about = json.loads((folder / "run.json").read_text())
    about["settings"]["attempts"] = 1
    (folder / "run.json").write_text(json.dumps(about))
    words = ["--resume", folder, "--stage", "auto", "--target", 0.999]
    ended = shell(TRAIN, *words, "--minutes", 0)
    assert ended.code == 0, ended
    assert f"run {folder} has made no round; raise --minutes" in ended.err.replace("\n", " ")
    assert not (folder / "auto-1").exists()
    ended = shell(TRAIN, *words, "--rounds", 1)
    assert ended.code == 0, ended
    assert "fresh scenarios = " in ended.err
    said = ended.err.replace("\n", " ")
    assert f"run {folder} has not reached its goal of 0.999; continue with --resume" in said
    ended = shell(EVALUATE, folder, "--count", 5, "--json")
    kept = json.loads((folder / "auto-1" / "skill.json").read_text())["name"]
    assert kept in ("S1", "auto-1")  # so few attempts may improve nothing
    assert json.loads(ended.out)["skill"] == kept
    assert shell(EVALUATE, folder / "auto-1", "--count", 5, "--json").out == ended.out
    assert "cannot make a single stage any more" in shell.refuses(
        TRAIN, "--resume", folder, "--stage", "S2", "--quiet"
    )
