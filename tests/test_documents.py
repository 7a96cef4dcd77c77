"""The code in the documents runs, and the commands in them are such as there are."""

import importlib
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import click
import pytest
import torch
from support import world

from cgtorch.commands import evaluate, export, report, robot, train, view
from cgtorch.graphs import ActionSet, Graphs, Skill, check_action, load_skill, skill_to_dict
from cgtorch.simulation import rollout

ROOT = Path(__file__).parent.parent
COMMANDS = {
    "cgtorch-train": train.command,
    "cgtorch-evaluate": evaluate.command,
    "cgtorch-export": export.command,
    "cgtorch-report": report.command,
    "cgtorch-robot": robot.command,
    "cgtorch-view": view.command,
}
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OWN, PYTHON = ROOT / "docs" / "own-action.md", ROOT / "docs" / "python.md"


def blocks(document: Path) -> dict[str, str]:
    """The code of a document by the file name in its first line."""
    found = re.findall(r"^```python\n# (\w+\.py)\n(.*?)^```", document.read_text(), re.M | re.S)
    return dict(found)


def written(document: Path, folder: Path) -> None:
    """Put all code of a document into a folder."""
    for name, code in blocks(document).items():
        (folder / name).write_text(code)


def commands() -> list[tuple[str, list[str]]]:
    """Every command of ours in a document that stands on a line of its own."""
    lines = (
        line.strip()
        for document in DOCUMENTS
        for line in document.read_text().replace("\\\n", "").splitlines()
        if line.startswith("    cgtorch-")
    )
    words = [shlex.split(line.partition(" && ")[0], comments=True) for line in lines]
    return [(first, rest) for first, *rest in words]


def test_every_command_in_the_documents_is_understood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for page in ("tutorial.md", "robot.md"):
        written(ROOT / "docs" / page, tmp_path)
    package = tmp_path / "my_package"  # somebody's own, of which the helps speak
    package.mkdir()
    shutil.copy(ROOT / "examples" / "cart.py", package)
    for folder in (ROOT, ROOT / "examples", tmp_path):  # where the documents say one is
        monkeypatch.syspath_prepend(folder)
    found = commands()
    assert {name for name, _ in found} == set(COMMANDS)
    for name, words in found:
        unfit = ("RUN_OR_SKILL", "F", "FILE", "--help")  # placeholders, and what would end here
        about = [word for word in words if word not in unfit]
        try:
            COMMANDS[name].make_context(name, about, resilient_parsing=words != about)
        except click.ClickException as e:
            pytest.fail(f"{name} {' '.join(words)}: {e.format_message()}")


def test_the_example_of_the_readme_prints_what_it_says(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "README.md").read_text()
    ((code, said),) = re.findall(r"^```python\n(.*?)^```.*?^```text\n(.*?)^```", text, re.M | re.S)
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102
    assert capsys.readouterr().out == said
    assert len(text.splitlines()) <= 120


def test_the_template_of_an_action_passes_its_test(tmp_path: Path) -> None:
    written(OWN, tmp_path)
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_approach.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout
    assert "2 passed" in ended.stdout


@pytest.mark.parametrize("name", ["Approach", "Attempts", "Wander"])
def test_the_actions_in_the_documents_keep_the_interface(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(OWN, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    action = getattr(importlib.import_module(name.lower()), name)()
    check_action(name, action, world(0, 2))


def test_attempts_counts_and_wander_wanders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(OWN, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    attempts, wander = (
        getattr(importlib.import_module(name.lower()), name)() for name in ("Attempts", "Wander")
    )
    actions = ActionSet(("Attempts", "Wander"), (attempts, wander))
    # From Attempts all ways lead to Wander, and back.
    edges = torch.tensor([[[1, 1, 1], [0, 0, -1]]])
    parameters = torch.ones(1, 2, 1)
    graph = Graphs(torch.tensor([[0, 1]]), edges, parameters, torch.tensor([0]))
    outcomes = list[list[int]]()
    rollout(
        graph,
        actions,
        world(0, 30),
        max_transitions=12,
        trace=lambda active, node, outcome, lanes: outcomes.append(outcome.tolist()),
    )
    assert [set(step) for step in outcomes[::2]] == [{0}, {1}, {1}, {1}, {2}, {2}]
    assert [set(step) for step in outcomes[1::2]] == [{0, 1}] * 6


def test_the_entry_point_in_the_document_is_one() -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", OWN.read_text(), re.M | re.S)
    declared = tomllib.loads(text)["project"]["entry-points"]["cgtorch.actions"]
    assert declared == {"Approach": "approach:Approach"}
    assert "class Approach" in blocks(OWN)["approach.py"]


def ran(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a program in docs/python.md leaves behind, run in a folder."""
    written(PYTHON, folder)
    monkeypatch.chdir(folder)
    return runpy.run_path(name)


def test_an_own_action_in_an_evolved_skill_in_forty_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(blocks(PYTHON)["own_action.py"].splitlines()) + 1 <= 40
    left = ran("own_action.py", tmp_path, monkeypatch)
    skill: Skill = left["skill"]
    printed = capsys.readouterr().out
    (reached,) = re.findall(r"^reaches (\d+) of 50$", printed, re.M)
    assert int(reached) == left["runs"].succeeded.sum() >= 20
    course = [int(n) for n in re.findall(r"^generation \d reaches (\d+) of 20$", printed, re.M)]
    assert len(course) == 5
    assert course[-1] > course[0] > 0
    again = load_skill(tmp_path / "reach.json", left["actions"])
    assert skill_to_dict(again) == skill_to_dict(skill)
    assert (tmp_path / "reach.png").read_bytes().startswith(b"\x89PNG")

    own, used = left["actions"].index("Approach"), torch.zeros(20, dtype=torch.bool)

    def trace(active: torch.Tensor, node: torch.Tensor, *rest: object) -> None:
        used[active] |= skill.graph.action[0, node] == own

    runs = rollout(skill.graph, skill.actions, left["world"], trace=trace)
    assert int(runs.succeeded.sum()) == course[-1]
    # What is reached is reached by it, but where the robot stood near enough to begin with.
    assert (runs.succeeded[0] & used).sum() > course[-1] / 2


DOORS = ("door.py", "course.py", "quick.py")


@pytest.mark.parametrize("name", DOORS)
def test_programs_from_python_are_short(name: str) -> None:
    assert len(blocks(PYTHON)[name].strip().splitlines()) <= 12


def test_a_program_trains_and_acts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It drives once and grasps; a percept that never changes would do for any robot."""
    left = ran("door.py", tmp_path, monkeypatch)
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == f"S0 {left['run'].evaluate(50, scenarios='near').successes}"
    assert int(first.split()[1]) > 40
    assert rest[0].startswith("control MoveBase (")
    assert rest[-1] == "test Grasp ()"
    assert left["request"].kind == "success"


def test_a_program_plots_what_happened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    left = ran("course.py", tmp_path, monkeypatch)
    left["plt"].close("all")
    assert (tmp_path / "pole.png").read_bytes().startswith(b"\x89PNG")
    assert len(left["means"]) >= 3
    assert left["means"]["mean"].max() >= 475
    assert {"stage", "generation", "accepted"} <= set(left["log"].event)


def test_asking_and_telling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    left = ran("quick.py", tmp_path, monkeypatch)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [int(number) for number, _ in lines] == [1, 2, 3, 4, 5, 6]
    fitness = [float(value) for _, value in lines]
    assert fitness == sorted(fitness)
    assert fitness[-1] > fitness[0] > 0
    assert isinstance(left["skill"], Skill)
