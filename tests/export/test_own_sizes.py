"""Exported skills of domains and networks that are not the paper's."""

import json
import math
import zipfile
from io import BytesIO
from pathlib import Path

import pytest
import torch
from driving import assert_same, by_steps, by_the_library
from plain_machines import executed, imported
from support import model, random_skill
from torch import Tensor
from walking import Path as Walk
from walking import chain, path, walking_actions

from cgtorch.export import SkillStep, to_module, to_state_machine
from cgtorch.graphs import Action, ActionSet, ContinuousNN, Skill, Step, SubSkill
from cgtorch.ground.environment import Environment, Lanes
from cgtorch.ground.errors import ActionError
from cgtorch.simulation import most_steps
from cgtorch.tabletop.actions import Detect, paper_actions

SQUASHING = '''"""What squashes, in plain Python."""

import math

from cgtorch.export.plain import ContinuousNN


class Squashed(ContinuousNN):
    """Sends no more than 1."""

    def motion(self, percept: list[float]) -> list[float]:
        """What is sent."""
        return [squashed(y) for y in self.output(percept)]


def squashed(y: float) -> float:
    """The hyperbolic tangent."""
    return math.tanh(y)
'''


class Squashed(ContinuousNN):
    """A network of one's own, with the same class in a module of one's own."""

    plain_module = "squashing"

    def forward(
        self, lanes: Lanes, parameters: Tensor, environment: Environment
    ) -> tuple[Lanes, Tensor]:
        after, outcome = super().forward(lanes, parameters, environment)
        after.message[:, :1] = after.message[:, :1].tanh()
        return after, outcome


class Derived(Squashed):
    """Another class, of which the module knows nothing."""


@pytest.fixture
def squashing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the path with the module."""
    (tmp_path / "squashing.py").write_text(SQUASHING)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def own_actions(network: ContinuousNN) -> ActionSet:
    names, actions = walking_actions().names, walking_actions().actions
    return ActionSet(names, (network, *actions[1:]))


def named(actions: ActionSet, told: list[tuple[Action, int]]) -> list[tuple[str, str]]:
    """Actions and outcomes by their names."""
    names = dict(zip(map(id, actions.actions), actions.names, strict=True))
    return [(names[id(action)], action.outcomes[out]) for action, out in told]


def test_a_network_of_ones_own_is_in_the_file_as_plain_python(
    squashing: Path, caplog: pytest.LogCaptureFixture
) -> None:
    actions = own_actions(Squashed(2, outputs=1))
    skill = Skill("walk", chain(actions, "Aim", "Step", "Branch", speed=1.5), actions)
    place = Walk(path(0, 6).scenarios)
    module = imported(to_state_machine(skill), squashing)
    assert "class Squashed(ContinuousNN):" in (squashing / "skill.py").read_text()
    assert "def squashed(y: float)" in (squashing / "skill.py").read_text()
    assert module.squashed(1.5) == math.tanh(1.5)
    runs, told = by_the_library(skill, place)
    for scenario, run in enumerate(runs):
        wanted = named(actions, told[scenario])
        assert executed(module, place, scenario, caplog) == (wanted, run.end)


def test_another_class_than_the_module_s_is_to_be_filled_in(squashing: Path) -> None:
    actions = own_actions(Derived(2, outputs=1))
    skill = Skill("walk", chain(actions, "Aim", "Step"), actions)
    module = imported(to_state_machine(skill), squashing)
    with pytest.raises(NotImplementedError, match=r"Aim\.execute is to be filled in"):
        module.run([0.0, 0.0])


@pytest.mark.parametrize(
    "name", ["nowhere", "nowhere.at_all", "math.nothing", "sys", ".", "cgtorch..x"]
)
def test_a_module_that_is_none_is_one_error(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Squashed, "plain_module", name)
    actions = own_actions(Squashed(2, outputs=1))
    skill = Skill("walk", chain(actions, "Aim", "Step"), actions)
    with pytest.raises(ActionError, match="is no module of a file; name one, or none"):
        to_state_machine(skill)


def test_controls_are_as_long_as_the_skill_s(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    actions = walking_actions()
    place = Walk(path(3, 6).scenarios)
    for seed in range(4):
        skill = random_skill(seed, f"walk {seed}", actions)
        runs, told = by_the_library(skill, place)
        step = SkillStep(skill)
        assert (step.percept_size, step.control_size) == (2, 1)
        module = imported(to_state_machine(skill), tmp_path, f"skill_{seed}")
        assert module.Step.control_size == 1
        for scenario, run in enumerate(runs):
            assert_same(by_steps(step, step.about(), place, scenario), run, 1e-6)
            wanted = named(actions, told[scenario]), run.end
            assert executed(module, place, scenario, caplog) == wanted
    with zipfile.ZipFile(BytesIO(to_module(skill))) as archive:
        (about,) = [n for n in archive.namelist() if n.endswith("skill.json")]
        assert json.loads(archive.read(about))["control"] == 1


class Restless(Detect):
    """Does nothing, but could do something else next time."""

    deterministic: bool = False


def test_a_control_is_as_long_where_only_an_inner_skill_asks_for_one() -> None:
    actions = ActionSet(("Aim", "Step"), (ContinuousNN(2, outputs=2), Step(1)))
    inner = Skill("inner", chain(actions, "Aim", "Step"), actions, max_transitions=9)
    outer = ActionSet(["inner"], [SubSkill(inner)])
    assert outer.message_size == 2
    step = SkillStep(Skill("outer", chain(outer, "inner"), outer, max_transitions=9))
    assert step.control_size == 1


def test_as_many_actions_as_in_the_library(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """More than 400 where the limits of a skill allow more."""
    base = paper_actions()
    inner = Skill("inner", chain(base, "Detect"), base, max_transitions=45)
    actions = base.extended(["inner"], [SubSkill(inner)])
    skill = Skill("S", chain(actions, "inner", "Detect"), actions, max_transitions=30)
    assert most_steps(actions, 30) == 45 * 30
    place = model(0, 1)
    (run,), _ = by_the_library(skill, place, most_steps(actions, 30))
    assert run.steps == 15 * 45 + 15
    step = SkillStep(skill, percept_size=7)
    assert step.max_steps == 45 * 30
    assert_same(by_steps(step, step.about(), place, 0), run)
    found, end = executed(imported(to_state_machine(skill), tmp_path), place, 0, caplog)
    assert (len(found), end) == (run.steps, "timeout")
    assert torch.equal(run.percepts[0], place.percepts[0])
