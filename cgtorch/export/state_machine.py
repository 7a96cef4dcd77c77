"""A skill as a state machine: one Python file that needs nothing but Python.

It is similar to files for SMACH or YASMIN. The library's networks are included. Actions that ask
the robot, and user-defined ones, are classes to fill in.
"""

import ast
import builtins
import itertools
import keyword
import re
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from textwrap import fill, indent

from cgtorch.export.step import control_size_of
from cgtorch.export.text import filled
from cgtorch.graphs import Action, Skill
from cgtorch.graphs.action import memory_parts, own
from cgtorch.graphs.clusters import Cluster, Node, clusters_of
from cgtorch.graphs.skill import a_skill
from cgtorch.ground.errors import ActionError
from cgtorch.simulation import most_steps

PLAIN = "cgtorch.export.plain"
"""The module with what the plain classes of other modules stand on."""
SIZES = "inputs", "hidden", "delays", "outputs"
"""The constructor arguments of plain networks, as far as an action has them."""


def to_state_machine(skill: Skill) -> bytes:
    """The skill as the text of a Python module with `build` and `run`.

    All names are written as quoted strings, so nothing in a skill becomes code.
    """
    clusters, primitives = clusters_of(a_skill(skill)), skill.primitives
    plain = {id(action): own(action, "plain_module") for _, action in primitives}
    asks = [action for _, action in primitives if own(action, "request")]
    texts = {name: _source(name) for name in dict.fromkeys([PLAIN, *plain.values()]) if name}
    classes = _classes(primitives, texts.values())
    places, memory_size = memory_places([action for _, action in primitives])
    mine = [
        {"class": classes[id(action)], "name": name, "action": action,
         "memory": places[id(action)], "about": _about(action)}
        for name, action in primitives
        if not plain[id(action)]
    ]  # fmt: skip
    asking = [classes[id(action)] for action in asks]
    size = f"control_size = {control_size_of(skill)}"
    return filled(
        "state_machine.py.jinja",
        modules=[_after_imports(text).replace("control_size = 1", size) for text in texts.values()],
        own=mine,
        clusters=clusters,
        asking=asking,
        fill_in=[*asking, *(state["class"] for state in mine)],
        message_size=skill.actions.message_size,
        memory_size=memory_size,
        most_steps=most_steps(skill.actions, skill.max_transitions),
        state_of=lambda node: _state(node, classes, places),
        leads=leads_of,
    )


def memory_places(actions: Sequence[Action]) -> tuple[dict[int, range], int]:
    """The places in the common memory by an action's identity, and the memory's length."""
    parts, size = memory_parts(actions)
    pairs = zip(actions, parts, strict=True)
    return {id(action): range(part.start, part.stop) for action, part in pairs}, size


def plain_arguments(action: Action, memory: range) -> dict[str, object]:
    """The arguments of an action's plain class besides the parameters."""
    sizes = {name: getattr(action, name) for name in SIZES if hasattr(action, name)}
    return {**sizes, **({"memory": memory} if memory else {}), **action.plain_arguments}


def leads_of(cluster: Cluster, node: Node) -> dict[str, str]:
    """Where each outcome of a node leads: a label, success or failure."""
    label = {key: one.label for key, one in cluster.nodes.items()}
    label |= {key: "success" if good else "failure" for key, good in cluster.ends.items()}
    leads = {edge.outcome: label[edge.head] for edge in cluster.edges if edge.tail == node.key}
    return {outcome: leads[outcome] for outcome in node.action.outcomes}


def _about(action: Action) -> str:
    """The first sentence of an action's docstring, and its number of parameters."""
    said, k = vars(type(action)).get("__doc__") or "", action.num_parameters
    first = " ".join(said.strip().partition("\n\n")[0].split())
    return f"{first} It has {k} parameter{'s' if k != 1 else ''}, in `self.parameters`.".strip()


def _source(module: str) -> str:
    """The text of a module, which is not executed."""
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):  # the module cannot be found
        spec = None
    if spec is None or not spec.has_location or spec.origin is None:
        raise ActionError(f"plain_module {module!r} is no module of a file; name one, or none")
    return Path(spec.origin).read_text()


def _after_imports(text: str) -> str:
    """The text of a module after its docstring and imports."""
    imports = (ast.Import, ast.ImportFrom)
    *_, last = (node for node in ast.parse(text).body if isinstance(node, imports))
    return "\n".join(text.splitlines()[last.end_lineno :]).strip("\n")


def _classes(primitives: Iterable[tuple[str, Action]], texts: Iterable[str]) -> dict[int, str]:
    """The class name of every action by its identity; user-defined names are made unique."""
    pattern = re.compile(r"^(?:class |def )?(\w+)", re.MULTILINE)
    taken = {name for text in texts for name in pattern.findall(text)}
    classes: dict[int, str] = {}
    for name, action in primitives:
        if own(action, "plain_module"):
            classes[id(action)] = type(action).__name__
            continue
        base = re.sub(r"\W", "_", name, flags=re.ASCII)[:40]
        base = base if base.isidentifier() and not keyword.iskeyword(base) else f"Action_{base}"
        tries = (base if i == 1 else f"{base}_{i}" for i in itertools.count(1))
        classes[id(action)] = next(t for t in tries if t not in taken and not hasattr(builtins, t))
        taken.add(classes[id(action)])
    return classes


def _state(node: Node, classes: dict[int, str], places: dict[int, range]) -> str:
    """The expression that makes the state of a node."""
    if node.runs:
        return node.runs
    action, name = node.action, classes[id(node.action)]
    values = fill(", ".join(map(repr, node.parameters)), 92)
    values = f"[\n{indent(values, ' ' * 8)},\n    ]" if node.parameters else ""
    if own(action, "plain_module") and not own(action, "request"):
        arguments = plain_arguments(action, places[id(action)])
        given = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
        return f"{name}({values or '[]'}, {given})"
    return f'use["{name}"]({values})'
