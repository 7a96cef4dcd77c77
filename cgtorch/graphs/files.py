"""Skill files: a skill as JSON, with all skills in it under "skills" and its "actions".

The library's actions are made again from class and arguments when a file is read. Others have to be
given, as a file never names code to import.
"""

import inspect
import math
import re
import reprlib
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import networkx as nx

from cgtorch.graphs.action import Action
from cgtorch.graphs.action_set import AN_ACTION_SET, ActionSet
from cgtorch.graphs.graphs import check_graph
from cgtorch.graphs.skill import MOST_TRANSITIONS, Skill, SubSkill, a_skill
from cgtorch.graphs.view import View, from_networkx, to_networkx
from cgtorch.ground.errors import ActionError, GraphError
from cgtorch.ground.files import read_json, write_json
from cgtorch.ground.given import given_path, of_kind
from cgtorch.ground.replacing import SO_FAR, check_no_part

FORMAT, VERSION = "cgtorch-skill", 2
MAX_BYTES = 32 * 2**20
MAX_NODES = 10_000
MAX_DEPTH = 32
LONGEST = 1000  # characters of a name, as it is printed
LIBRARY = "cgtorch."
"""The modules from which the class of an action in a file is imported."""
LARGEST = 2**20  # parameters, or numbers of a message or memory

_SKILL = {"name": str, "max_transitions": int, "start": str, "nodes": list, "edges": list}
_FILE = {"format": str, "version": int, **_SKILL, "actions": dict, "skills": dict}
_ACTION = {"class": str, "arguments": dict}
_NODE = {"name": str, "action": str, "parameters": list}
_EDGE = {"tail": str, "head": str, "outcome": str}
_KIND = {str: "text", int: "a whole number", list: "a list", dict: "an object"}


def save_skill(path: Path | str, skill: Skill) -> None:
    """Write a skill file, completely or not at all; RunError if it cannot be written.

    That is also so if it would replace a file of a run. SettingsError for what is no path or no
    skill.
    """
    data = skill_to_dict(a_skill(skill))
    check_no_part(output := given_path(path), but=SO_FAR)
    write_json(output, data)


def load_skill(path: Path | str, actions: ActionSet | None = None) -> Skill:
    """Read a skill file exactly as it was saved; nodes may use these actions and its sub-skills.

    Without `actions` they are those that the file names, which have to be the library's. GraphError
    if it cannot be read or contains no skill, ActionError for an unknown action, SettingsError for
    what is no path or no actions.
    """
    if actions is not None:
        of_kind(actions, ActionSet, "actions", AN_ACTION_SET)
    data = read_json(path, MAX_BYTES, GraphError)
    try:
        return skill_from_dict(data, actions)
    except (GraphError, ActionError) as e:
        raise type(e)(f"in {str(path)!r}, {e}") from e


def skill_to_dict(skill: Skill) -> dict[str, Any]:
    """A skill as the plain data of a skill file."""
    entries: dict[str, Any] = {}
    described = _describe(skill, entries, {})
    used = {
        name: described_action(action)
        for level in skill.levels
        for name, action in sorted(level.node_actions.items())
        if not isinstance(action, SubSkill)
    }
    about = {"format": FORMAT, "version": VERSION, **described}
    return {**about, "actions": used, "skills": entries}


def _describe(skill: Skill, entries: dict[str, Any], keys: dict[int, str]) -> dict[str, Any]:
    """The data of one skill; nested ones are added to `entries`, and their keys to `keys`."""
    key_of = {name: name for name in skill.actions.names}
    for name, sub in skill.sub_skills.items():
        if id(sub) not in keys:
            described = _describe(sub, entries, keys)
            key, count = name, 1
            # Another skill of the same name may be in use at another level.
            while entries.setdefault(key, described) != described:
                count += 1
                key = f"{name}_{count}"
            keys[id(sub)] = key
        key_of[name] = keys[id(sub)]
    view = to_networkx(skill.graph, skill.actions)
    label = {node: f"{key_of[data['action']]}_{node}" for node, data in view.nodes(data=True)}
    return {
        "name": skill.name,
        "max_transitions": skill.max_transitions,
        "start": label[view.graph["start"]],
        "nodes": [
            {"name": label[n], "action": key_of[d["action"]], "parameters": d["parameters"]}
            for n, d in view.nodes(data=True)
        ],
        "edges": [
            {"tail": label[tail], "head": label[head], "outcome": data["outcome"]}
            for tail, head, data in view.edges(data=True)
        ],
    }


def skill_from_dict(data: object, actions: ActionSet | None = None) -> Skill:
    """A skill from the plain data of a skill file; see `load_skill`."""
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, Mapping) else data
        raise GraphError(
            f"not a skill file: format is {_short(found)}, not {FORMAT!r}; give a file that "
            "save_skill or cgtorch-export wrote"
        )
    if data.get("version") != VERSION or isinstance(data["version"], bool):
        raise GraphError(
            f"skill file of version {_short(data.get('version'))}, this cgtorch reads {VERSION}; "
            "use the version that wrote it"
        )
    _check_keys(data, _FILE, "the skill file")
    entries: Mapping[str, object] = data["skills"]
    if actions is None:
        for name, about in data["actions"].items():
            _check_keys(about, _ACTION, f"action {_short(name)}")
        made = {name: made_action(name, about) for name, about in data["actions"].items()}
        actions = ActionSet(tuple(made), tuple(made.values()))
    if taken := sorted(set(entries) & set(actions.names)):
        raise GraphError(f"sub-skill {_short(taken[0])} has the name of an action; rename it")
    known: dict[str, SubSkill] = {}
    skill = _read(data, _SKILL | _FILE, "the skill", entries, actions, known, ())
    if unused := [key for key in entries if key not in known]:
        raise GraphError(f"sub-skill {_short(unused[0])} is used by no node; remove it")
    return skill


