import copy
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    nested_actions,
    random_graphs,
    random_skill,
    same,
    stochastic_actions,
    world,
)
from told_by_runs import tensors_of
from walking import chain, walking_actions

from cgtorch.graphs import (
    ActionSet,
    DelayNN,
    RecurrentNN,
    Skill,
    SubSkill,
    load_skill,
    narrowed,
    save_skill,
    skill_from_dict,
    skill_to_dict,
)
from cgtorch.ground.errors import ActionError, CgtorchError, GraphError, RunError, SettingsError
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.edge_networks import EdgeWayNN, edge_actions

ACTIONS = stochastic_actions()
NESTED = nested_actions(base=ACTIONS)
float32s = st.floats(width=32, allow_nan=False, allow_infinity=False)


def bits(skill: Skill) -> list[bytes]:
    """The parameters of all nodes to the last bit, -0 and all."""
    rows = skill.graph.parameters[0, : skill.num_nodes].tolist()
    counts = skill.actions.num_parameters[skill.graph.action[0, : skill.num_nodes]].tolist()
    return [struct.pack(f"{k}f", *row[:k]) for row, k in zip(rows, counts, strict=True)]


def assert_equal(one: Skill, other: Skill) -> None:
    assert (one.name, one.max_transitions) == (other.name, other.max_transitions)
    assert bits(one) == bits(other)
    assert skill_to_dict(one) == skill_to_dict(other)
    assert set(one.sub_skills) == set(other.sub_skills)
    for name, sub in one.sub_skills.items():
        assert_equal(sub, other.sub_skills[name])


@given(
    st.integers(0, 2**31),
    st.lists(float32s, min_size=36, max_size=36),
    st.text(max_size=8),
    st.integers(1, 1000),
)
def test_round_trip_to_the_last_bit(seed: int, values: list[float], name: str, limit: int) -> None:
    graphs = random_graphs(seed, 1, NESTED)
    row = torch.tensor(values)
    real = torch.arange(36) < NESTED.num_parameters[graphs.action.clamp_min(0)][..., None]
    parameters = torch.where(real & graphs.used[..., None], row, 0.0)
    skill = Skill(name, replace(graphs, parameters=parameters), NESTED, limit)
    # As text, since that is what a file holds.
    again = skill_from_dict(json.loads(json.dumps(skill_to_dict(skill))), ACTIONS)
    assert_equal(skill, again)


def test_a_file_holds_a_skill_that_does_the_same(tmp_path: Path) -> None:
    skill = random_skill(9, "top", NESTED, max_transitions=12)
    assert skill.depth == 3
    save_skill(tmp_path / "skill.json", skill)
    again = load_skill(tmp_path / "skill.json", ACTIONS)
    assert_equal(skill, again)
    one, two = (
        rollout(s.graph, s.actions, world(0, 30), max_transitions=s.max_transitions)
        for s in (skill, again)
    )
    for name, value in tensors_of(one).items():
        assert torch.equal(value, getattr(two, name)), name


def test_a_skill_without_sub_skills_needs_the_primitive_actions_only() -> None:
    skill = random_skill(1, "S0", paper_actions())
    again = skill_from_dict(skill_to_dict(skill), paper_actions())
    assert again.actions.names == paper_actions().names
    assert same(again.graph, narrowed(skill.graph, skill.num_nodes))


def test_a_shared_sub_skill_is_stored_and_made_once() -> None:
    skill = random_skill(9, "top", NESTED)
    data = skill_to_dict(skill)
    assert set(data["skills"]) == {"S0", "S1"}
    again = skill_from_dict(data, ACTIONS)
    assert again.sub_skills["S0"] is again.sub_skills["S1"].sub_skills["S0"]


def test_different_sub_skills_of_one_name_stay_apart() -> None:
    base = paper_actions()
    inner, other = (random_skill(s, "same", base) for s in (0, 1))
    middle_set = base.extended(["same"], [SubSkill(inner)])
    middle = random_skill(2, "middle", middle_set)
    top_set = base.extended(["same", "middle"], [SubSkill(other), SubSkill(middle)])
    top = random_skill(3, "top", top_set)
    data = skill_to_dict(top)
    assert set(data["skills"]) == {"same", "middle", "same_2"}
    again = skill_from_dict(data, base)
    assert skill_to_dict(again) == data
    one, two = (rollout(s.graph, s.actions, world(0, 20)) for s in (top, again))
    assert torch.equal(one.percept, two.percept)
    assert torch.equal(one.transitions, two.transitions)


