"""`cgtorch-evaluate`: a run, a stage of it, a skill file; for people and for programs."""

import json
import os
from pathlib import Path

import pytest
from command_line import EVALUATE, Shell, edited, listing
from support import circle
from told_by_runs import logged
from trained import Trained, copied

from cgtorch.commands import common
from cgtorch.domains.registry import make_domain
from cgtorch.graphs import load_skill, save_skill
from cgtorch.ground.statistics import wilson
from cgtorch.runs.chosen import last_skill
from cgtorch.runs.storage import load_knowledge
from cgtorch.training.evaluate import evaluate_skill, robust_successes


def share(succeeded: int, tried: int) -> dict[str, object]:
    interval = list(wilson(succeeded, tried, 0.95))
    rate = succeeded / max(1, tried)
    return {"tried": tried, "succeeded": succeeded, "rate": rate, "interval": interval}


def test_a_skill_file_has_no_models_and_no_other_measures(shell: Shell, trained: Trained) -> None:
    found = shell.told(EVALUATE, trained.folder / "S0" / "skill.json", "--count", 3, "--seed", 2)
    rows = found.pop("rows")
    assert [set(row) for row in rows] == [{"succeeded", "return"}] * 3
    assert found == {
        "skill": "S0",
        "scenarios": "perimeter",
        "seed": 2,
        **share(sum(row["succeeded"] for row in rows), 3),
        "mean_return": None,
        "predicted": None,
        "w_other_noise": None,
    }
    words = trained.folder / "S0" / "skill.json", "--count", 3, "--seed", 2
    said = shell.does(EVALUATE, *words).out
    assert said.startswith(f"S0 on perimeter: {found['succeeded']} / 3 succeeded")
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(("place", "name"), [("", "S1"), ("S0", "S0")])
def test_a_run_and_its_stages(
    shell: Shell, trained: Trained, monkeypatch: pytest.MonkeyPatch, place: str, name: str
) -> None:
    before = listing(trained.folder)
    words = (trained.folder / place, "--count", 12, "--seed", 4, "--scenarios", "near")
    found = shell.told(EVALUATE, *words)
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
        **share(score.successes, 12),
        "mean_return": None,
        "predicted": share(kept.successes, kept.tried),
        "w_other_noise": share(again["succeeded"], again["tried"]),
        "rows": [{"succeeded": good, "return": None} for good in score.succeeded.tolist()],
    }
    text = shell.does(EVALUATE, *words).out
    assert f"{name} on near: {score.successes} / 12 succeeded" in text
    predicted = f"success on {kept.tried} of 12, of which {kept.successes} "
    assert f"the models predicted robust {predicted}" in text
    counted = f"{again['succeeded']} / {again['tried']}"
    assert f"W under other noise, when it was accepted: {counted}" in text
    monkeypatch.chdir(trained.folder / place)
    assert shell.told(EVALUATE, ".", *words[1:]) == found, "of the current folder"
    assert shell.told(EVALUATE, trained.folder, "--skill", name, *words[1:]) == found
    assert listing(trained.folder) == before


def test_why_a_skill_of_a_file_fails(shell: Shell, tmp_path: Path) -> None:
    cart, path, why = make_domain("examples.cart:Cart"), tmp_path / "cart.json", tmp_path / "why"
    save_skill(path, circle(cart.actions(), "Test"))
    words = path, "--domain", "examples.cart:Cart", "--count", 20, "--failures", why
    ended = shell.does(EVALUATE, *words)
    data = json.loads((why / "failures.json").read_text())
    assert ended.out.splitlines()[1:] == [
        data["blame"],
        *(advice["text"] for advice in data["advice"]),
        f"kinds of failure: 1, in {why / 'failures.md'}, {why / 'failures.json'}",
    ]
    succeeded = evaluate_skill(load_skill(path, cart.actions()), cart, "any", 20, 0).succeeded
    assert 0 < int(succeeded.sum()) < 20
    assert f"{20 - int(succeeded.sum())} of 20 scenarios fail." in (why / "failures.md").read_text()
    rows = shell.told(EVALUATE, *words, "--force")["rows"]
    assert [row["succeeded"] for row in rows] == succeeded.tolist()
    assert [row["failure"] for row in rows] == [None if ok else 1 for ok in succeeded.tolist()]


