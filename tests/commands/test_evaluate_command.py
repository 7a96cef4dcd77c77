"""`cgtorch-evaluate`: a run, a stage of it, a skill file; for people and for programs."""

import json
from pathlib import Path

import pytest
from command_line import Shell, in_a_shell, listing
from told_by_runs import logged
from trained import Trained, copied

from cgtorch.ground.statistics import wilson
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.storage import load_knowledge
from cgtorch.training.evaluate import evaluate_skill, robust_successes

EVALUATE = "cgtorch-evaluate"


def test_help_has_examples() -> None:
    ended = in_a_shell(EVALUATE, "--help")
    assert ended.code == 0
    assert ended.err == ""
    assert "Examples:" in ended.out
    assert "cgtorch-evaluate runs/reference\n" in ended.out
    for option in ("--scenarios", "--count", "--seed", "--actions", "--json"):
        assert option in ended.out


def test_the_version(shell: Shell) -> None:
    ended = shell(EVALUATE, "--version")
    assert (ended.code, ended.err) == (0, "")
    assert "0.1" in ended.out


@pytest.mark.parametrize(("place", "name"), [("", "S1"), ("S0", "S0"), ("S1", "S1")])
def test_a_run_and_its_stages(shell: Shell, trained: Trained, place: str, name: str) -> None:
    before = listing(trained.folder)
    words = (trained.folder / place, "--count", 12, "--seed", 4, "--scenarios", "near")
    ended = shell(EVALUATE, *words, "--json")
    assert (ended.code, ended.err) == (0, "")
    found = json.loads(ended.out)
    run, skill = last_skill(trained.folder / place)
    assert skill.name == name
    score = evaluate_skill(skill, run.domain, "near", 12, 4)
    knowledge = load_knowledge(run.folder / name, run.models.unfitted())
    kept = robust_successes(score, skill, knowledge, run.models, 4)
    again = logged(run.folder, "accepted", name)[-1]["w_other_noise"]
    assert kept is not None
    assert again is not None
    assert found == {
        "skill": name,
        "scenarios": "near",
        "seed": 4,
        "tried": 12,
        "succeeded": score.successes,
        "rate": score.successes / 12,
        "interval": list(wilson(score.successes, 12, 0.95)),
        "mean_return": None,
        "predicted": {
            "tried": kept.tried,
            "succeeded": kept.successes,
            "rate": kept.successes / max(1, kept.tried),
            "interval": list(wilson(kept.successes, kept.tried, 0.95)),
        },
        "w_other_noise": {
            **again,
            "rate": again["succeeded"] / again["tried"],
            "interval": list(wilson(again["succeeded"], again["tried"], 0.95)),
        },
    }
    ended = shell(EVALUATE, *words)
    assert f"{name} on near: {score.successes} / 12 succeeded" in ended.out
    assert (
        f"the models predicted robust success on {kept.tried} of 12, of which {kept.successes} "
        in ended.out
    )
    counted = f"{again['succeeded']} / {again['tried']}"
    assert f"W under other noise, when it was accepted: {counted}" in ended.out
    assert listing(trained.folder) == before


def test_an_earlier_skill_of_the_run(shell: Shell, trained: Trained) -> None:
    rest = ("--count", 12, "--seed", 4, "--json")
    restored = shell(EVALUATE, trained.folder, "--skill", "S0", *rest)
    assert restored.code == 0, restored
    assert restored.out == shell(EVALUATE, trained.folder / "S0", *rest).out


def test_a_skill_file_alone(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_bytes((trained.folder / "S1" / "skill.json").read_bytes())
    alone, in_run = (
        shell(EVALUATE, place, "--count", 10, "--json") for place in (path, trained.folder)
    )
    assert alone.code == 0
    one, other = json.loads(alone.out), json.loads(in_run.out)
    for name in ("predicted", "w_other_noise"):  # a file has neither models nor a log
        assert one.pop(name) is None
        assert other.pop(name) is not None
    assert one == other  # the run has the built-in robot and noise, too


def test_in_a_process_of_its_own(trained: Trained, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path / "runs" / "mine")
    ended = in_a_shell(EVALUATE, "runs/mine", "--count", "5", "--json", folder=tmp_path)
    assert ended.code == 0
    assert ended.err == ""
    found = json.loads(ended.out)
    assert found["tried"] == 5
    assert found["rate"] == found["succeeded"] / 5
    assert listing(folder) == listing(copied(trained, tmp_path / "untouched"))


@pytest.mark.parametrize(("here", "name"), [("", "S1"), ("S0", "S0")])
def test_the_current_folder(
    shell: Shell, trained: Trained, monkeypatch: pytest.MonkeyPatch, here: str, name: str
) -> None:
    monkeypatch.chdir(trained.folder / here)
    ended = shell(EVALUATE, ".", "--count", 2, "--json")
    assert json.loads(ended.out)["skill"] == name


def test_tables_of_any_size(shell: Shell, trained: Trained) -> None:
    words = (trained.folder, "--count", 5, "--scenarios")
    ended = shell(EVALUATE, *words, "general")
    assert (ended.code, ended.err) == (0, "")
    assert " / 5 succeeded" in ended.out
    ended = shell(EVALUATE, *words, "general-clutter")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.count("\n") == 1
    assert "'S1' reads percepts of 7 numbers, those of general-clutter have 11; use" in ended.err


def test_scenarios_are_those_of_the_run_unless_others_are_named(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    run = copied(trained, tmp_path / "run")
    about = json.loads((run / "run.json").read_text())
    for kind in ("perimeter", "general"):
        about["settings"] |= {"scenarios": kind}
        about["domain_settings"] |= {"percept": "box"}
        (run / "run.json").write_text(json.dumps(about))
        ended = shell(EVALUATE, run, "--count", 2, "--json")
        assert (ended.code, ended.err) == (0, "")
        assert json.loads(ended.out)["scenarios"] == kind


def test_a_picture_of_the_scenes(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    path = tmp_path / "scenes.png"
    words = (trained.folder, "--count", 3, "--scenarios", "general", "--picture")
    ended = shell(EVALUATE, *words, path)
    assert (ended.code, ended.err) == (0, "")
    assert path.read_bytes().startswith(b"\x89PNG")
    ended = shell(EVALUATE, *words, tmp_path / "nowhere" / "scenes.png")
    assert ended.code == 2
    assert ended.err.count("\n") == 1
    assert "nowhere" in ended.err


def test_a_run_that_was_passed_on_without_its_models(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    folder = copied(trained, tmp_path / "run")
    words = (folder, "--count", 3, "--json")
    whole = json.loads(shell(EVALUATE, *words).out)
    assert whole["predicted"] is not None
    for path in folder.glob("*/*.safetensors"):
        path.unlink()
    assert json.loads(shell(EVALUATE, *words).out) == {**whole, "predicted": None}
