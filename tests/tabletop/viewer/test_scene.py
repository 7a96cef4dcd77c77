"""What is drawn of a skill at work: in three dimensions, and as HTML beside it."""

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import viser
from lxml import etree, html
from support import custom_actions, random_skill, tool_pose, world
from viser.transforms import SE3

from cgtorch.graphs import Skill
from cgtorch.ground.errors import DataError
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.kinematics import Robot, load_robot, robots_folder
from cgtorch.tabletop.viewer import scene as scenes
from cgtorch.tabletop.viewer.execution import Execution, execute, scenario_of
from cgtorch.tabletop.viewer.scene import (
    AHEAD,
    BOX_COLOUR,
    CONTACT,
    DONE,
    FLOOR,
    GOAL,
    GRIP,
    LEG_SIDE,
    LIT,
    OBSTACLE_HEIGHT,
    REFUSED,
    SEEN,
    WOOD,
    Scene,
    _about_z,
    _segments,
    headline,
    levels_html,
    message_rows,
    percept_rows,
    readings_html,
)
from cgtorch.tabletop.viewer.timeline import Timeline, joint_names, timeline_of

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
LIT_RULE = re.compile(rf'\[data-part="(node:[^"]+)"\] path {{ fill: {LIT}')
EDGE_RULE = re.compile(r'\[data-part="((?:edge|end):[^"]+)"\]')


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield made
    made.stop()


def shapeless(folder: Path) -> Robot:
    """The PR2 without anything to look at, as robots are whose meshes are elsewhere."""
    shutil.copy(robots_folder() / "pr2" / "robot.json", folder)
    tree = etree.parse(robots_folder() / "pr2" / "pr2.urdf")
    etree.strip_elements(tree, "visual")
    tree.write(folder / "pr2.urdf")
    return load_robot(folder / "pr2.urdf")


def some_timeline(robot: Robot, name: str = "some") -> Timeline:
    return timeline_of(execute(random_skill(3, name, custom_actions()), world(3, 1)), robot)


