"""Exported skills with networks that remember: every format carries their state along."""

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import pytest
import torch
from driving import Execution, Step, assert_same, by_steps, by_the_library
from plain_machines import filled_in, imported
from support import Visits, model, seeded
from test_onnx_model import runtime
from torch import Tensor
from walking import chain

from cgtorch.export import (
    SkillStep,
    to_dot,
    to_graphml,
    to_mermaid,
    to_module,
    to_onnx,
    to_state_machine,
)
from cgtorch.export.modules import ABOUT
from cgtorch.graphs import (
    Action,
    DelayNN,
    LinearNN,
    RecurrentNN,
    Skill,
    SubSkill,
)
from cgtorch.report import draw_skill
from cgtorch.tabletop.actions import paper_actions

PLACE = model(0, 6)


def remembering() -> Skill:
    """A skill in which a network and one in an earlier skill go on from the same state.

    An action with a memory comes before it, and one with two numbers between it and another one.
    """
    own = ["Visits", "RecurrentNN", "Smaller"], [Visits(), RecurrentNN(), RecurrentNN(7, 2)]
    linear = ["LinearNN", "DelayNN"], [LinearNN(), DelayNN(7, 2)]
    actions = paper_actions().extended(*own).extended(*linear)

    def skill(name: str, seed: int, *nodes: str) -> Skill:
        graph = chain(actions, *nodes)
        values = torch.randn(graph.parameters.shape, generator=seeded(seed)) / 2
        for i, node in enumerate(nodes):
            values[:, i, actions.actions[actions.index(node)].num_parameters :] = 0
        return Skill(name, replace(graph, parameters=values), actions, 9)

    inner = skill("S0", 1, "RecurrentNN", "MoveBase", "Visits", "Smaller", "MoveBase")
    actions = actions.extended(["S0"], [SubSkill(inner)])
    return skill(
        "S1",
        2,
        "Visits",
        "RecurrentNN",
        "MoveBase",
        "S0",
        "LinearNN",
        "MoveBase",
        "DelayNN",
        "MoveBase",
        "Smaller",
        "MoveBase",
    )


SKILL = remembering()


Wanted: TypeAlias = tuple[list[Execution], list[list[tuple[Action, int]]]]
"""What the library makes of the skill: executions, and all actions with their outcomes."""


def told(found: list[tuple[Action, int]]) -> list[str]:
    return [type(action).__name__ for action, _ in found]


@pytest.fixture(scope="module")
def wanted() -> Wanted:
    runs, actions = by_the_library(SKILL, PLACE)
    assert sum(told(each).count("RecurrentNN") >= 6 for each in actions) >= 4
    controls = torch.stack([control for run in runs for control in run.controls])
    assert controls.std(0).min() > 0.05
    return runs, actions


def drives(step: Step, about: dict[str, Any], runs: list[Execution], within: float) -> None:
    for scenario, run in enumerate(runs):
        assert_same(by_steps(step, about, PLACE, scenario), run, within)


@pytest.mark.hostile
def test_step_module_and_onnx(wanted: Wanted) -> None:
    runs, _ = wanted
    step = SkillStep(SKILL)
    assert step.memory_size == 2 + 3 + 14 + 2
    drives(step, step.about(), runs, 0.0)
    extra = {ABOUT: ""}
    program = torch.export.load(io.BytesIO(to_module(SKILL)), extra_files=extra)
    drives(program.module(), json.loads(extra[ABOUT]), runs, 1e-5)
    drives(*runtime(to_onnx(SKILL)), runs, 1e-5)


def test_the_state_is_in_the_mind() -> None:
    """Without it the same percept, at the same place, gives another control."""
    step = SkillStep(SKILL)
    _, outcome, place, mind = step.first()
    percept = PLACE.percepts[0]
    _, _, place, mind = step(percept, outcome, place, mind)
    forgotten = mind.clone()
    forgotten[step.message_size + 1 :] = 0
    assert not torch.equal(mind, forgotten)
    controls = [step(percept, outcome, place, each)[1] for each in (mind, forgotten)]
    assert (controls[0] - controls[1]).abs().max() > 1e-3


def test_a_state_machine_has_it_as_plain_python(tmp_path: Path, wanted: Wanted) -> None:
    runs, actions = wanted
    text = to_state_machine(SKILL)
    module = imported(text, tmp_path)
    assert text.decode().count("inputs=7, hidden=3, outputs=3, memory=range(") == 2
    assert text.decode().count("inputs=7, hidden=2, outputs=3, memory=range(") == 2
    for scenario, run in enumerate(runs):
        states, controls = filled_in(module, PLACE, scenario), list[Tensor]()

        class Drive(states["MoveBase"]):  # type: ignore[misc]
            def step(self, userdata: Any, *motion: float, to: list[Tensor] = controls) -> bool:
                to.append(torch.tensor(motion))
                return bool(super().step(userdata, *motion))

        class Visit(module.Visits):  # type: ignore[name-defined, misc]
            def execute(self, userdata: Any) -> str:
                userdata.memory[self.memory[0]] += 1
                userdata.message[3] += self.parameters[0]
                if userdata.percept[4] > 1.2 + abs(self.parameters[1]):
                    return "lost"
                count = userdata.memory[self.memory[0]] + userdata.message[3]
                return "enough" if count > 3 else "again"

        userdata = module.Userdata(PLACE.percepts[scenario].tolist(), [0.0] * 4, memory=[0.0] * 21)
        machine = module.build({**states, "MoveBase": Drive, "Visits": Visit})
        assert machine.execute(userdata) == run.end
        assert userdata.steps == len(actions[scenario])
        sent = zip(run.controls, run.routines, strict=True)
        moves = [control for control, routine in sent if routine == "control"]
        torch.testing.assert_close(torch.stack(controls), torch.stack(moves), atol=1e-5, rtol=0)


def test_it_is_drawn() -> None:
    for draw in (to_dot, to_graphml, to_mermaid):
        assert draw(SKILL).count(b"RecurrentNN_") == 2
    assert draw_skill(SKILL).axes
