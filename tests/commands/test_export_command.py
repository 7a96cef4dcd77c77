"""`cgtorch-export`: every format of a run, a stage, an earlier skill and a file; bad input."""

import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import networkx as nx
import onnx
import pydot
import pytest
from command_line import Shell, in_a_shell, listing

from cgtorch.commands.export import FORMATS
from cgtorch.export import FORMATS as FUNCTIONS
from cgtorch.graphs import load_skill, same_behaviour, skill_to_dict
from cgtorch.runs.chosen import last_skill

EXPORT = "cgtorch-export"
REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


def test_help_has_examples() -> None:
    ended = in_a_shell(EXPORT, "--help")
    assert (ended.code, ended.err) == (0, "")
    assert "Examples:" in ended.out
    for form in FORMATS:
        assert f"--format {form} " in ended.out


def test_help_does_not_wait_for_torch() -> None:
    code = "import sys, cgtorch.commands.export; print({'torch', 'onnx'} & set(sys.modules))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\n"


def test_the_formats_are_those_of_the_library() -> None:
    assert (*FUNCTIONS, "data") == FORMATS


def test_json_reads_back_as_the_same_skill(shell: Shell, tmp_path: Path) -> None:
    ended = shell(EXPORT, REFERENCE, "--format", "json", "--output", "mine.json")
    size = (tmp_path / "mine.json").stat().st_size
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == f"S3 as json: mine.json, {size} bytes\n"
    run, skill = last_skill(REFERENCE)
    again = load_skill(tmp_path / "mine.json", run.actions)
    assert same_behaviour(skill, again)
    assert skill_to_dict(again) == skill_to_dict(skill)
    assert (tmp_path / "mine.json").read_bytes() == (REFERENCE / "S3/skill.json").read_bytes()


@pytest.mark.parametrize("form", FUNCTIONS)
def test_every_format(shell: Shell, tmp_path: Path, form: str) -> None:
    output = tmp_path / "out.pt2"
    ended = shell(EXPORT, REFERENCE / "S0", "--format", form, "--output", output)
    assert (ended.code, ended.err) == (0, "")
    assert listing(tmp_path) == {"out.pt2"}
    data = output.read_bytes()
    match form:
        case "json":
            assert json.loads(data)["name"] == "S0"
        case "module":
            assert zipfile.is_zipfile(io.BytesIO(data))
        case "onnx":
            onnx.checker.check_model(onnx.load_from_string(data))
        case "state-machine":
            compile(data, "skill.py", "exec")
        case "dot":
            assert len(pydot.graph_from_dot_data(data.decode())) == 1
        case "graphml":
            assert len(nx.parse_graphml(data.decode())) == data.count(b"<node ") > 5
        case "mermaid":
            assert data.startswith(b"flowchart TD\n")


def test_an_earlier_skill_and_a_skill_file(shell: Shell, tmp_path: Path) -> None:
    shell(EXPORT, REFERENCE, "--skill", "S1", "--format", "dot", "--output", "a.dot")
    shell(EXPORT, REFERENCE / "S1", "--format", "dot", "--output", "b.dot")
    shell(EXPORT, REFERENCE / "S1" / "skill.json", "--format", "dot", "--output", "c.dot")
    texts = {(tmp_path / name).read_bytes() for name in ("a.dot", "b.dot", "c.dot")}
    assert len(texts) == 1
    assert b'digraph "S1"' in texts.pop()


@pytest.mark.parametrize(("scenarios", "size"), [("perimeter", 7), ("general", 9)])
def test_what_the_skill_of_a_file_perceives(
    shell: Shell, tmp_path: Path, scenarios: str, size: int
) -> None:
    path = REFERENCE / "S0" / "skill.json"
    words = ("--format", "module", "--output", "S0.pt2", "--scenarios", scenarios)
    ended = shell(EXPORT, path, *words)
    assert ended.code == 0, ended
    with zipfile.ZipFile(tmp_path / "S0.pt2") as archive:
        (about,) = (name for name in archive.namelist() if name.endswith("extra/skill.json"))
        assert json.loads(archive.read(about))["percept"] == size


def test_an_export_for_programs_is_not_read_back(shell: Shell, tmp_path: Path) -> None:
    for form, name in (("module", "S0.pt2"), ("onnx", "S0.onnx"), ("state-machine", "S0.py")):
        shell(EXPORT, REFERENCE / "S0", "--format", form, "--output", name)
        message = shell.refuses("cgtorch-evaluate", tmp_path / name)
        assert f"{name}' is an export for other programs" in message


def test_a_file_is_replaced_only_when_asked(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text("precious")
    words = (EXPORT, REFERENCE, "--format", "json", "--output", "mine.json")
    assert "'mine.json' exists; choose another --output or add --force" in shell.refuses(*words)
    assert (tmp_path / "mine.json").read_text() == "precious"
    assert shell(*words, "--force").code == 0
    assert json.loads((tmp_path / "mine.json").read_text())["name"] == "S3"


def test_a_module_has_the_name_that_torch_wants(shell: Shell, tmp_path: Path) -> None:
    words = (EXPORT, REFERENCE / "S0", "--format", "module", "--output", "S0.pt")
    assert (
        "--output is 'S0.pt'; give a name that ends in .pt2 for --format module"
        in shell.refuses(*words)
    )
    assert listing(tmp_path) == set()


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
    text = (REFERENCE / "S0" / "skill.json").read_text()
    assert '"action": "MoveBase"' in text
    (tmp_path / "own.json").write_text(text.replace('"action": "MoveBase"', '"action": "Asks"'))
    words = (EXPORT, "own.json", "--actions", "asking_actions:Asks", "--output")
    for form in ("module", "onnx"):
        line = shell.refuses(*words, "out.pt2", "--format", form)
        assert "action 'Asks' cannot be exported: it asks its environment for 'observe'" in line
        assert "state-machine" in line
    for form in ("json", "state-machine", "dot", "graphml", "mermaid"):
        ended = shell(*words, f"out.{form}", "--format", form)
        assert (ended.code, ended.err) == (0, ""), ended
    assert "class Asks(State):" in (tmp_path / "out.state-machine").read_text()
    assert not (tmp_path / "out.pt2").exists()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nowhere", "--format", "json", "--output", "x"), "no run"),
        ((REFERENCE, "--format", "png", "--output", "x"), "'png' is not one of"),
        ((REFERENCE, "--format", "json"), "Missing option '--output'"),
        ((REFERENCE, "--output", "x"), "Missing option '--format'"),
        ((REFERENCE, "--format", "json", "--output", "no/where/x"), "where"),
        ((REFERENCE, "--format", "json", "--output", "x", "--skill", "S9"), "S9"),
        ((REFERENCE / "run.json", "--format", "json", "--output", "x"), "not a skill file"),
        (
            (
                REFERENCE / "S0/skill.json",
                "--format",
                "dot",
                "--output",
                "x",
                "--scenarios",
                "moon",
            ),
            "moon",
        ),
    ],
)
def test_bad_input(shell: Shell, tmp_path: Path, words: tuple[object, ...], line: str) -> None:
    assert line in shell.refuses(EXPORT, *words)
    assert listing(tmp_path) == set()
