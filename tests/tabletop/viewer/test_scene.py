"""What is drawn of a skill at work: in three dimensions, and as HTML beside it."""

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import viser
from lxml import etree, html
from support import custom_actions, random_skill, tool_pose, world
from viser.transforms import SE3

from cgtorch.graphs import Skill
from cgtorch.graphs.clusters import clusters_of
from cgtorch.ground.errors import DataError
from cgtorch.runs.chosen import last_skill
from cgtorch.tabletop.kinematics import Robot, load_robot, robots_folder
from cgtorch.tabletop.physics import Thing
from cgtorch.tabletop.viewer import scene as scenes
from cgtorch.tabletop.viewer.execution import Execution, execute, scenario_of
from cgtorch.tabletop.viewer.scene import (
    LIT,
    OBJECT,
    OUTER_HEIGHT,
    SCALE,
    Scene,
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


def test_a_level_that_waits_is_no_higher_than_it_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = list[tuple[float, float]]()

    def noted(figure: Any, key: str, path: str, scale: float) -> None:
        assert (key, path) == (cluster.key, cluster.path)
        drawn.append((figure.get_size_inches()[1], scale))

    monkeypatch.setattr(scenes, "inline_svg", noted)
    skill = executions()[0].skill
    for cluster in clusters_of(skill):
        for last in (True, False):
            scenes._picture.__wrapped__(skill, cluster.skill, last)
    assert len(drawn) > 2
    for (height, large), (same, small) in zip(drawn[::2], drawn[1::2], strict=True):
        assert (same, large) == (height, SCALE)
        assert small == pytest.approx(min(SCALE, OUTER_HEIGHT / height))
    assert min(small for _, small in drawn) < SCALE


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
        said = percept_rows(run.percept[int(line.seen[frame])]) + message_rows(run.message[k + 1])
        for name, value in said:
            assert f">{name}<" in text
            assert f">{value}<" in text
    assert headline(line, len(line) - 1).endswith(f"<b> ended with {run.end}")
    quiet = replace(run, message=torch.full_like(run.message, float("nan")))
    assert "none yet" in readings_html(replace(line, execution=quiet), 0)


def test_a_scene_has_a_place_an_object_and_a_robot_of_its_own(server: viser.ViserServer) -> None:
    """No axes are drawn, and the object is as large as the one that is grasped."""
    scene = Scene(server, "/two", load_robot(), -1.5)
    place, base, thing = scene.place, scene.base, scene.object
    assert (place.name, base.name, thing.name) == ("/two", "/two/base", "/two/object")
    assert tuple(place.position) == (0.0, -1.5, 0.0)
    assert tuple(base.position) == tuple(thing.position) == (0.0, 0.0, 0.0)
    robot = server.scene._handle_from_node_name["/two/base/robot"]
    assert [each.show_axes for each in (place, base, robot)] == [False] * 3
    assert (thing.radius, thing.height) == (Thing().size[0], pytest.approx(0.1))
    assert tuple(thing.color) == OBJECT
    assert scene.drawn._joint_frames
    for frame in (*scene.drawn._joint_frames, *scene.drawn._meshes):
        assert frame.name.startswith("/two/base/robot/")
    assert (scene.timeline, scene.columns) == (None, [])
    assert (scene.frame, scene.marked) == (-1, 0)
    scene.place.remove()
