"""The texts of a small skill, written down by hand."""

from pathlib import Path
from types import ModuleType
from typing import Any

import jinja2
import pytest
from plain_machines import imported
from support import Visits
from walking import chain, walking_actions

from cgtorch.export import to_json, to_mermaid, to_state_machine
from cgtorch.export.text import filled
from cgtorch.graphs import Action, ActionSet, ContinuousNN, Perceive, Skill, SubSkill, save_skill
from cgtorch.ground.environment import Environment, Lanes

MERMAID = """\
flowchart TD
  subgraph s0["go"]
    s0_n0[["walk_0"]]:::start
    s0_n1["Step_1"]
    s0_success(["success"]):::success
    s0_n0 -->|"failure"| s0_n1
    s0_n1 -->|"success"| s0_n0
    s0_n1 -->|"failure"| s0_n0
    s0_n0 -->|"success"| s0_success
  end
  subgraph s1["walk"]
    s1_n0["Aim_0"]:::start
    s1_n1["Test_1"]
    s1_success(["success"]):::success
    s1_n0 -->|"success"| s1_n1
    s1_n1 -->|"failure"| s1_n0
    s1_n1 -->|"success"| s1_success
  end
  s0_n0 -.-> s1
  classDef start fill:#d62728,color:#ffffff,stroke:#1c1f24
  classDef success fill:#1a7f37,color:#ffffff,stroke:none
  classDef failure fill:#8c2f39,color:#ffffff,stroke:none
"""
BUILD = """\
    use: dict[str, type[State]] = {"Step": Step, "Test": Test}
    use.update(states or {})

    s0 = StateMachine('go', start='walk_0', max_transitions=4, max_steps=400)
    s1 = StateMachine('walk', start='Aim_0', max_transitions=3, max_steps=400)

    s0.add('walk_0', s1, {'success': 'success', 'failure': 'Step_1'})
    s0.add('Step_1', use["Step"](), {'success': 'walk_0', 'failure': 'walk_0'})

    s1.add('Aim_0', ContinuousNN([
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5,
    ], inputs=2, hidden=3, outputs=1), {'success': 'Test_1'})
    s1.add('Test_1', use["Test"](), {'success': 'success', 'failure': 'Aim_0'})

    return s0


def run(percept: Sequence[float], states: Mapping[str, type[State]] | None = None) -> str:
    \"\"\"Run the skill from what the robot perceives now: success, failure or timeout.\"\"\"
    userdata = Userdata(list(percept), [0.0] * 1, memory=[0.0] * 0)
    return build(states).execute(userdata)
"""


def nested() -> Skill:
    """A skill that runs another one and makes a step where that fails."""
    actions = walking_actions()
    walk = Skill("inner", chain(actions, "Aim", "Test", speed=1.5), actions, 3)
    actions = actions.extended(["walk"], [SubSkill(walk)])
    return Skill("go", chain(actions, "walk", "Step"), actions, 4)


def test_a_flowchart_to_the_letter() -> None:
    assert to_mermaid(nested()).decode() == MERMAID


def test_a_state_machine_to_the_letter() -> None:
    assert to_state_machine(nested()).decode().endswith(BUILD)


def test_a_skill_file_is_the_one_that_is_saved(tmp_path: Path) -> None:
    save_skill(tmp_path / "skill.json", nested())
    assert to_json(nested()) == (tmp_path / "skill.json").read_bytes()


def test_a_template_gets_all_that_it_names() -> None:
    assert filled("skill.mermaid.jinja", clusters=[], callers=[]).startswith(b"flowchart TD\n")
    with pytest.raises(jinja2.UndefinedError, match="'callers' is undefined"):
        filled("skill.mermaid.jinja", clusters=[])


class Settles(Action):
    num_parameters = 1

    def forward(self, lanes: Lanes, parameters: Any, environment: Environment) -> Any:
        return lanes, lanes.step * 0


def with_actions(**more: Action) -> Skill:
    """A skill whose nodes have these actions, in turn."""
    actions = ActionSet(("Perceive", *more), (Perceive(), *more.values()))
    return Skill("S", chain(actions, "Perceive", *more), actions)


def machine(folder: Path, **more: Action) -> ModuleType:
    """The state machine of the same."""
    return imported(to_state_machine(with_actions(**more)), folder)


class Silent(Settles):
    num_parameters = 0


def test_an_action_s_parameters_are_counted_in_words(tmp_path: Path) -> None:
    module = machine(tmp_path, one=Settles(), none=Silent(), two=Visits())
    assert module.one.__doc__ == "It has 1 parameter, in `self.parameters`."
    assert module.none.__doc__ == "It has 0 parameters, in `self.parameters`."
    said = "Counts, too, but never ends a skill. It has 2 parameters, in `self.parameters`."
    assert module.two.__doc__ == said


def test_long_names_are_cut_and_stay_different(tmp_path: Path) -> None:
    module = machine(tmp_path, **{"x" * 41: Settles(), "x" * 42: Silent(), "State": Settles()})
    names = "x" * 40, f"{'x' * 40}_2", "State_2"
    assert [getattr(module, name).name for name in names] == ["x" * 41, "x" * 42, "State"]
    assert [type(state).__name__ for state in module.build().states.values()][1:] == list(names)


def test_numbers_of_a_network_are_in_lines_of_a_hundred_characters() -> None:
    """Of 18 numbers among which four have a digit more, a line would have 101."""
    actions = ActionSet(("Net",), (ContinuousNN(9, 9, 9),))
    graph = chain(actions, "Net")
    graph.parameters[0, 0, :4] = 10
    lines = to_state_machine(Skill("S", graph, actions)).decode().splitlines()
    numbers = [line for line in lines if set(line) <= set(" 01.,") and "0" in line]
    assert max(map(len, lines)) <= 100
    assert numbers[0] == " " * 8 + "10.0, " * 4 + "0.0, " * 12 + "0.0,"
    assert set(numbers[1:-1]) == {" " * 8 + "0.0, " * 17 + "0.0,"}
