"""The state machine's file runs on plain Python and does what the library does in the world."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from driving import by_the_library, reference
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_machines import executed, filled_in, imported
from support import (
    Counter,
    Visits,
    Wander,
    custom_actions,
    model,
    nested_actions,
    random_graphs,
    random_skill,
    stochastic_actions,
)

from cgtorch.export import plain as networks
from cgtorch.export import to_state_machine
from cgtorch.graphs import ActionSet, Skill, SubSkill
from cgtorch.simulation import rollout
from cgtorch.tabletop import plain_edge_networks as edge_networks
from cgtorch.tabletop.edge_networks import (
    edge_actions,
    edge_frame,
    edge_way_actions,
    motion_to,
    scene,
)
from cgtorch.tabletop.kinematics import load_robot
from cgtorch.tabletop.world import draw_of
from cgtorch.tabletop.world.routes import first_motion


def test_a_hundred_runs_in_the_world(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run, skill = reference()
    place = run.domain.world(draw_of("perimeter")(100, torch.Generator().manual_seed(21)))
    runs, actions = by_the_library(skill, place)
    module = imported(to_state_machine(skill), tmp_path)
    for scenario in range(100):
        expected = [(type(a).__name__, a.outcomes[out]) for a, out in actions[scenario]]
        found, end = executed(module, place, scenario, caplog)
        assert found == expected
        assert end == runs[scenario].end
    assert len({len(some) for some in actions}) > 3


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31 - 1))
def test_actions_of_ones_own_memory_and_messages(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    skill = random_skill(seed, "S2", nested_actions(seed))
    environment = model(seed, 4)
    runs = rollout(skill.graph, skill.actions, environment, max_transitions=skill.max_transitions)
    module = imported(to_state_machine(skill), tmp_path_factory.mktemp("machine"))

    class Count(getattr(module, "Counter", module.State)):  # type: ignore[misc]
        def execute(self, userdata: Any) -> str:
            mine = userdata.memory
            mine[self.memory[0]] += 1
            mine[self.memory[1]] = userdata.percept[4]
            userdata.message[3] += self.parameters[0]
            if userdata.percept[4] > 1.2 + abs(self.parameters[1]):
                return "lost"
            count: float = mine[self.memory[0]]
            return "enough" if count + userdata.message[3] > 3 else "again"

    for scenario in range(4):
        states = {**filled_in(module, environment, scenario), "Counter": Count}
        userdata = module.Userdata(
            environment.start(torch.tensor([scenario]))[1][0].tolist(),
            [0.0] * 4,
            memory=[0.0] * 2,
        )
        end = module.build(states).execute(userdata)
        timed_out = "timeout" if runs.timed_out[0, scenario] else "failure"
        assert end == ("success" if runs.succeeded[0, scenario] else timed_out)
        assert userdata.steps == runs.transitions[0, scenario]


def test_actions_are_told_which_memory_is_theirs(tmp_path: Path) -> None:
    actions = stochastic_actions().extended(["Visits"], [Visits()])
    many = random_graphs(0, 500, actions, capacity=12, nodes=(10, 12))
    wanted = [actions.index(name) for name in ("Counter", "Wander", "Visits")]
    has_all = torch.stack([(many.action == i).any(1) for i in wanted]).all(0)
    skill = Skill("S", many[has_all.nonzero()[:1, 0]], actions)
    module = imported(to_state_machine(skill), tmp_path)
    places = [list(getattr(module, name).memory) for name in ("Counter", "Wander", "Visits")]
    assert sorted(place for each in places for place in each) == list(range(6))
    assert [len(each) for each in places] == [2, 2, 2]
    assert module.Wander.outcomes == Wander.outcomes
    assert module.Counter.__doc__.startswith("Counts its visits in the common memory: ")
    assert module.Counter.__doc__.endswith(" It has 2 parameters, in `self.parameters`.")


def test_plain_python_is_enough(tmp_path: Path) -> None:
    _, skill = reference()
    (tmp_path / "skill.py").write_bytes(to_state_machine(skill))
    (tmp_path / "use.py").write_text(
        "import sys\n"
        "sys.path.insert(0, '.')\n"
        "import skill\n"
        "class Stay(skill.MoveBase):\n"
        "    def move(self, userdata, dx, dy, dtheta): return True\n"
        "class Miss(skill.Grasp):\n"
        "    def grasp(self, userdata): return False\n"
        "class See(skill.Detect):\n"
        "    def detect(self, userdata): return userdata.percept\n"
        "mine = {'MoveBase': Stay, 'Grasp': Miss, 'Detect': See}\n"
        "print(skill.run([0.5, 1.5, -0.5, 0.5, 0.7, 0.1, 0.75], mine))\n"
        "print(sorted(m for m in ('cgtorch', 'torch', 'numpy') if m in sys.modules))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-I", "-S", "use.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (ended.stdout, ended.stderr) == ("timeout\n[]\n", "")


def test_what_is_not_filled_in_or_wrong_is_said(tmp_path: Path) -> None:
    skill = random_skill(0, "S", custom_actions())
    module = imported(to_state_machine(skill), tmp_path)
    for name in ("MoveBase", "Detect", "Grasp", "Counter"):
        userdata = module.Userdata([0.0] * 7, [0.0] * 4, True, [0.0] * 2)
        with pytest.raises(NotImplementedError, match=f"{name}.* is to be filled in"):
            getattr(module, name)().execute(userdata)

    class Wrong(module.State):  # type: ignore[name-defined]
        outcomes = ("a",)

        def execute(self, userdata: Any) -> str:
            return "b"

    machine = module.StateMachine("m", "one", 1, 1)
    machine.add("one", Wrong(), {"a": "success"})
    with pytest.raises(ValueError, match=r"one returned 'b'; return one of \('a',\)"):
        machine.execute(module.Userdata([]))


names = st.text(min_size=1, max_size=30)


@settings(max_examples=20)
@given(names, names, names)
def test_no_name_becomes_code(skill_name: str, action: str, sub: str) -> None:
    base = custom_actions()
    if {action, sub} & set(base.names) or action == sub:
        return
    base = ActionSet((*base.names[:-1], action), base.actions)
    inner = Skill(sub, random_graphs(0, 1, base), base)
    actions = base.extended([sub], [SubSkill(inner)])
    skill = random_skill(1, skill_name, actions)
    text = to_state_machine(skill).decode()
    found: dict[str, Any] = {"__name__": "skill"}
    sys.modules["skill"] = ModuleType("skill")
    try:
        exec(compile(text, "skill.py", "exec"), found)  # noqa: S102
    finally:
        del sys.modules["skill"]
    machine = found["build"]()
    assert machine.name == skill_name
    own = [c for c in vars(machine).values() if isinstance(c, dict)]
    assert own
    kinds = {type(state).__name__ for state in machine.states.values()}
    assert sum(getattr(found[k], "name", None) == action for k in kinds) <= 1
    extra = set(found) - set(vars(networks)) - set(vars(edge_networks))
    assert all(name.isidentifier() or name == "__builtins__" for name in extra)


def test_hostile_names_of_actions_become_classes_of_their_own() -> None:
    class Mine(Counter):
        pass

    for name in ("class", "State", "print", "MoveBase", "a b", "ä", "1", 'x"\n', "_"):
        base = ActionSet((name,), (Mine(),))
        skill = Skill("S", random_graphs(0, 1, base), base)
        found: dict[str, Any] = {"__name__": "__skill__"}
        sys.modules["__skill__"] = ModuleType("__skill__")
        try:
            exec(compile(to_state_machine(skill).decode(), "s", "exec"), found)  # noqa: S102
        finally:
            del sys.modules["__skill__"]
        (kind, *_) = {type(state) for state in found["build"]().states.values()}
        assert (kind.name, kind.outcomes) == (name, Counter.outcomes)
        assert found["State"] in kind.__mro__
        assert kind is not found["State"]


@settings(max_examples=15)
@given(
    st.integers(0, 2**31 - 1),
    st.sampled_from(["perimeter", "general", "general-clutter"]),
    st.sampled_from(["box", "yaw"]),
)
def test_the_edge_s_frame_in_plain_numbers(seed: int, scenes: str, percept: str) -> None:
    from cgtorch.tabletop.world import TabletopWorld

    drawn = draw_of(scenes)(6, torch.Generator().manual_seed(seed))
    place = TabletopWorld(drawn, lambda at, table: at[:, 0] > 0, (-0.3, 0.3, -0.3, 0.3),
                          percept=percept)  # fmt: skip
    seen = place.start(torch.arange(6))[1].double()
    frame, whole = edge_frame(seen), scene(seen)
    pose = torch.randn(6, 3, generator=torch.Generator().manual_seed(seed)).double()
    motions = motion_to(frame, pose)
    for row, p in enumerate(seen.tolist()):
        plain = edge_networks.edge_frame(p)
        numbers = edge_networks.table_scene(plain, p) + edge_networks.obstacles(plain, p)
        assert numbers == pytest.approx(whole[row].tolist(), abs=1e-6)
        net = edge_networks.EdgeNN([0.0] * 30 + [0.0] * 9 + pose[row].tolist(), 9, 3, 3)
        motion = net.motion(p)
        assert motion[:2] == pytest.approx(motions[row, :2].tolist(), abs=1e-6)
        turn = (motion[2] - motions[row, 2].item() + 1) % (2 * torch.pi) - 1
        assert turn == pytest.approx(0, abs=1e-6)


@settings(max_examples=15)
@given(st.integers(0, 2**31 - 1), st.sampled_from(["box", "yaw"]))
def test_ways_in_plain_numbers(seed: int, percept: str) -> None:
    from cgtorch.tabletop.world import TabletopWorld

    drawn = draw_of("general-clutter")(6, torch.Generator().manual_seed(seed))
    footprint = (-0.36, 0.36, -0.35, 0.37)
    place = TabletopWorld(drawn, lambda at, table: at[:, 0] > 0, footprint, percept=percept)
    seen = place.start(torch.arange(6))[1].double()
    motion = 1.5 * torch.randn(6, 3, generator=torch.Generator().manual_seed(seed)).double()
    wanted = first_motion(seen, motion, torch.tensor(footprint).double())
    for row, p in enumerate(seen.tolist()):
        found = edge_networks.first_motion(
            edge_networks.things(p), motion[row].tolist(), tuple(torch.tensor(footprint).tolist())
        )
        assert found == pytest.approx(wanted[row].tolist(), abs=1e-6)


@pytest.mark.parametrize("robot", ["pr2", "fetch"])
def test_a_network_that_drives_around_is_in_the_file(tmp_path: Path, robot: str) -> None:
    """With the footprint, which differs from robot to robot; it says what the library's says."""
    footprint = load_robot(description=robot).description.footprint
    actions = edge_way_actions(13, footprint)
    skill = random_skill(4, "S", actions)
    machine = imported(to_state_machine(skill), tmp_path).build()
    kinds = {type(s).__name__: s for s in machine.states.values() if hasattr(s, "inputs")}
    assert kinds["EdgeWayNN"].footprint == footprint
    assert kinds["EdgeWayNN"].inputs == 9


def test_edge_actions_are_the_networks_in_the_file(tmp_path: Path) -> None:
    """Of the sizes that percepts with an obstacle take."""
    actions = edge_actions(13)
    skill = random_skill(3, "S", actions)
    module = imported(to_state_machine(skill), tmp_path)
    machine = module.build()
    inputs = {type(s).__name__: s.inputs for s in machine.states.values() if hasattr(s, "inputs")}
    assert set(inputs) == {"EdgeNN", "EdgeBranchingNN"}
    assert inputs["EdgeNN"] == 9
    assert inputs["EdgeBranchingNN"] == 12