def _read(
    data: object,
    keys: Mapping[str, type],
    what: str,
    entries: Mapping[str, object],
    actions: ActionSet,
    known: dict[str, SubSkill],
    path: tuple[str, ...],
) -> Skill:
    """One skill of a file; nested ones are read first, once, into `known`."""
    skill = _check_keys(data, keys, what)
    nodes = [_check_keys(n, _NODE, f"node {i} of {what}") for i, n in enumerate(skill["nodes"])]
    edges = [_check_keys(e, _EDGE, f"edge {i} of {what}") for i, e in enumerate(skill["edges"])]
    if len(nodes) > MAX_NODES:
        raise GraphError(f"{what} has {len(nodes)} nodes; at most {MAX_NODES} can be read")
    if not 1 <= (limit := skill["max_transitions"]) <= MOST_TRANSITIONS:
        raise GraphError(
            f"{what} has max_transitions {_short(limit)}; give 1 to {MOST_TRANSITIONS}"
        )
    used = [key for key in dict.fromkeys(n["action"] for n in nodes) if key in entries]
    for key in used:
        if key in path:
            raise GraphError(f"sub-skill {_short(key)} contains itself; remove the cycle")
        if len(path) >= MAX_DEPTH:
            raise GraphError(f"sub-skills are nested deeper than {MAX_DEPTH}; use fewer levels")
        if key not in known:
            name = f"sub-skill {_short(key)}"
            inner = _read(entries[key], _SKILL, name, entries, actions, known, (*path, key))
            known[key] = SubSkill(inner)
    actions = actions.extended(used, [known[key] for key in used])
    graph = from_networkx(_view(skill["start"], nodes, edges, what), actions)
    check_graph(graph, actions, [n["name"] for n in nodes])
    return Skill(skill["name"], graph, actions, skill["max_transitions"])


def _view(start: str, nodes: list[Any], edges: list[Any], what: str) -> View:
    """The multigraph of nodes and edges, by the nodes' names."""
    view: View = nx.MultiDiGraph(start=start)
    for node in nodes:
        if node["name"] in view:
            raise GraphError(f"{what} has two nodes {_short(node['name'])}; names must be unique")
        view.add_node(node["name"], action=node["action"], parameters=node["parameters"])
    for edge in edges:
        for end in ("tail", "head"):
            if edge[end] not in view:
                raise GraphError(
                    f"{what} has an edge with {end} {_short(edge[end])}, which is none of its nodes"
                )
        view.add_edge(edge["tail"], edge["head"], outcome=edge["outcome"])
    return view


def _check_keys(data: object, keys: Mapping[str, type], what: str) -> Mapping[str, Any]:
    """`data`, if it is an object with exactly these keys, each with a value of its type."""
    if not isinstance(data, Mapping):
        raise GraphError(f"{what} is {_short(data)}; give an object with {', '.join(keys)}")
    if missing := [key for key in keys if key not in data]:
        raise GraphError(f"{what} has no {missing[0]!r}; it needs {', '.join(keys)}")
    if unknown := [key for key in data if key not in keys]:
        raise GraphError(f"{what} has unknown key {_short(unknown[0])}; known: {', '.join(keys)}")
    for key, kind in keys.items():
        if not isinstance(data[key], kind) or isinstance(data[key], bool):
            raise GraphError(f"{what} has {key} {_short(data[key])}; give {_KIND[kind]}")
        if kind is str and len(data[key]) > LONGEST:
            said = f"{_short(data[key])} of {len(data[key])} characters"
            raise GraphError(f"{what} has {key} {said}; give at most {LONGEST}")
    return data


def described_action(action: Action) -> dict[str, Any]:
    """The class of an action, and the arguments that it has as attributes."""
    kind = type(action)
    names = inspect.signature(kind).parameters
    found = {name: getattr(action, name) for name in names if hasattr(action, name)}
    plain = {name: value for name, value in found.items() if _is_plain(value)}
    return {"class": f"{kind.__module__}:{kind.__qualname__}", "arguments": plain}


def _is_plain(value: object) -> bool:
    """Whether a value is a finite number, a text, or a tuple of such, as JSON can hold them."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    if isinstance(value, float):
        return math.isfinite(value)
    return isinstance(value, bool | int | str)


def made_action(name: str, about: Mapping[str, Any]) -> Action:
    """One of the library's actions; ActionError if it is not one, or cannot be made like that."""
    spec: str = about["class"]
    module, _, kind = spec.partition(":")
    module = re.sub(r"^cgtorch\.graphs\..*", "cgtorch.graphs", module)  # wherever it is in there
    if not module.startswith(LIBRARY):
        raise ActionError(
            f"action {name!r:.80} is {spec!r:.80}, which is code of its own; give the actions of "
            "the skill"
        )
    try:
        found = getattr(import_module(module), kind)
    except (ImportError, AttributeError, ValueError) as e:
        raise ActionError(f"action {name!r:.80} is {spec!r:.80}, which is not there") from e
    if not (isinstance(found, type) and issubclass(found, Action)):
        raise ActionError(f"action {name!r:.80} is {spec!r:.80}, which is no action")
    given = about["arguments"].items()
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in given}
    try:
        made = found(**values)
    except Exception as e:  # whatever arguments of a file may cause
        raise ActionError(f"action {name!r:.80} cannot be made with {values!r:.80}") from e
    sizes = made.num_parameters, made.message_size, made.memory_size
    if not all(type(size) is int and 0 <= size <= LARGEST for size in sizes):
        raise ActionError(f"action {name!r:.80} cannot be made with {values!r:.80}")
    return made


_short = reprlib.repr
