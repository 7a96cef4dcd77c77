"""A skill as a state machine: one Python file that needs nothing but Python.

It reads like one for SMACH or YASMIN. The library's networks are in it; MoveBase, Detect, Grasp
and actions of someone's own are classes to fill in.
"""

import ast
import builtins
import itertools
import keyword
import re
from importlib.util import find_spec
from pathlib import Path
from textwrap import fill, indent

from cgtorch.actions import Action, Detect, Grasp, MoveBase
from cgtorch.actions.memory import memory_parts
from cgtorch.export.clusters import numbered
from cgtorch.export.computed import control_size_of, named_primitives
from cgtorch.graphs import Skill, SubSkill, to_networkx
from cgtorch.ground.errors import ActionError
from cgtorch.simulation import most_steps

PLAIN = Path(__file__).with_name("plain")
ROUTINES = (MoveBase, Detect, Grasp)
BASE = "cgtorch.export.plain.networks"
"""Has what the plain classes of other modules stand on."""

HEADER = '''\
"""A robot skill as a state machine. Needs Python 3.10 or later and nothing else.

Fill in the classes under "To fill in", here or in subclasses of your own that you give to `build`:

    from skill import MoveBase, run
    class Drive(MoveBase):
        def move(self, userdata, dx, dy, dtheta): ...
    print(run(percept, {"MoveBase": Drive, ...}))  # success, failure or timeout

`logging.getLogger("skill")` tells every action at level DEBUG. Written by cgtorch-export.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

'''

RUN = '''
def run(percept: Sequence[float], states: Mapping[str, type[State]] | None = None) -> str:
    """Run the skill from what the robot perceives now: success, failure or timeout."""
    userdata = Userdata(list(percept), [0.0] * {message}, memory=[0.0] * {memory})
    return build(states).execute(userdata)
'''


def to_state_machine(skill: Skill) -> bytes:
    """The skill as the text of a Python module with `build` and `run`.

    Whatever the names in it are, they stand in quotes: nothing of a skill becomes code.
    """
    classes = _classes(skill)
    primitives = list(named_primitives(skill))
    memory, memory_size = memory_parts([action for _, action in primitives])
    own = {
        classes[id(action)]: _to_fill_in(classes[id(action)], name, action, part)
        for (name, action), part in zip(primitives, memory, strict=True)
        if type(action) not in ROUTINES and not _plain(action)
    }
    fill_in = [*(routine.__name__ for routine in ROUTINES), *own]
    modules = dict.fromkeys([BASE, *filter(None, (_plain(action) for _, action in primitives))])
    message_size = max(one.actions.message_size for _, one in numbered(skill))
    parts = [
        HEADER,
        _body("machine.py"),
        _title("To fill in"),
        _routines(control_size_of(skill)),
        *own.values(),
        _title("Networks"),
        *(_text_after_imports(_source(module)) for module in modules),
        _title("The skill"),
        _build(skill, classes, fill_in),
        RUN.format(message=message_size, memory=memory_size),
    ]
    return ("\n\n\n".join(part.strip("\n") for part in parts) + "\n").encode()


def _plain(action: Action) -> str:
    """The module that has the action's own class in plain Python, "" if none has."""
    return str(vars(type(action)).get("plain_module", ""))


def _source(module: str) -> str:
    """The text of a module, which is not run."""
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):  # of a folder that is none, or of no name at all
        spec = None
    if spec is None or not spec.has_location or spec.origin is None:
        raise ActionError(f"plain_module {module!r} is no module of a file; name one, or none")
    return Path(spec.origin).read_text()


def _body(file: str) -> str:
    """What a file of this folder has after its docstring and imports."""
    return _text_after_imports((PLAIN / file).read_text())


def _routines(control_size: int) -> str:
    """The classes of routines, for controls of so many numbers."""
    return _body("routines.py").replace("control_size = 3", f"control_size = {control_size}")


def _text_after_imports(text: str) -> str:
    imports = (ast.Import, ast.ImportFrom)
    *_, last = (node for node in ast.parse(text).body if isinstance(node, imports))
    return "\n".join(text.splitlines()[last.end_lineno :])


def _title(text: str) -> str:
    return f"# {text} {'-' * (97 - len(text))}"