@pytest.mark.parametrize("visible", [True, False])
def test_base_object_and_links_are_where_they_should_be(
    server: viser.ViserServer, tmp_path: Path, visible: bool
) -> None:
    robot = load_robot() if visible else shapeless(tmp_path)
    timeline, scene = some_timeline(robot), Scene(server, "/one", robot)
    scene.load(timeline)
    assert len(scene.drawn._meshes) == 34
    for frame in (0, len(timeline) // 2, len(timeline) - 1, len(timeline) + 5):
        scene.show(frame)
        at = min(frame, len(timeline) - 1)
        np.testing.assert_allclose(scene.base.position[:2], timeline.pose[at, :2], atol=1e-6)
        turn = 2 * np.arctan2(scene.base.wxyz[3], scene.base.wxyz[0])
        assert np.cos(turn - float(timeline.pose[at, 2])) == pytest.approx(1, abs=1e-6)
        tops = timeline.object[at].numpy() + np.array([0, 0, 0.05])
        np.testing.assert_allclose(scene.object.position, tops, atol=1e-6)
    for arm, words, home in zip(robot.arms, robot.description.arms, robot.home, strict=True):
        wanted = tool_pose(arm, home).numpy()
        np.testing.assert_allclose(drawn_pose(scene, words.tool_frame), wanted, atol=1e-6)
    positions = dict(zip(scene.drawn.get_actuated_joint_names(), scene.rest, strict=True))
    held = {**robot.description.gripper_joints, robot.description.torso_joint: 0.15}
    for name in positions.keys() - joint_names(robot):
        assert positions[name] == held.get(name, 0.0), f"{name} stays at rest"
    assert np.isfinite(scene.rest).all()
    scene.place.remove()


def drawn_pose(scene: Scene, link: str) -> np.ndarray:
    """A link in the base frame, from the frames of the page's scene tree above it."""
    handles = {handle.name: handle for handle in scene.drawn._joint_frames}
    (name,) = (n for n in handles if n.endswith(f"/{link}"))
    pose = SE3.identity()
    while name in handles:
        turn = viser.transforms.SO3(handles[name].wxyz)
        pose = SE3.from_rotation_and_translation(turn, handles[name].position) @ pose
        name = name.rsplit("/", 1)[0]
    return np.asarray(pose.as_matrix())


@cache
def executions() -> list[Execution]:
    run, skill = last_skill(REFERENCE)
    scenarios = [scenario_of("perimeter", 8, 0, i) for i in (0, 3, 5)]
    return [execute(skill, run.domain.world(s)) for s in scenarios]


def label(skill: Skill, slot: int) -> str:
    return f"{skill.actions.names[int(skill.graph.action[0, slot])]}_{slot}"


def test_every_level_is_drawn_and_its_node_and_the_edge_of_the_outcome_are_lit() -> None:
    deepest = 0
    for run in executions():
        for k, step in enumerate(run.steps):
            text = levels_html(run.skill, step)
            page = html.fromstring(text)
            assert len(page.xpath(".//svg")) == len(step.places)
            deepest = max(deepest, len(step.places))
            lit, (edge,) = LIT_RULE.findall(text), EDGE_RULE.findall(text)
            assert [node.rsplit(":", 1)[1] for node in lit] == [label(*p) for p in step.places]
            for part in (*lit, edge):
                (group,) = page.xpath(".//*[@data-part=$id]", id=part)
                assert group.xpath(".//path"), part
            kind, _, tail, outcome, *head = edge.split(":")
            assert (tail, outcome) == (label(*step.places[-1]), step.outcome)
            assert (kind == "end") == (not head)
            if head and len(run.steps[k + 1].places) == len(step.places) == 1:
                assert head == [label(*run.steps[k + 1].places[-1])]
        assert kind == "end"
    assert 1 < deepest <= run.skill.depth


def test_only_the_innermost_level_is_drawn_large(monkeypatch: pytest.MonkeyPatch) -> None:
    large = list[bool]()
    monkeypatch.setattr(scenes, "_picture", lambda skill, inner, last: large.append(last))
    deepest = max((s for run in executions() for s in run.steps), key=lambda s: len(s.places))
    levels_html(executions()[0].skill, deepest)
    assert large == [False] * (len(deepest.places) - 1) + [True]
    assert len(large) > 1


def test_names_that_look_like_markup_stay_names() -> None:
    name = 'S<img src=x>"]</style><b>\\'
    run = execute(random_skill(3, name, custom_actions()), world(3, 1))
    page = html.fromstring(levels_html(run.skill, run.steps[0]))
    assert not page.xpath(".//img") + page.xpath(".//b")
    assert page.xpath(".//*[starts-with(@data-part, $id)]", id=f"node:{name}:")
    (style,) = (s.text for s in page.xpath(".//style") if LIT in (s.text or ""))
    assert name not in style


@pytest.mark.parametrize(
    ("size", "names"),
    [
        (7, ["table x min", "object z"]),
        (9, ["side x", "side y"]),
        (15, ["obstacle 1 x min", "obstacle 2 y max"]),
        (13, ["side y", "obstacle 1 y max"]),
    ],
)
def test_every_number_of_a_percept_has_a_name(size: int, names: list[str]) -> None:
    rows = percept_rows(torch.arange(size) / 10)
    assert [value for _, value in rows] == [f"{i / 10:.3f} m" for i in range(size)]
    found = {name for name, _ in rows}
    assert len(found) == size
    assert set(names) <= found
    with pytest.raises(DataError, match="a percept has 8 numbers"):
        percept_rows(torch.zeros(8))


def test_messages() -> None:
    assert message_rows(torch.full((3,), float("nan"))) == []
    assert message_rows(torch.tensor([0.5, float("nan"), 0.25])) == []
    values = ("dx", "+0.500 m"), ("dy", "-1.000 m"), ("dθ", "+0.250 rad"), ("3", "+2.000")
    assert message_rows(torch.tensor([0.5, -1.0, 0.25, 2.0])) == [*values]


def test_what_is_shown_is_of_the_step_and_safe_as_html() -> None:
    line = some_timeline(load_robot(), "<b>")
    run = line.execution
    for k, step in enumerate(run.steps):
        frame, slot = line.start_of(k), step.places[-1][1]
        named = f"step {k + 1} of {len(run.steps)}: <b> · {step.name}_{slot} → {step.outcome}"
        assert headline(line, frame) == named
        text = readings_html(line, frame)
        assert "<b>: " not in text
        assert "&lt;b&gt; ·" in text
        for name, value in percept_rows(run.percept[int(line.seen[frame])]):
            assert f">{name}<" in text
            assert f">{value}<" in text
    assert headline(line, len(line) - 1).endswith(f"<b> ended with {run.end}")
    quiet = replace(run, message=torch.full_like(run.message, float("nan")))
    assert "none yet" in readings_html(replace(line, execution=quiet), 0)


class Drawn:
    """A server that notes what would be drawn, by its name."""

    def __init__(self) -> None:
        self.scene, self.known = self, dict[str, Any]()

    def __getattr__(self, kind: str) -> Any:
        def add(name: str, *given: Any, **how: Any) -> None:
            self.known[name.removeprefix("/one/")] = SimpleNamespace(kind=kind, given=given, **how)

        return add


def plain_scene() -> tuple[Any, dict[str, Any]]:
    """A scene without a robot's links, and what is drawn of it."""
    scene, server = Scene.__new__(Scene), Drawn()
    scene.server, scene.name, scene.marked, scene.frame = server, "/one", 0, -1  # type: ignore[assignment]
    footprint = (-0.2, 0.3, -0.1, 0.1)
    scene.robot = SimpleNamespace(description=SimpleNamespace(footprint=footprint))  # type: ignore[assignment]
    return scene, server.known


def test_contacts_are_marked_while_there_are_some() -> None:
    scene, known = plain_scene()
    scene._contacts(np.zeros((0, 4)))
    assert not known
    scene._contacts(np.array([[1.0, 2.0, 3.0, 0.0], [4.0, 5.0, 6.0, 1.0]]))
    points, colours = known["contacts"].given
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert colours.tolist() == [list(GRIP), list(REFUSED)]
    assert (known["contacts"].visible, known["contacts"].point_size) == (True, CONTACT)
    scene._contacts(np.zeros((0, 4)))
    assert known["contacts"].visible is False
    assert known["contacts"].given[0].tolist() == [[0, 0, 0]]  # as there has to be a point


def lines_of(drawn: Any) -> list[Any]:
    assert drawn.kind == "add_line_segments"
    assert drawn.thickness_units == "screen"
    return [[[round(x, 4) for x in end] for end in line] for line in drawn.given[0].tolist()]


def step_of(outcome: str, name: str = "MoveBase") -> SimpleNamespace:
    return SimpleNamespace(name=name, outcome=outcome)


def test_the_pose_that_is_asked_for_is_drawn_and_red_if_it_is_refused() -> None:
    scene, known = plain_scene()
    nan = torch.full((3,), float("nan"))
    run = SimpleNamespace(
        message=torch.stack([nan, torch.tensor([0.5, 0.0, pi / 2]), nan]),
        pose=torch.tensor([[1.0, 2.0, pi / 2], [0.0, 0.0, 0.0]]),
        steps=[step_of("success"), step_of("failure")],
    )
    scene._asked(SimpleNamespace(execution=run), 0)
    z = round(3 * FLOOR, 4)
    *outline, nose = lines_of(known["asked"])
    assert [end[:2] for end in nose] == [[1.0, 2.5], [0.67, 2.5]]  # it has turned to -x
    assert {tuple(end) for line in outline for end in line} == {
        (1.2, 2.6, z), (1.2, 2.4, z), (0.7, 2.6, z), (0.7, 2.4, z)
    }  # fmt: skip
    assert len(outline) == 4
    assert known["asked"].given[1] == GOAL
    assert known["asked"].visible is True
    scene._asked(SimpleNamespace(execution=run), 1)
    assert known["asked"].visible is False
    assert known["asked"].given[1] == REFUSED
    run.steps[1] = step_of("failure", "Grasp")
    scene._asked(SimpleNamespace(execution=run), 1)
    assert known["asked"].given[1] == GOAL
    run.message = run.message[:, :2]
    scene._asked(SimpleNamespace(execution=run), 0)
    assert known["asked"].visible is False


def test_what_is_perceived_is_drawn_where_it_seems_to_be() -> None:
    scene, known = plain_scene()
    run = SimpleNamespace(
        scenario=SimpleNamespace(table=torch.tensor([[0.0, 0.0, 0.0, 1.0, 1.0, 0.7]])),
        pose=torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, pi / 2]]),
        percept=torch.tensor([[0.0] * 7, [0.5, 1.5, -0.5, 0.5, 1.0, 0.25, 0.8]]),
    )
    scene._perceived(SimpleNamespace(execution=run), 1)
    z = round(0.7 + FLOOR, 4)
    box = lines_of(known["perceived"])
    assert {tuple(line[0]) for line in box} == {
        (0.5, 2.5, z), (0.5, 3.5, z), (1.5, 2.5, z), (1.5, 3.5, z)
    }  # fmt: skip
    assert {end[2] for line in box for end in line} == {z}
    assert all(one[0] == other[0] or one[1] == other[1] for one, other in box)
    cross = lines_of(known["perceived-object"])
    ends = {tuple(end) for line in cross for end in line}
    high = round(0.8 + 2 * FLOOR, 4)
    assert ends == {(0.75, 2.94, high), (0.75, 3.06, high), (0.69, 3.0, high), (0.81, 3.0, high)}
    assert known["perceived"].given[1] == known["perceived-object"].given[1] == SEEN


