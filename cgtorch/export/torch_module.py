"""A skill as a file for `torch.export.load`: one module that needs only torch."""

import io
import json

import torch
from torch import nn
from torch.export import ExportedProgram

from cgtorch.export.computed import traced
from cgtorch.export.step import SkillStep
from cgtorch.graphs import Skill
from cgtorch.ground.errors import SettingsError

ABOUT = "skill.json"
"""The extra file with names and sizes; see `SkillStep.about`."""


def to_module(skill: Skill, percept_size: int | None = None) -> bytes:
    """The skill's `SkillStep` as a .pt2 archive; ActionError if an action does more than compute.

    `percept_size` is the length of a percept, by default that which its networks read.

    Its graph and description are JSON and its weights are raw numbers. Unlike torch's own archives,
    it contains no example inputs, which would be pickled.
    """
    step, program = SkillStep(skill, percept_size), exported(skill, percept_size)
    program.example_inputs = None
    file = io.BytesIO()
    torch.export.save(program, file, extra_files={ABOUT: json.dumps(step.about())})
    return file.getvalue()


def exported(skill: Skill, percept_size: int | None = None) -> ExportedProgram:
    """The skill's step as an exported program, without the source lines that it comes from.

    ActionError if torch.export cannot trace an action, SettingsError if torch is too old.
    """
    if not hasattr(torch, "while_loop"):
        raise SettingsError(f"torch {torch.__version__} cannot export loops; install a newer one")
    step = SkillStep(skill, percept_size)
    step.computed = nn.ModuleList(traced(action) for action in step.carried)
    program = torch.export.export(step, step.first())
    for module in program.graph_module.modules():
        if isinstance(module, torch.fx.GraphModule):
            for node in module.graph.nodes:
                for source in ("stack_trace", "nn_module_stack", "source_fn_stack", "torch_fn"):
                    node.meta.pop(source, None)
    return program
