import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import viser
from lxml import etree
from support import custom_actions, random_skill, tool_pose, world
from viser.transforms import SE3

from cgtorch.tabletop.kinematics import Robot, load_robot, robots_folder
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.scene import Scene
from cgtorch.tabletop.viewer.timeline import Timeline, joint_names, timeline_of


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield made
    made.stop()


def shapeless(folder: Path) -> Robot:
    """The PR2 without anything to look at, as robots are whose meshes are elsewhere."""
    shutil.copy(robots_folder() / "pr2" / "robot.json", folder)
    tree = etree.parse(robots_folder() / "pr2" / "pr2.urdf")
    for link in tree.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    tree.write(folder / "pr2.urdf")
    return load_robot(folder / "pr2.urdf")


def some_timeline(robot: Robot) -> Timeline:
    run = execute(random_skill(3, "some", custom_actions()), world(3, 1))
    return timeline_of(run, robot)


@pytest.mark.parametrize("seen", [True, False])
def test_base_object_and_links_are_where_they_should_be(
    server: viser.ViserServer, tmp_path: Path, seen: bool
) -> None:
    robot = load_robot() if seen else shapeless(tmp_path)
    timeline = some_timeline(robot)
    scene = Scene(server, "/one", robot)
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
    for which, arm in enumerate(robot.arms):
        q = robot.home[which]
        wanted = tool_pose(arm, q).numpy()
        tool = robot.description.arms[which].tool_frame
        np.testing.assert_allclose(drawn_pose(scene, tool), wanted, atol=1e-6)
    scene.remove()


def drawn_pose(scene: Scene, link: str) -> np.ndarray:
    """A link in the base frame, from the frames of the page's scene tree above it."""
    handles = {handle.name: handle for handle in scene.drawn._joint_frames}
    (name,) = (n for n in handles if n.endswith(f"/{link}"))
    pose = SE3.identity()
    while name in handles:
        here = SE3.from_rotation_and_translation(
            viser.transforms.SO3(handles[name].wxyz), handles[name].position
        )
        pose, name = here @ pose, name.rsplit("/", 1)[0]
    return np.asarray(pose.as_matrix())


def test_joints_that_nothing_moves_stay_at_rest(server: viser.ViserServer) -> None:
    robot = load_robot()
    scene = Scene(server, "/two", robot)
    positions = dict(zip(scene.drawn.get_actuated_joint_names(), scene.rest, strict=True))
    held = {**robot.description.gripper_joints, robot.description.torso_joint: 0.15}
    for name, position in positions.items():
        if name not in joint_names(robot):
            assert position == held.get(name, 0.0), name
    assert torch.isfinite(torch.tensor(scene.rest)).all()
    scene.remove()
