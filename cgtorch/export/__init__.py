"""Export: a skill in formats that other programs read or run without this library."""

from collections.abc import Callable, Mapping

from cgtorch.export.modules import to_module as to_module
from cgtorch.export.modules import to_onnx as to_onnx
from cgtorch.export.state_machine import to_state_machine as to_state_machine
from cgtorch.export.step import SkillStep as SkillStep
from cgtorch.export.stepper import Request as Request
from cgtorch.export.stepper import Stepper as Stepper
from cgtorch.export.text import to_dot as to_dot
from cgtorch.export.text import to_graphml as to_graphml
from cgtorch.export.text import to_json as to_json
from cgtorch.export.text import to_mermaid as to_mermaid

FORMATS: Mapping[str, Callable[..., bytes]] = {
    "json": to_json,
    "module": to_module,
    "onnx": to_onnx,
    "state-machine": to_state_machine,
    "dot": to_dot,
    "graphml": to_graphml,
    "mermaid": to_mermaid,
}
"""The formats of `cgtorch-export --format`: functions from a skill to the content of a file.

Those of `SIZED` can also be given the length of a percept, as `percept_size`.
"""
SIZED = ("module", "onnx")
