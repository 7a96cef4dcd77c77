"""Ways of arms, against yourdfpy's forward kinematics and points sampled on the URDF's shapes."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from points_outside import outside, shapes_of
from support import tool_pose
from test_grasping import random_scene
from trimesh.transformations import rotation_matrix, translation_matrix

from cgtorch.tabletop.kinematics import arm_way, arm_ways, graspable, has_posture
from cgtorch.tabletop.kinematics.arm_way import PLANNED
from cgtorch.tabletop.kinematics.clear_ways import MARGIN, VIAS
from cgtorch.tabletop.kinematics.grasp_lines import HALF, LINE
from cgtorch.tabletop.kinematics.grasping import APPROACHES, GRASP_HEIGHT, waypoints
from cgtorch.tabletop.kinematics.scene import OBJECT_RADIUS
from cgtorch.tabletop.kinematics.shapes import Shape

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
        assert not torch.equal(back[-2], back[-1])
        assert torch.equal(ways.back[row, len(back) :], back[-1:].expand(VIAS - len(back), -1))
    assert torch.equal(ways.returns, ways.found & (ways.home_again > 0))
    assert ways.joints.shape[1] == int(ways.lifted[ways.found].max()) + 1


def links_of(robot, arm):
    """The colliding links of an arm."""
    base = next(a.base_link for a in robot.description.arms if a.name == arm.name)
    for link in robot.urdf.model.robot.links:
        joints = {joint.name for joint in robot.urdf.joints_above(link.name, base)}
        if link.collisions and joints & set(arm.joint_names):
            yield link


def on_surface(shape):
    """Points (V, 3) on a shape."""
    if shape.kind == "box":
        mesh = trimesh.creation.box(shape.sizes)
    elif shape.kind == "sphere":
        mesh = trimesh.creation.icosphere(3, *shape.sizes)
    else:
        mesh = trimesh.creation.cylinder(*shape.sizes, sections=64)
    return trimesh.sample.sample_surface(mesh.apply_transform(shape.pose), 150, seed=0)[0]


def none_inside(shape, points):
    """Whether no point is deeper within a shape than rounding."""
    twice = shape.kind == "box", shape.kind != "sphere"
    sizes = [size - ROUNDING * (1 + twice[i > 0]) for i, size in enumerate(shape.sizes)]
    return (outside(replace(shape, sizes=tuple(sizes)), points) > 0).all()


def test_ways_touch_nothing(robot_and_ways):
    """Neither table, body, other arm nor object, and the gripper not the forearm."""
    robot, position, table, ways = robot_and_ways
    model, frame = robot.urdf.model, robot.description.base_frame
    at_home = dict(robot.description.held)
    for arm, home in zip(robot.arms, robot.home, strict=True):
        at_home.update(zip(arm.joint_names, home.tolist(), strict=True))
    planned = (ways.found & (ways.pre_grasp > 1)).nonzero()[:, 0].tolist()
    for row in (planned[:2] + rows_of(ways)[::40])[:6]:
        arm = robot.arms[int(ways.arm[row])]
        links = list(links_of(robot, arm))
        points = {
            link.name: np.concatenate([on_surface(shape) for shape in shapes_of(link)])
            for link in links
        }
        model.update_cfg(at_home)
        still = [
            shape for other in robot.arms if other is not arm for link in links_of(robot, other)
            for shape in shapes_of(link, model.get_transform(link.name, frame))
        ]  # fmt: skip
        x, y, yaw, long, wide, top = table[row].double().tolist()
        slab = rotation_matrix(yaw, [0, 0, 1])
        slab[:3, 3] = x, y, top - 0.02
        still.append(Shape("box", slab, (long, wide, 0.04)))
        upright = translation_matrix([*position[row, :2].tolist(), top + GRASP_HEIGHT])
        thing = Shape("cylinder", upright, (OBJECT_RADIUS, 2 * GRASP_HEIGHT))
        way = ways.joints[row, : int(ways.lifted[row]) + 1].double()
        before = len(densely(way[: int(ways.pre_grasp[row]) + 1]))
        for k, q in enumerate(densely(way)[::2]):
            model.update_cfg({**at_home, **dict(zip(arm.joint_names, q.tolist(), strict=True))})
            at = {link.name: model.get_transform(link.name, frame) for link in links}
            placed = {name: points[name] @ to[:3, :3].T + to[:3, 3] for name, to in at.items()}
            every = np.concatenate(list(placed.values()))
            assert all(none_inside(shape, every) for shape in still)
            assert 2 * k >= before or none_inside(thing, every)
            fingers = np.concatenate([p for name, p in placed.items() if "finger" in name])
            for link in links:
                if "forearm" in link.name:
                    assert all(none_inside(s, fingers) for s in shapes_of(link, at[link.name]))


def test_what_has_a_way_is_graspable_and_has_a_posture(robot_and_ways):
    robot, position, table, ways = robot_and_ways
    assert torch.equal(ways.found, graspable(robot, position, table))
    assert bool(has_posture(robot, position, table)[ways.found].all())
    assert 0.3 < ways.found.float().mean() < 0.9
    if robot.description.name == "PR2":
        assert (ways.pre_grasp[ways.found] > 1).any()  # some are planned


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


def test_few_ways_are_planned_to_an_object_from_the_first_grasp_to_the_first_way(pr2, monkeypatch):
    """If no way is straight, and only some plans lead anywhere."""
    position, table = random_scene(60, seed=21)
    asked = list[tuple[int, int, bool]]()
    look, plan, ways_planned = arm_way.grasps, arm_way._plan_some, arm_way.ways_planned

    def noted(robot, places, key, some, ways):
        plan(robot, places, key, some, ways)
        found = (ways.rank[some.row] == some.rank).tolist()
        asked.extend(zip(some.row.tolist(), some.rank.tolist(), found, strict=True))

    def crooked(*about):
        found = look(*about)
        return replace(found, straight=torch.zeros_like(found.straight))

    def rarely(arm, scene, places, kind, ends, key):
        way, count = ways_planned(arm, scene, places, kind, ends, key)
        return way, torch.where(key % 3 == 0, count, 0)

    monkeypatch.setattr(arm_way, "grasps", crooked)
    monkeypatch.setattr(arm_way, "ways_planned", rarely)
    monkeypatch.setattr(arm_way, "_plan_some", noted)
    found = graspable(pr2, position, table).tolist()
    tried = dict[int, list[bool]]()
    for row in {row for row, *_ in asked}:
        ranks = [rank for each, rank, _ in asked if each == row]
        tried[row] = [good for each, _, good in asked if each == row]
        assert ranks == sorted(set(ranks))
        assert tried[row][:-1] == [False] * (len(ranks) - 1)
        assert tried[row][-1] == found[row]
    assert {row for row in range(60) if found[row]} <= tried.keys()
    assert {len(done) for done in tried.values() if done[-1]} == {1, 2, PLANNED}
    assert max(map(len, tried.values())) == PLANNED


def test_the_margin_is_small_against_an_object():
    assert 0 < MARGIN < OBJECT_RADIUS / 5


def test_no_rows(pr2):
    ways = arm_ways(pr2, torch.zeros(0, 3), torch.zeros(0, 6))
    assert ways.found.shape == (0,)
    assert ways.joints.shape == (0, 1, 7)


def test_random_numbers_are_those_of_the_seed_which_is_nought_by_default(pr2, monkeypatch):
    keys, seeds, nothing = arm_way.row_keys, list[int](), (torch.zeros(0, 3), torch.zeros(0, 6))

    def noted(position, table, seed):
        seeds.append(seed)
        return keys(position, table, seed)

    monkeypatch.setattr(arm_way, "row_keys", noted)
    for answer, wanted in (
        (lambda: arm_ways(pr2, *nothing), {0}), (lambda: arm_ways(pr2, *nothing, 5), {5}),
        (lambda: graspable(pr2, *nothing), {0}),
    ):  # fmt: skip
        seeds.clear()
        answer()
        assert {*seeds} == wanted


def test_there_is_room_for_the_arm_with_most_joints(pr2):
    arm = pr2.arms[1]
    names = "lower", "upper", "continuous", "joint_names"
    short = replace(arm, **{name: getattr(arm, name)[:6] for name in names})
    for arms in ((arm, short), (short, arm)):
        home = tuple(pr2.home[1][: len(each.joint_names)] for each in arms)
        robot = replace(pr2, arms=arms, home=home)
        robot.__dict__["scenes"] = pr2.scenes
        ways = arm_ways(robot, torch.zeros(0, 3), torch.zeros(0, 6))
        assert ways.joints.shape[2] == ways.back.shape[2] == 7
