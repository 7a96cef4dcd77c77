"""A skill's step as a file for `torch.export.load`, or as an ONNX model for any ONNX runtime."""

import io
import json
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import torch
from torch import nn
from torch.export import ExportedProgram

from cgtorch.export.step import SkillStep
from cgtorch.graphs import Skill
from cgtorch.ground.errors import CgtorchError, SettingsError

if TYPE_CHECKING:
    import onnx

ABOUT, ONNX_ABOUT = "skill.json", "cgtorch"
"""The extra file, and the metadata property, with names and sizes as JSON (`SkillStep.about`)."""
INPUTS = ["percept", "outcome", "place", "mind"]  # of `SkillStep.forward`
OUTPUTS = ["request", "control", "next_place", "next_mind"]


def to_module(skill: Skill, percept_size: int | None = None) -> bytes:
    """The skill's `SkillStep` as a .pt2 archive; ActionError if an action does more than compute.

    `percept_size` is the length of a percept, by default that which its networks read.

    Its graph and description are JSON and its weights are raw numbers. Unlike torch's own archives,
    it contains no example inputs, which would be pickled.
    """
    step = SkillStep(skill, percept_size)
    program = _exported(step)
    program.example_inputs = None
    file = io.BytesIO()
    torch.export.save(program, file, extra_files={ABOUT: json.dumps(step.about())})
    return file.getvalue()


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
            model = _converted(_exported(step), OUTPUTS)
        except CgtorchError:
            raise
        except Exception:  # torch.onnx raises whatever it meets
            _blame(SkillStep(skill, percept_size))
            raise
    model.producer_name = "cgtorch"
    _tidy(model.graph, set())
    onnx.helper.set_model_props(model, {ONNX_ABOUT: json.dumps(step.about())})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _exported(step: SkillStep) -> ExportedProgram:
    """A step, with traced actions, as a program without the source lines that it comes from.

    ActionError if torch.export cannot trace an action, SettingsError if torch is too old.
    """
    if not hasattr(torch, "while_loop"):
        raise SettingsError(f"torch {torch.__version__} cannot export loops; install a newer one")
    step.computed = nn.ModuleList(action.traced() for action in step.carried)
    program = torch.export.export(step, step.first())
    for module in program.graph_module.modules():
        if isinstance(module, torch.fx.GraphModule):
            for node in module.graph.nodes:
                for source in ("stack_trace", "nn_module_stack", "source_fn_stack", "torch_fn"):
                    node.meta.pop(source, None)
    return program


def _converted(program: ExportedProgram, outputs: Sequence[str] | None = None) -> "onnx.ModelProto":
    """The model of a program; its inputs have the names of the program's."""
    converted = torch.onnx.export(program, dynamo=True, verbose=False, output_names=outputs)
    assert converted is not None  # it is only without dynamo  # noqa: S101
    return converted.model_proto


def _blame(step: SkillStep) -> None:
    """Raise an ActionError for the action that cannot be converted, if there is one."""
    for action in step.carried:
        try:
            _converted(torch.export.export(action, action.arguments))
        except Exception as e:
            raise action.refused(f"ONNX lacks something that it does ({type(e).__name__})") from e


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
