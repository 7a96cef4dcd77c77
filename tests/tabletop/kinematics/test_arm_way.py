"""Ways of arms, against yourdfpy's forward kinematics and points sampled on the URDF's shapes."""

import itertools

import numpy as np
import pytest
import torch
from support import tool_pose
from test_grasping import random_scene

from cgtorch.tabletop.kinematics import arm_ways, graspable, has_posture
from cgtorch.tabletop.kinematics.clear_ways import MARGIN
from cgtorch.tabletop.kinematics.grasp_lines import HALF, LINE
from cgtorch.tabletop.kinematics.grasping import APPROACHES, GRASP_HEIGHT, waypoints
from cgtorch.tabletop.kinematics.scene import OBJECT_RADIUS

OFF_LINE = 0.002  # m
STEP = 0.05  # rad: how finely a way is looked at by the slow reference
ROUNDING = 1e-4  # m


@pytest.fixture(scope="module", params=["pr2", "fetch"])
def robot_and_ways(request):
    robot = request.getfixturevalue(request.param)
    position, table = random_scene(300, seed=21)
    return robot, position, table, arm_ways(robot, position, table)


def rows_of(ways):
    return ways.found.nonzero()[:, 0].tolist()


def densely(way, step=STEP):
    """Postures on a way (W, n) that are at most a step apart in any joint."""
    parts = [way[:1]]
    for a, b in itertools.pairwise(way):
        count = max(1, int(torch.ceil((b - a).abs().max() / step)))
        parts.append(a + torch.arange(1, count + 1)[:, None] / count * (b - a))
    return torch.cat(parts)


def test_ways_begin_at_home_and_keep_to_the_line(robot_and_ways):
    robot, position, _, ways = robot_and_ways
    assert len(rows_of(ways)) > 100
    for row in rows_of(ways):
        arm, home = robot.arms[int(ways.arm[row])], robot.home[int(ways.arm[row])]
        pre, grasp, lifted = (int(x[row]) for x in (ways.pre_grasp, ways.grasp, ways.lifted))
        assert (grasp - pre, lifted - pre) == (HALF, LINE - 1)
        way = ways.joints[row, : lifted + 1].double()
        torch.testing.assert_close(way[0], home, atol=1e-6, rtol=0)
        wanted = waypoints(position[row : row + 1], *APPROACHES[int(ways.approach[row])])[0]
        torch.testing.assert_close(
            tool_pose(arm, way[[pre, grasp, lifted]]).float(), wanted[[0, 2, 4]], atol=5e-5, rtol=0
        )
        for part, a, b in ((way[pre : grasp + 1], 0, 2), (way[grasp:], 2, 4)):
            tool = tool_pose(arm, densely(part, 0.01))[:, :3, 3]
            start, end = wanted[a, :3, 3].double(), wanted[b, :3, 3].double()
            share = ((tool - start) @ (end - start) / (end - start).square().sum()).clamp(0, 1)
            off = tool - start - share[:, None] * (end - start)
            assert off.norm(dim=1).max() < OFF_LINE
        turns = arm.continuous
        assert ((way >= arm.lower - 1e-5) | turns).all()
        assert ((way <= arm.upper + 1e-5) | turns).all()


def test_ways_back_lead_home(robot_and_ways):
    robot, _, _, ways = robot_and_ways
    assert ways.returns[ways.found].double().mean() > 0.95
    for row in ways.returns.nonzero()[:, 0].tolist():
        back = ways.back[row, : int(ways.home_again[row]) + 1]
        torch.testing.assert_close(back[0], ways.joints[row, int(ways.lifted[row])])
        home = robot.home[int(ways.arm[row])].float()
        torch.testing.assert_close(back[-1], home, atol=1e-6, rtol=0)


def shapes_of(robot, arm):
    """Of each colliding link of an arm: name, pose, and sizes of its elements in the link."""
    urdf, links = robot.urdf, []
    base = next(a.base_link for a in robot.description.arms if a.name == arm.name)
    for link in urdf.model.robot.links:
        joints = [j.name for j in urdf.joints_above(link.name, base)]
        if link.collisions and set(joints) & set(arm.joint_names):
            links.append(link)
    return links


def sampled(geometry, generator, count=150):
    """Points on the surface of a box, a cylinder or a sphere."""
    if geometry.box is not None:
        points = generator.uniform(-0.5, 0.5, (count, 3))
        side = generator.integers(3, size=count)
        points[np.arange(count), side] = np.sign(points[np.arange(count), side]) / 2
        return points * np.array(geometry.box.size, dtype=float)
    way = generator.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    if geometry.sphere is not None:
        return way * geometry.sphere.radius
    radius, half = geometry.cylinder.radius, geometry.cylinder.length / 2
    flat = way[:, :2] / np.linalg.norm(way[:, :2], axis=1, keepdims=True)
    z = generator.uniform(-half, half, count)
    ends = generator.uniform(size=count) < 0.4
    z[ends] = np.sign(z[ends]) * half
    return np.column_stack(
        [flat * radius * np.where(ends, generator.uniform(size=count), 1)[:, None], z]
    )