@pytest.mark.hostile
def test_why_a_skill_fails(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    words = trained.folder, "--count", 8, "--scenarios", "far", "--failures", tmp_path / "why"
    ended = shell.does(EVALUATE, *words)
    text = (tmp_path / "why" / "failures.md").read_text()
    assert f"kinds of failure: {text.count('## ')}, in {tmp_path / 'why' / 'failures.md'}" in (
        ended.out
    )
    run, skill = last_skill(trained.folder)
    score = evaluate_skill(skill, run.domain, "far", 8, 0)
    assert f"{8 - score.successes} of 8 scenarios fail." in text
    data = json.loads((tmp_path / "why" / "failures.json").read_text())
    assert all(line in ended.out for line in (data["blame"], data["advice"][0]["text"]))
    kinds = data["kinds"]
    assert all(act["chance"] is not None for kind in kinds for act in kind["way"])
    told = shell.told(EVALUATE, *words)
    assert [row["succeeded"] for row in told["rows"]] == score.succeeded.tolist()
    for number, row in enumerate(told["rows"]):
        own = [i for i, kind in enumerate(kinds, 1) if number in kind["scenarios"]]
        assert row["failure"] == (own[0] if own else None)
    (tmp_path / "file").touch()
    assert "file" in shell.refuses(EVALUATE, trained.folder, "--failures", tmp_path / "file")


@pytest.mark.parametrize(
    ("display", "words", "chosen"),
    [
        ({}, ["--failures", "why"], "egl"),
        ({"DISPLAY": ":0"}, ["--failures", "why"], None),
        ({"MUJOCO_GL": "glfw"}, ["--failures", "why"], "glfw"),
        ({}, [], None),
    ],
)
def test_films_of_failures_are_drawn_by_egl_where_there_is_no_display(
    shell: Shell,
    monkeypatch: pytest.MonkeyPatch,
    display: dict[str, str],
    words: list[str],
    chosen: str | None,
) -> None:
    """Before anything of a domain is imported, so also before it is known that there is no run."""
    monkeypatch.setattr(common, "find_library", lambda name: name)  # as on any machine with EGL
    for name in ("DISPLAY", "MUJOCO_GL"):
        monkeypatch.setenv(name, display.get(name, ""))
        if name not in display:
            monkeypatch.delenv(name)
    shell.refuses(EVALUATE, "nowhere", *words)
    assert os.environ.get("MUJOCO_GL") == chosen


def test_a_skill_file_alone(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_bytes((trained.folder / "S1" / "skill.json").read_bytes())
    one, other = (shell.told(EVALUATE, p, "--count", 10) for p in (path, trained.folder))
    for name in ("predicted", "w_other_noise"):  # a file has neither models nor a log
        assert one.pop(name) is None
        assert other.pop(name) is not None
    assert one == other  # the run has the built-in robot and noise, too


def test_tables_of_any_size(shell: Shell, trained: Trained) -> None:
    words = (trained.folder, "--count", 5, "--scenarios")
    assert " / 5 succeeded" in shell.does(EVALUATE, *words, "general").out
    message = shell.refuses(EVALUATE, *words, "general-clutter")
    assert "'S1' reads percepts of 7 numbers, those of general-clutter have 11; use" in message


def test_scenarios_are_those_of_the_run_unless_others_are_named(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    run = copied(trained, tmp_path / "run")
    for kind in ("perimeter", "general"):
        edited(run, {"scenarios": kind}, percept=None)
        assert shell.told(EVALUATE, run, "--count", 2)["scenarios"] == kind


def test_a_picture_of_the_scenes(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    path = tmp_path / "scenes.png"
    words = (trained.folder, "--count", 3, "--scenarios", "general", "--picture")
    assert shell.does(EVALUATE, *words, path).err == ""
    assert path.read_bytes().startswith(b"\x89PNG")
    assert "nowhere" in shell(EVALUATE, *words, tmp_path / "nowhere" / "scenes.png").err


def test_a_run_that_was_passed_on_without_its_models(
    shell: Shell, trained: Trained, tmp_path: Path
) -> None:
    words = (copied(trained, tmp_path / "run"), "--count", 3)
    whole = shell.told(EVALUATE, *words)
    assert whole["predicted"] is not None
    for path in words[0].glob("*/*.safetensors"):
        path.unlink()
    assert shell.told(EVALUATE, *words) == {**whole, "predicted": None}
