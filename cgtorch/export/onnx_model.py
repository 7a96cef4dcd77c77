"""A skill as an ONNX model of a whole step with its networks, for any ONNX runtime."""

import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import torch
from torch.export import ExportedProgram

from cgtorch.export.computed import refused
from cgtorch.export.step import SkillStep
from cgtorch.export.torch_module import exported
from cgtorch.graphs import Skill
from cgtorch.ground.errors import CgtorchError, SettingsError

if TYPE_CHECKING:
    import onnx

INPUTS = ["percept", "outcome", "place", "mind"]
OUTPUTS = ["request", "control", "next_place", "next_mind"]
ABOUT = "cgtorch"
"""The metadata property that contains names and sizes as JSON; see `SkillStep.about`."""


def to_onnx(skill: Skill, percept_size: int | None = None) -> bytes:
    """The skill's `SkillStep` as an ONNX model with inputs `INPUTS` and outputs `OUTPUTS`.

    `percept_size` is the length of a percept, by default that which its networks read.

    SettingsError if packages for ONNX are missing, ActionError if an action does more than compute,
    or ONNX has no operator for it.
    """
    try:
        import onnx
        import onnxscript  # noqa: F401  # torch.onnx needs it
    except ImportError as e:
        raise SettingsError(
            f"ONNX needs package {e.name!r}, which is not installed; pip install 'cgtorch[onnx]'"
        ) from e
    step = SkillStep(skill, percept_size)
    with _silence():
        try:
            model = _converted(exported(skill, percept_size), INPUTS, OUTPUTS)
        except CgtorchError:
            raise
        except Exception:  # torch.onnx raises whatever it meets
            _blame(step)
            raise
    model.producer_name = "cgtorch"
    _tidy(model.graph, set())
    onnx.helper.set_model_props(model, {ABOUT: json.dumps(step.about())})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _converted(
    program: ExportedProgram, inputs: list[str] | None = None, outputs: list[str] | None = None
) -> "onnx.ModelProto":
    converted = torch.onnx.export(
        program, dynamo=True, verbose=False, input_names=inputs, output_names=outputs
    )
    assert converted is not None  # it is only without dynamo  # noqa: S101
    return converted.model_proto


def _blame(step: SkillStep) -> None:
    """Raise an ActionError for the action that cannot be converted, if there is one."""
    for one in step.carried:
        try:
            _converted(torch.export.export(one, one.arguments))
        except Exception as e:
            reason = f"ONNX lacks something that it does ({type(e).__name__})"
            raise refused(one.name, reason) from e


def _tidy(graph: "onnx.GraphProto", used: set[str]) -> set[str]:
    """Remove metadata of torch and unused constants; returns all names that are `used`."""
    for node in graph.node:
        del node.metadata_props[:]
        used.update(node.input)
        for attribute in node.attribute:
            if attribute.HasField("g"):
                _tidy(attribute.g, used)
    for value in (*graph.input, *graph.output, *graph.value_info):
        del value.metadata_props[:]
    used.update(value.name for value in graph.output)
    kept = [constant for constant in graph.initializer if constant.name in used]
    del graph.initializer[:]
    graph.initializer.extend(kept)
    return used


@contextmanager
def _silence() -> Iterator[None]:
    """Without messages about optional packages and optimisations."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
