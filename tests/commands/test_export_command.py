"""`cgtorch-export`: every format of a run, a stage, an earlier skill and a file; bad input."""

import io
import json
import os
import zipfile
from pathlib import Path

import networkx as nx
import onnx
import pydot
import pytest
import torch
from command_line import EXPORT, REFERENCE, Shell, listing
from exported import SLOW, exported
from trained import Trained

from cgtorch import export
from cgtorch.commands.export import FORMATS
from cgtorch.domains.data_files import read_data
from cgtorch.graphs import Skill, load_skill, same_behaviour, skill_to_dict
from cgtorch.runs.chosen import last_skill, stored_data

SKILL = REFERENCE / "S0" / "skill.json"


def test_the_formats_are_those_of_the_library() -> None:
    assert (*export.FORMATS, "data") == FORMATS


def test_json_reads_back_as_the_same_skill(shell: Shell, tmp_path: Path) -> None:
    ended = shell.does(EXPORT, REFERENCE, "--format", "json", "--output", "mine.json")
    size = (tmp_path / "mine.json").stat().st_size
    assert (ended.err, ended.out) == ("", f"S3 as json: mine.json, {size} bytes\n")
    run, skill = last_skill(REFERENCE)
    again = load_skill(tmp_path / "mine.json", run.actions)
    assert same_behaviour(skill, again)
    assert skill_to_dict(again) == skill_to_dict(skill)
    assert (tmp_path / "mine.json").read_bytes() == (REFERENCE / "S3/skill.json").read_bytes()


@pytest.mark.parametrize("form", [form for form in export.FORMATS if form not in SLOW])
def test_every_format(shell: Shell, tmp_path: Path, form: str) -> None:
    output = tmp_path / "out.pt2"
    assert shell.does(EXPORT, REFERENCE / "S0", "--format", form, "--output", output).err == ""
    assert listing(tmp_path) == {"out.pt2"}
    data = output.read_bytes()
    match form:
        case "json":
            assert json.loads(data)["name"] == "S0"
        case "state-machine":
            compile(data, "skill.py", "exec")
        case "dot":
            assert len(pydot.graph_from_dot_data(data.decode())) == 1
        case "graphml":
            assert len(nx.parse_graphml(data.decode())) == data.count(b"<node ") > 5
        case "mermaid":
            assert data.startswith(b"flowchart TD\n")


def test_a_device_or_a_pipe_is_not_replaced(shell: Shell, tmp_path: Path) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    words = EXPORT, REFERENCE, "--format", "json", "--output", pipe, "--force"
    assert "is a device or a pipe; choose another --output" in shell.refuses(*words)
    assert pipe.is_fifo()


@pytest.mark.hostile
@pytest.mark.parametrize("form", SLOW)
def test_a_file_that_takes_longer(form: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    data = exported(form, tmp_path_factory)
    if form == "module":
        assert zipfile.is_zipfile(io.BytesIO(data))
    else:
        onnx.checker.check_model(onnx.load_from_string(data))


@pytest.mark.parametrize("name", ["S0.pt2", "S0.onnx", "S0.py"])
def test_an_export_is_no_skill_for_a_command(shell: Shell, tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    message = shell.refuses("cgtorch-evaluate", name)
    assert f"{name}' is an export for other programs" in message


def test_an_earlier_skill_and_a_skill_file(shell: Shell, tmp_path: Path) -> None:
    places = [REFERENCE, "--skill", "S1"], [REFERENCE / "S1"], [REFERENCE / "S1" / "skill.json"]
    for number, words in enumerate(places):
        shell.does(EXPORT, *words, "--format", "dot", "--output", f"{number}.dot")
    (text,) = {path.read_bytes() for path in tmp_path.glob("*.dot")}
    assert b'digraph "S1"' in text


@pytest.mark.parametrize(("scenarios", "size"), [("perimeter", 7), ("general", 9)])
def test_what_the_skill_of_a_file_perceives(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, scenarios: str, size: int
) -> None:
    sizes = []

    def written(skill: Skill, percept_size: int) -> bytes:
        sizes.append(percept_size)
        return b""

    monkeypatch.setitem(export.FORMATS, "module", written)
    words = ("--format", "module", "--output", "S0.pt2", "--scenarios", scenarios)
    shell.does(EXPORT, SKILL, *words)
    assert sizes == [size]


def test_a_file_is_replaced_only_when_asked(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text("precious")
    words = (EXPORT, REFERENCE, "--format", "json", "--output", "mine.json")
    assert "'mine.json' exists; choose another --output or add --force" in shell.refuses(*words)
    assert (tmp_path / "mine.json").read_text() == "precious"
    shell.does(*words, "--force")
    assert json.loads((tmp_path / "mine.json").read_text())["name"] == "S3"


ASKS = '''
from cgtorch.graphs import Action


class Asks(Action):
    """Perceives again."""

    outcomes = ("success", "failure")

    def forward(self, lanes, parameters, environment):
        return environment.observe(lanes), lanes.step * 0
'''


def test_an_action_of_ones_own(shell: Shell, tmp_path: Path) -> None:
    """It is a class to fill in; where it cannot be carried along, it is named."""
    (tmp_path / "asking_actions.py").write_text(ASKS)
    text = SKILL.read_text()
    assert '"action": "MoveBase"' in text
    (tmp_path / "own.json").write_text(text.replace('"action": "MoveBase"', '"action": "Asks"'))
    words = (EXPORT, "own.json", "--actions", "asking_actions:Asks", "--output")
    for form in ("module", "onnx"):
        line = shell.refuses(*words, "out.pt2", "--format", form)
        assert "action 'Asks' cannot be exported: it asks its environment for 'observe'" in line
        assert "state-machine" in line
    assert not (tmp_path / "out.pt2").exists()
    for form in ("json", "state-machine", "dot", "graphml", "mermaid"):
        assert shell.does(*words, f"out.{form}", "--format", form).err == ""
    assert "class Asks(State):" in (tmp_path / "out.state-machine").read_text()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nowhere", "--format", "json", "--output", "x"), "no run"),
        ((REFERENCE, "--format", "png", "--output", "x"), "'png' is not one of"),
        ((REFERENCE, "--format", "json"), "Missing option '--output'"),
        ((REFERENCE, "--output", "x"), "Missing option '--format'"),
        ((REFERENCE, "--format", "json", "--output", "no/where/x"), "'no/where' is no folder"),
        ((REFERENCE, "--format", "json", "--output", "x", "--skill", "S9"), "S9"),
        ((REFERENCE / "run.json", "--format", "json", "--output", "x"), "not a skill file"),
        ((SKILL, "--format", "dot", "--output", "x", "--scenarios", "moon"), "moon"),
        (
            (REFERENCE / "S0", "--format", "module", "--output", "S0.pt"),
            "--output is 'S0.pt'; give a name that ends in .pt2 for --format module",
        ),
    ],
)
def test_bad_input(shell: Shell, tmp_path: Path, words: tuple[object, ...], line: str) -> None:
    assert line in shell.refuses(EXPORT, *words)
    assert listing(tmp_path) == set()


def test_the_data_of_a_run_are_a_table(shell: Shell, trained: Trained, tmp_path: Path) -> None:
    run, part, data = stored_data(trained.folder)
    said = shell.does(EXPORT, run.folder, "--format", "data", "--output", "data.csv").out
    counts = f"{len(data.percept)} transitions and {len(data.tested)} tests"
    assert said == f"data of {part}: data.csv, {counts}\n"
    again = read_data(("data.csv",), run.domain.percept, run.domain.control)
    for name, value in vars(again).items():
        assert torch.equal(value, vars(data)[name]), name