def test_many_levels_that_share_are_read_quickly() -> None:
    """Each level uses all before it; taken as a tree that is 2^30 skills."""
    actions = base = paper_actions()
    skill = random_skill(0, "S0", base)
    for i in range(30):
        actions = actions.extended([f"S{i}"], [SubSkill(skill)])
        skill = visiting_all(f"S{i + 1}", actions)
    again = skill_from_dict(skill_to_dict(skill), base)
    assert again.depth == skill.depth == 31


def visiting_all(name: str, actions: ActionSet) -> Skill:
    """A skill that visits every sub-skill in turn."""
    return Skill(name, chain(actions, *actions.names[5:]), actions)


GOOD: dict[str, Any] = {
    "format": "cgtorch-skill",
    "version": 2,
    "name": "top",
    "max_transitions": 20,
    "start": "Net",
    "nodes": [
        {"name": "Net", "action": "ContinuousNN", "parameters": [0.5] * 36},
        {"name": "Move", "action": "MoveBase", "parameters": []},
        {"name": "Sub", "action": "S1", "parameters": []},
    ],
    "edges": [
        {"tail": "Net", "head": "Move", "outcome": "success"},
        {"tail": "Move", "head": "Sub", "outcome": "success"},
        {"tail": "Move", "head": "Net", "outcome": "failure"},
        {"tail": "Sub", "head": "Net", "outcome": "failure"},
    ],
    "actions": {},
    "skills": {
        "S1": {
            "name": "S1",
            "max_transitions": 3,
            "start": "Grasp_0",
            "nodes": [{"name": "Grasp_0", "action": "Grasp", "parameters": []}],
            "edges": [{"tail": "Grasp_0", "head": "Grasp_0", "outcome": "failure"}],
        }
    },
}


def setting(*path: Any) -> Callable[[dict[str, Any]], None]:
    """A change that sets (…, key, value) or, with `...` as the value, removes the key."""
    *way, key, value = path

    def change(data: dict[str, Any]) -> None:
        place: Any = data
        for step in way:
            place = place[step]
        if value is ...:
            del place[key]
        elif isinstance(place, list) and key == "append":
            place.append(value)
        else:
            place[key] = value

    return change