def depth(points, geometry):
    """How deep points are within a shape, at least 0, m."""
    if geometry.box is not None:
        out = np.array(geometry.box.size, dtype=float) / 2 - np.abs(points)
        return out.min(axis=-1).clip(0)
    if geometry.sphere is not None:
        return (geometry.sphere.radius - np.linalg.norm(points, axis=-1)).clip(0)
    side = geometry.cylinder.radius - np.linalg.norm(points[..., :2], axis=-1)
    return np.minimum(side, geometry.cylinder.length / 2 - np.abs(points[..., 2])).clip(0)


def box(x, y, z):
    return type("Geometry", (), {"box": type("Box", (), {"size": (x, y, z)}), "sphere": None})


def pose_of(collision):
    return np.eye(4) if collision.origin is None else collision.origin


def within(points, pose):
    return (points - pose[:3, 3]) @ pose[:3, :3]


def test_ways_touch_nothing(robot_and_ways):
    """Neither table, body, other arm nor object, and the gripper not the forearm."""
    robot, position, table, ways = robot_and_ways
    generator = np.random.default_rng(0)
    model = robot.urdf.model
    for name, position_ in robot.description.held.items():
        model.update_cfg({name: position_})
    planned = (ways.found & (ways.pre_grasp > 1)).nonzero()[:, 0].tolist()
    for row in (planned[:2] + rows_of(ways)[::40])[:6]:
        which = int(ways.arm[row])
        arm, frame = robot.arms[which], robot.description.base_frame
        cfg = dict(robot.description.held)
        for other, home in zip(robot.arms, robot.home, strict=True):
            cfg.update(zip(other.joint_names, home.tolist(), strict=True))
        links = shapes_of(robot, arm)
        points = {
            link.name: np.concatenate([
                sampled(c.geometry, generator) @ pose_of(c)[:3, :3].T + pose_of(c)[:3, 3]
                for c in link.collisions
            ])
            for link in links
        }  # fmt: skip
        model.update_cfg(cfg)
        still = [
            (model.get_transform(link.name, frame) @ pose_of(c), c.geometry)
            for other in robot.arms if other is not arm for link in shapes_of(robot, other)
            for c in link.collisions
        ]  # fmt: skip
        x, y, yaw, long, wide, top = table[row].double().tolist()
        slab = np.eye(4)
        slab[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        slab[:3, 3] = x, y, top - 0.02
        pre = int(ways.pre_grasp[row])
        way = ways.joints[row, : int(ways.lifted[row]) + 1].double()
        before = len(densely(way[: pre + 1]))
        for k, q in enumerate(densely(way)[::2]):
            model.update_cfg({**cfg, **dict(zip(arm.joint_names, q.tolist(), strict=True))})
            placed = {}
            for link in links:
                at = model.get_transform(link.name, frame)
                placed[link.name] = points[link.name] @ at[:3, :3].T + at[:3, 3]
            every = np.concatenate(list(placed.values()))
            assert depth(within(every, slab), box(long, wide, 0.04)).max() < ROUNDING
            for pose, geometry in still:
                assert depth(within(every, pose), geometry).max() < ROUNDING
            if 2 * k < before:
                away = every - np.append(position[row, :2].numpy(), top + GRASP_HEIGHT)
                side = OBJECT_RADIUS - np.linalg.norm(away[:, :2], axis=1)
                assert np.minimum(side, GRASP_HEIGHT - np.abs(away[:, 2])).max() < ROUNDING
            fingers = [p for name, p in placed.items() if "finger" in name]
            for link in links:
                if "forearm" in link.name:
                    at = model.get_transform(link.name, frame)
                    for c in link.collisions:
                        inside = depth(within(np.concatenate(fingers), at @ pose_of(c)), c.geometry)
                        assert inside.max() < ROUNDING


def test_what_has_a_way_is_graspable_and_has_a_posture(robot_and_ways):
    robot, position, table, ways = robot_and_ways
    assert torch.equal(ways.found, graspable(robot, position, table))
    assert bool(has_posture(robot, position, table)[ways.found].all())
    assert 0.3 < ways.found.float().mean() < 0.9


def test_a_way_does_not_depend_on_the_others(robot_and_ways):
    robot, position, table, ways = robot_and_ways
    planned = (ways.found & (ways.pre_grasp > 1)).nonzero()[:, 0].tolist()
    for row in [*range(0, 60, 3), *planned[:4]]:
        alone = arm_ways(robot, position[row : row + 1], table[row : row + 1])
        assert alone.found.item() == ways.found[row].item()
        if alone.found:
            assert alone.arm.item() == ways.arm[row].item()
            assert alone.approach.item() == ways.approach[row].item()
            count = int(ways.lifted[row]) + 1
            torch.testing.assert_close(
                alone.joints[0, :count], ways.joints[row, :count], atol=1e-5, rtol=0
            )


def test_the_margin_is_small_against_an_object():
    assert 0 < MARGIN < OBJECT_RADIUS / 5


def test_no_rows(pr2):
    ways = arm_ways(pr2, torch.zeros(0, 3), torch.zeros(0, 6))
    assert ways.found.shape == (0,)
    assert ways.joints.shape[0] == 0