def _classes(skill: Skill) -> dict[int, str]:
    """The class of every action by its identity; names of one's own made into unique ones."""
    modules = {_plain(action) for _, action in named_primitives(skill)} - {""}
    texts = [file.read_text() for file in PLAIN.glob("*.py")] + [_source(m) for m in modules]
    pattern = re.compile(r"^(?:class |def )?(\w+)", re.MULTILINE)
    taken = {name for text in texts for name in pattern.findall(text)}
    classes: dict[int, str] = {}
    for name, action in named_primitives(skill):
        if type(action) in ROUTINES or _plain(action):
            classes[id(action)] = type(action).__name__
            continue
        base = re.sub(r"\W", "_", name, flags=re.ASCII)[:40]
        base = base if base.isidentifier() and not keyword.iskeyword(base) else f"Action_{base}"
        tries = (base if i == 1 else f"{base}_{i}" for i in itertools.count(1))
        classes[id(action)] = next(t for t in tries if t not in taken and not hasattr(builtins, t))
        taken.add(classes[id(action)])
    return classes


def _to_fill_in(class_name: str, name: str, action: Action, part: slice) -> str:
    """The class of an action that the library does not know."""
    return f"""class {class_name}(State):
    \"\"\"An action with {action.num_parameters} parameters, in `self.parameters`.\"\"\"

    name = {name!a}
    outcomes = {tuple(action.outcomes)!a}
    memory = {range(part.start, part.stop)!r}  # its own places in `userdata.memory`

    def execute(self, userdata: Userdata) -> str:
        \"\"\"Do it, and return one of `outcomes`.\"\"\"
        raise NotImplementedError("{class_name}.execute is to be filled in")"""


def _build(skill: Skill, classes: dict[int, str], fill_in: list[str]) -> str:
    """The function that makes all machines, then puts their states into them."""
    skills = numbered(skill)
    variable = {id(one): f"s{number}" for number, (_, one) in enumerate(skills)}
    known = ", ".join(f'"{name}": {name}' for name in fill_in)
    lines = [
        "def build(states: Mapping[str, type[State]] | None = None) -> StateMachine:",
        '    """The skill; `states` are your own classes by the names of those they stand for."""',
        f"    use: dict[str, type[State]] = {{{known}}}",
        "    use.update(states or {})",
        "",
        *(_machine(variable[id(one)], name, one) for name, one in skills),
    ]
    for _, one in skills:
        lines += ["", *_additions(one, variable, classes)]
    return "\n".join([*lines, "", "    return s0"])


def _machine(variable: str, name: str, skill: Skill) -> str:
    """The line that makes one machine."""
    view = to_networkx(skill.graph, skill.actions)
    start = view.nodes[view.graph["start"]]["label"]
    steps = most_steps(skill.actions, skill.max_transitions)
    limits = f"max_transitions={skill.max_transitions}, max_steps={steps}"
    return f"    {variable} = StateMachine({name!a}, start={start!a}, {limits})"


def _additions(skill: Skill, variable: dict[int, str], classes: dict[int, str]) -> list[str]:
    """The lines that put the states into one machine."""
    view = to_networkx(skill.graph, skill.actions)
    label = {node: data["label"] for node, data in view.nodes(data=True)}
    lines = []
    for node, data in view.nodes(data=True):
        action = skill.actions.actions[skill.actions.index(data["action"])]
        leads = {o: "success" if good else "failure" for o, good in action.terminal.items()}
        for _, head, edge in view.out_edges(node, data=True):
            leads[edge["outcome"]] = label[head]
        leads = {outcome: leads[outcome] for outcome in action.outcomes}
        state = _state(action, data["parameters"], variable, classes)
        lines.append(f"    {variable[id(skill)]}.add({label[node]!a}, {state}, {leads!a})")
    return lines


def _state(
    action: Action, parameters: list[float], variable: dict[int, str], classes: dict[int, str]
) -> str:
    """The expression that makes a state."""
    if isinstance(action, SubSkill):
        return variable[id(action.skill)]
    values = fill(", ".join(map(repr, parameters)), 92)
    values = f"[\n{indent(values, ' ' * 8)},\n    ]" if parameters else "[]"
    name = classes[id(action)]
    if _plain(action):
        sizes = f"inputs={action.inputs}, hidden={action.hidden}, outputs={action.outputs}"
        return f"{name}({values}, {sizes})"
    return f'use["{name}"]({values if parameters else ""})'