LOOP = {**GOOD["skills"]["S1"], "nodes": [{"name": "Grasp_0", "action": "S1", "parameters": []}]}
TWO_LOOPS = {
    "S1": {**LOOP, "nodes": [{"name": "Grasp_0", "action": "S2", "parameters": []}]},
    "S2": LOOP,
}
DEEP = {
    f"S{i}": {**LOOP, "nodes": [{"name": "Grasp_0", "action": f"S{i + 1}", "parameters": []}]}
    for i in range(1, 100)
} | {"S100": GOOD["skills"]["S1"]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            setting("edges", 0, ...),
            r"node 'Net' \(ContinuousNN\) has no edge for outcome 'success'",
        ),
        (setting("edges", "append", GOOD["edges"][0]), "'Net' has two edges for outcome 'success'"),
        (setting("edges", 0, "outcome", "done"), "'Net' → 'Move' has outcome 'done'; known are"),
        (setting("edges", 3, "outcome", "success"), "has outcome 'success', which ends the skill"),
        (setting("edges", 0, "head", "X"), "an edge with head 'X', which is none of its nodes"),
        (setting("edges", 0, "tail", "X"), "an edge with tail 'X', which is none of its nodes"),
        (setting("edges", 0, "tail", ...), "edge 0 of the skill has no 'tail'"),
        (setting("edges", 1, "head", "Net"), "node 'Sub' cannot be reached from the start"),
        (setting("edges", {}), "has edges {}; give a list"),
        (setting("nodes", 0, "action", "Fly"), "unknown action 'Fly'; known are MoveBase"),
        (setting("nodes", 0, "parameters", 3, float("nan")), "'Net' .* has parameter nan; give"),
        (setting("nodes", 0, "parameters", 3, float("inf")), "has parameter inf; give finite"),
        (setting("nodes", 0, "parameters", 3, 1e39), r"has parameter 1e\+39; give finite"),
        (setting("nodes", 0, "parameters", 3, 10**400), "has parameter 1000"),
        (setting("nodes", 0, "parameters", 3, "1"), "has parameter '1'; give finite"),
        (setting("nodes", 0, "parameters", 3, True), "has parameter True; give finite"),
        (setting("nodes", 0, "parameters", 3, None), "has parameter None; give finite"),
        (setting("nodes", 0, "parameters", [0.5] * 35), "has 35 parameters; give 36"),
        (setting("nodes", 1, "parameters", [0.5]), "has 1 parameters; give 0"),
        (setting("nodes", 1, "name", "Net"), "two nodes 'Net'; names must be unique"),
        (setting("nodes", 1, "colour", "red"), "node 1 of the skill has unknown key 'colour'"),
        (setting("nodes", []), "an edge with tail 'Net', which is none of its nodes"),
        (
            setting("nodes", GOOD["nodes"][1:2] * 10_001),
            "has 10001 nodes; at most 10000 can be read",
        ),
        (setting("nodes", ["Net"]), "node 0 of the skill is 'Net'; give an object with"),
        (setting("start", ...), "the skill file has no 'start'"),
        (setting("start", "Nowhere"), "start node 'Nowhere' is none of the nodes"),
        (setting("start", 0), "has start 0; give text"),
        (setting("format", "other"), "not a skill file: format is 'other'"),
        (setting("version", 3), "version 3, this cgtorch reads 2; use the version that wrote it"),
        (
            setting("version", True),
            "version True, this cgtorch reads 2; use the",
        ),
        (
            setting("version", ...),
            "version None, this cgtorch reads 2; use the",
        ),
        (setting("max_transitions", 0), "max_transitions 0; give 1 to 2147483648"),
        (setting("max_transitions", 1.5), "max_transitions 1.5; give a whole number"),
        (setting("max_transitions", True), "max_transitions True; give a whole number"),
        (setting("max_transitions", 10**30), "max_transitions 1000"),
        (setting("name", "x" * 1001), "name 'xxx.* of 1001 characters; give at most 1000"),
        (setting("extra", 1), "unknown key 'extra'; known: format"),
        (setting("skills", "S1", ...), "unknown action 'S1'"),
        (setting("skills", "S1", 3), "sub-skill 'S1' is 3; give an object"),
        (setting("skills", "S1", "format", "cgtorch-skill"), "sub-skill 'S1' has unknown key"),
        (setting("skills", "S1", "edges", []), "node 'Grasp_0' .* no edge for outcome 'failure'"),
        (setting("skills", "S9", LOOP), "sub-skill 'S9' is used by no node"),
        (setting("skills", "Grasp", LOOP), "sub-skill 'Grasp' has the name of an action"),
        (setting("skills", {"S1": LOOP}), "sub-skill 'S1' contains itself; remove the cycle"),
        (setting("skills", TWO_LOOPS), "sub-skill 'S1' contains itself; remove the cycle"),
        (setting("skills", DEEP), "nested deeper than 32; use fewer levels"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(
    change: Callable[[dict[str, Any]], None], message: str
) -> None:
    data = copy.deepcopy(GOOD)
    skill_from_dict(data, ACTIONS)
    change(data)
    with pytest.raises((GraphError, ActionError), match=message) as caught:
        skill_from_dict(data, ACTIONS)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("data", [None, 3, "text", [], {}, {"format": None}, [GOOD]])
def test_what_is_no_skill_at_all(data: object) -> None:
    with pytest.raises(GraphError, match=r"format is .*; give a file that save_skill"):
        skill_from_dict(data, ACTIONS)


@pytest.mark.parametrize("path", [None, 5, b"x"])
def test_what_is_no_path_is_said(path: Any) -> None:
    with pytest.raises(SettingsError, match=r"path is .*; give a path as a text or"):
        load_skill(path)
    with pytest.raises(SettingsError, match=r"path is .*; give a path as a text or"):
        save_skill(path, random_skill(0, "a", ACTIONS))


def test_what_is_no_skill_and_what_are_no_actions_is_said(tmp_path: Path) -> None:
    nothing: Any = None
    with pytest.raises(SettingsError, match="skill is None; give a Skill"):
        save_skill(tmp_path / "a", nothing)
    with pytest.raises(RunError, match=r"cannot write '\.', which is a folder"):
        save_skill(".", random_skill(0, "a", ACTIONS))
    number: Any = 5
    with pytest.raises(SettingsError, match="actions is 5; give an ActionSet"):
        load_skill(tmp_path / "a", number)


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    path = tmp_path / "skill.json"
    with pytest.raises(GraphError, match="not a file"):
        load_skill(path, ACTIONS)
    path.write_text(json.dumps(GOOD)[:-1])
    with pytest.raises(GraphError, match="not proper JSON"):
        load_skill(path, ACTIONS)
    path.write_text("[" * 200_000)
    with pytest.raises(GraphError, match="not proper JSON"):
        load_skill(path, ACTIONS)
    with path.open("wb") as file:
        file.truncate(2**33)  # sparse, so it takes no room
    with pytest.raises(GraphError, match="larger than"):
        load_skill(path, ACTIONS)
    with pytest.raises(RunError, match="cannot write"):
        save_skill(tmp_path / "none" / "skill.json", skill_from_dict(GOOD, ACTIONS))


def attempt(read: Callable[[], Skill]) -> None:
    """Either a skill or a one-line `CgtorchError`; any other error fails the test."""
    message = ""
    try:
        read()
    except CgtorchError as e:
        message = str(e)
    assert "\n" not in message


@given(st.data())
@settings(max_examples=200)
def test_damaged_files_end_in_a_typed_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    raw = bytearray(json.dumps(GOOD, separators=(",", ":")).encode())
    at = st.integers(0, len(raw) - 1)
    for where in data.draw(st.lists(at, min_size=1, max_size=4)):
        match data.draw(st.sampled_from(["flip", "insert", "delete"])):
            case "flip":
                raw[where % len(raw)] ^= data.draw(st.integers(1, 255))
            case "insert":
                raw[where:where] = data.draw(
                    st.sampled_from([b"0", b"9" * 30, b"-", b"e999", b'"', b"[", b"]", b"{}", b","])
                )
            case "delete":
                del raw[where : where + data.draw(st.integers(1, 40))]
    path = tmp_path_factory.getbasetemp() / "damaged.json"
    path.write_bytes(raw)
    attempt(lambda: load_skill(path, ACTIONS))


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["Net", "Move", "Sub", "S1", "Grasp", "success", "failure"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from([*GOOD, "action", "tail", "S1"]), inner, max_size=4)
    ),
    max_leaves=8,
)


