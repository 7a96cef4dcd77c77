"""The ONNX model equals the library in onnxruntime."""

import json
import sys
from dataclasses import replace

import onnx
import onnxruntime
import pytest
import torch
from driving import (
    Execution,
    Step,
    by_the_library,
    reference,
    stacked,
)
from exported import exported
from support import circle, world
from test_step import Learned, lone
from torch import Tensor

from cgtorch.export import to_onnx
from cgtorch.export.modules import INPUTS, ONNX_ABOUT, OUTPUTS
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError, SettingsError
from cgtorch.tabletop.actions import paper_actions


def session(data: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])


def runtime(data: bytes) -> tuple[Step, dict[str, object]]:
    running = session(data)
    about = json.loads(running.get_modelmeta().custom_metadata_map[ONNX_ABOUT])

    def step(*arguments: Tensor) -> list[Tensor]:
        given = {name: a.numpy() for name, a in zip(INPUTS, arguments, strict=True)}
        return [torch.from_numpy(x) for x in map(torch.Tensor.numpy, _tensors(running, given))]

    return step, about


def _tensors(running: onnxruntime.InferenceSession, given: dict[str, object]) -> list[Tensor]:
    return [torch.tensor(x) for x in running.run(OUTPUTS, given)]


def replayed(data: bytes, runs: list[Execution]) -> None:
    """All requests right, all motions within 1e-5, on the percepts that the library met."""
    step, about = runtime(data)
    given = stacked(runs)
    for i, rows in enumerate(given["rows"].tolist()):
        place, mind = torch.zeros(about["place"], dtype=torch.long), torch.zeros(about["mind"])
        for t in range(rows):
            request, control, place, mind = step(
                given["percept"][t, i], given["outcome"][t, i], place, mind
            )
            assert request == given["request"][t, i]
            torch.testing.assert_close(control, given["control"][t, i], rtol=0, atol=1e-5)


@pytest.fixture
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The model of the reference run's skill."""
    return exported("onnx", tmp_path_factory)


@pytest.mark.hostile
def test_five_hundred_percepts(data: bytes) -> None:
    _, skill = reference()
    runs, _ = by_the_library(skill, world(12, 90))
    assert sum(len(run.percepts) for run in runs) >= 500
    replayed(data, runs)


@pytest.mark.hostile
def test_a_skill_that_computes_nothing() -> None:
    skill = circle(paper_actions(), "MoveBase", "Grasp")
    runs, _ = by_the_library(skill, world(4, 90))
    replayed(to_onnx(skill, percept_size=7), runs)


@pytest.mark.hostile
def test_the_model_is_whole_and_tells_nothing_else(data: bytes) -> None:
    proto = onnx.load_from_string(data)
    assert proto.producer_name == "cgtorch"
    onnx.checker.check_model(proto, full_check=True)
    assert [i.name for i in proto.graph.input] == INPUTS
    assert [o.name for o in proto.graph.output] == OUTPUTS
    assert b".py" not in data


class Eigenvalues(Learned):
    """Uses what ONNX has no operator for."""

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        lanes, out = super().forward(lanes, parameters, environment)
        square = lanes.message[:, :, None] * lanes.message[:, None]
        return replace(lanes, message=torch.linalg.eigvalsh(square)), out


@pytest.mark.hostile
def test_an_action_that_onnx_cannot_say_is_named() -> None:
    with pytest.raises(ActionError, match="action 'Mine' cannot be exported: ONNX lacks"):
        to_onnx(lone(Eigenvalues()), percept_size=7)


@pytest.mark.parametrize("missing", ["onnx", "onnxscript"])
def test_without_the_packages(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(SettingsError, match=rf"needs package '{missing}'.*cgtorch\[onnx\]"):
        to_onnx(lone(Learned()))