def test_a_table_its_legs_and_obstacles_are_boxes() -> None:
    scene, known = plain_scene()
    scene.actuated, scene.show = ["a", "b"], lambda frame: known.update(shown=frame)
    scenario = SimpleNamespace(
        table=torch.tensor([[1.0, 2.0, pi / 2, 0.8, 1.2, 0.7]]),
        obstacles=torch.tensor([[[0.5, 0.6, 0.0, 0.3, 0.4], [0.0] * 5]]),
    )
    pose = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    run = SimpleNamespace(scenario=scenario, skill=SimpleNamespace(name="Reach"), pose=pose)
    scene.load(SimpleNamespace(execution=run, names=("b", "a"), pose=pose))
    assert scene.columns == [1, 0]
    assert known["shown"] == 0
    table = known["table"]
    assert table.dimensions[:2] == pytest.approx((0.8, 1.2))
    assert table.position[2] + table.dimensions[2] / 2 == pytest.approx(0.7)
    assert table.position[:2] == (1.0, 2.0)
    assert table.color == WOOD
    assert table.wxyz == pytest.approx(_about_z(pi / 2))
    legs = [known[f"leg-{k}"] for k in range(4)]
    for leg in legs:
        assert leg.dimensions[:2] == (LEG_SIDE, LEG_SIDE)
        assert leg.position[2] == pytest.approx(leg.dimensions[2] / 2)
        assert leg.dimensions[2] + table.dimensions[2] == pytest.approx(0.7)
        off = sorted(abs(a - b) for a, b in zip(leg.position[:2], (1.0, 2.0), strict=True))
        assert off == pytest.approx([0.4 - LEG_SIDE, 0.6 - LEG_SIDE])
    assert len({leg.position for leg in legs}) == 4
    box = known["obstacle-0"]
    assert box.position == pytest.approx((0.5, 0.6, OBSTACLE_HEIGHT / 2))
    assert box.dimensions == pytest.approx((0.3, 0.4, OBSTACLE_HEIGHT))
    assert (box.visible, box.color) == (True, BOX_COLOUR)
    assert known["obstacle-1"].visible is False
    assert known["label"].given == ("Reach",)
    assert known["label"].position == pytest.approx((0.0, 0.0, 1.2))
    stops, way = lines_of(known["stops"]), lines_of(known["way"])
    assert len(stops) == 2 * 4  # as it stays for a step
    assert way == [[[0.0, 0.0, FLOOR], [1.0, 0.0, FLOOR]]]
    assert known["stops"].given[1] == known["way"].given[1] == AHEAD


def test_where_there_are_no_lines_one_of_no_length_is_drawn() -> None:
    scene, known = plain_scene()
    scene._lines("driven", _segments(torch.zeros(3, 2)), DONE, 0.5, 5)
    assert lines_of(known["driven"]) == [[[0.0] * 3] * 2]
    assert known["driven"].thickness == 5


def test_a_quarter_turn_about_the_vertical() -> None:
    assert _about_z(pi / 2) == pytest.approx((0.5**0.5, 0, 0, 0.5**0.5))