@given(st.data())
@settings(max_examples=200)
def test_wrong_data_anywhere_end_in_a_typed_error(data: st.DataObject) -> None:
    root: Any = [copy.deepcopy(GOOD)]
    place, key = root, 0
    while data.draw(st.integers(0, 4)) and isinstance(place[key], dict | list) and place[key]:
        place = place[key]
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
    place[key] = data.draw(values)
    attempt(lambda: skill_from_dict(root[0], ACTIONS))


def test_an_action_is_found_wherever_its_class_was() -> None:
    data = skill_to_dict(Skill("S", chain(walking_actions(), "Aim", "Step"), walking_actions()))
    data["actions"]["Step"]["class"] = "cgtorch.graphs.where_it_was:Step"
    assert type(skill_from_dict(data).actions.actions[1]).__name__ == "Step"


@given(st.integers(0, 2**31))
def test_the_librarys_actions_need_not_be_given(seed: int) -> None:
    base = edge_actions(7).extended(
        ["Way", "Delay", "Memory"],
        [EdgeWayNN(9, (-0.4, 0.4, -0.3, 0.3)), DelayNN(5, 2, 3), RecurrentNN(4, 2, 3)],
    )
    skill = random_skill(seed, "top", nested_actions(base=base))
    again = skill_from_dict(json.loads(json.dumps(skill_to_dict(skill))))
    assert bits(again) == bits(skill)
    assert again.sub_skills.keys() == skill.sub_skills.keys()
    assert skill_to_dict(again) == skill_to_dict(skill)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"class": "my_arm:Wave", "arguments": {}}, "'my_arm:Wave', which is code of its own"),
        ({"class": "cgtorch.none:Wave", "arguments": {}}, "which is not there"),
        ({"class": "cgtorch.graphs:ActionSet", "arguments": {}}, "which is no action"),
        ({"class": "cgtorch.graphs:Step", "arguments": {"size": 3}}, "cannot be made with"),
        ({"class": "cgtorch.graphs:Step", "arguments": {"control_size": "a"}}, "cannot be made"),
        ({"class": "os:system", "arguments": {}}, "code of its own"),
        ({"class": "cgtorch.graphs:Step"}, "action 'MoveBase' has no 'arguments'"),
        (3, "action 'MoveBase' is 3"),
    ],
)
def test_actions_of_a_file_are_the_librarys_or_given(about: Any, message: str) -> None:
    data = skill_to_dict(skill_from_dict(GOOD, ACTIONS))
    data["actions"]["MoveBase"] = about
    with pytest.raises((ActionError, GraphError), match=message):
        skill_from_dict(data)
    assert skill_from_dict(data, ACTIONS).num_nodes == 3
