"""A small skill as a .pt2 archive and as an ONNX model, each made once for the tests here."""

import io
import json
import zipfile
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import onnx
import pytest
import torch
from driving import Step
from test_onnx_model import runtime
from test_step import lone
from test_torch_module import Decides
from walking import chain, walking_actions

from cgtorch.export import SkillStep, to_module, to_onnx
from cgtorch.export.modules import ABOUT, INPUTS, OUTPUTS
from cgtorch.graphs import Action, Skill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError


def small() -> Skill:
    """Aims, steps, and tests where it has arrived."""
    graph = chain(walking_actions(), "Aim", "Step", "Test", speed=0.5)
    graph.parameters[0, 0, :2] = torch.tensor([1.0, -2.0])
    graph.parameters[0, 0, 9] = 1.0
    return Skill("small", graph, walking_actions(), 7)


@pytest.fixture(scope="module")
def archive() -> bytes:
    return to_module(small())


@pytest.fixture(scope="module")
def written() -> tuple[bytes, str]:
    """The ONNX model, and what was printed meanwhile."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        return to_onnx(small()), said.getvalue()


def acts_alike(step: Step, about: dict[str, Any]) -> None:
    """A step does what the skill does, with a robot that goes on and succeeds in the end."""
    expected = SkillStep(small())
    assert about == expected.about()
    place, mind = torch.zeros(about["place"], dtype=torch.long), torch.zeros(about["mind"])
    asked, controls = list[str](), set[float]()
    for turn in range(5):
        percept, outcome = torch.tensor([turn - 2.0, 0.5]), torch.tensor(int(turn == 2))
        given = percept, outcome, place, mind
        wanted = expected(*given)
        for one, other in zip(step(*given), wanted, strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=1e-6)
        request, control, place, mind = wanted
        asked.append(about["requests"][int(request)])
        controls.add(round(control.item(), 3))
    assert asked == ["Step", "Test", "Step", "Test", "success"]
    assert len(controls) == 3  # another at another percept, and none with a test


def test_an_archive_does_what_the_skill_does(archive: bytes) -> None:
    extra = {ABOUT: ""}
    program = torch.export.load(io.BytesIO(archive), extra_files=extra)
    acts_alike(program.module(), json.loads(extra[ABOUT]))


def test_an_archive_holds_no_examples_and_no_places_of_sources(archive: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        content = {name: files.read(name) for name in files.namelist()}
    assert not [name for name, data in content.items() if name.endswith(".pt") and data]
    assert not [name for name, data in content.items() if b".py" in data]
    assert not [name for name, data in content.items() if str(Path.cwd()).encode() in data]


def graphs(graph: onnx.GraphProto) -> Iterator[onnx.GraphProto]:
    """A graph and those in its loops."""
    yield graph
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.GRAPH:
                yield from graphs(attribute.g)


def test_a_model_does_what_the_skill_does(written: tuple[bytes, str]) -> None:
    acts_alike(*runtime(written[0]))


def test_a_model_is_tidy_and_made_in_silence(written: tuple[bytes, str]) -> None:
    data, said = written
    assert said == ""
    model = onnx.load_from_string(data)
    onnx.checker.check_model(model, full_check=True)
    assert model.producer_name == "cgtorch"
    assert [value.name for value in model.graph.input] == INPUTS
    assert [value.name for value in model.graph.output] == OUTPUTS
    found = list(graphs(model.graph))
    assert len(found) > 1
    for graph in found:
        values = *graph.input, *graph.output, *graph.value_info
        assert not [part.name for part in (*graph.node, *values) if part.metadata_props]
    used = {name for graph in found for node in graph.node for name in node.input}
    used |= {value.name for graph in found for value in graph.output}
    assert {constant.name for constant in model.graph.initializer} <= used


class Eigenvalues(Action):
    """Uses what ONNX has no operator for."""

    message_size = 2

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        square = lanes.message[:, :, None] * lanes.message[:, None]
        return replace(lanes, message=torch.linalg.eigvalsh(square)), lanes.step * 0


def test_an_action_that_onnx_cannot_say_is_named() -> None:
    said = "action 'Mine' cannot be exported: ONNX lacks something that it does"
    with pytest.raises(ActionError, match=said):
        to_onnx(lone(Eigenvalues()), percept_size=2)


def test_an_action_that_torch_cannot_follow_is_named_for_onnx_as_well() -> None:
    with pytest.raises(ActionError, match="'Mine' cannot be exported: GuardOnDataDependent"):
        to_onnx(lone(Decides()), percept_size=7)
