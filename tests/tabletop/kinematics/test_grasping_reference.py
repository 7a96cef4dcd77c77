"""has_posture() against a slow reference: one object at a time, other formulas, a finer search.

The reference finds the elbow by geometry instead of algebra, samples the pan angle twice as finely
and lets it change on the way.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from test_grasping import random_scene

from cgtorch.tabletop.kinematics import has_posture
from cgtorch.tabletop.kinematics.clear_ways import POSTURE, ways_clear
from cgtorch.tabletop.kinematics.grasping import APPROACHES, MAX_STEP, places_of

PANS = 72


class Lengths(NamedTuple):
    """Of an arm, from published facts: m, `pan` in the arm's base link, `lift` after the pan."""

    pan: tuple[float, float, float]
    lift: tuple[float, float]
    upper_arm: float
    forearm: float
    tool: float


LENGTHS = {
    "left": Lengths((0, 0.188, 0), (0.1, 0), 0.4, 0.321, 0.18),
    "right": Lengths((0, -0.188, 0), (0.1, 0), 0.4, 0.321, 0.18),
    "arm": Lengths((0.119525, 0, 0.34858), (0.117, 0.06), 0.352, 0.3215, 0.30495),
}
"""The PR2's arms and the Fetch's, by their names."""


def rot_y(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rot_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def rot_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def postures(arm, pose):
    """Every posture within limits at a pose, over the pan grid."""
    lower, upper = arm.lower.numpy(), arm.upper.numpy()
    lengths = LENGTHS[arm.name]
    pan_joint = arm.mount.numpy()[:3, 3] + lengths.pan
    wrist = pose[:3, 3] - lengths.tool * pose[:3, 0]
    found = []
    for pan in np.linspace(lower[0], upper[0], PANS):
        ahead = np.array([math.cos(pan), math.sin(pan), 0])
        shoulder = pan_joint + lengths.lift[0] * ahead + (0, 0, lengths.lift[1])
        way = wrist - shoulder
        # The elbow is in the vertical plane of the pan angle: meet there the circle about the
        # shoulder and the forearm's sphere about the wrist.
        flat, up = way @ ahead, way[2]
        reach = math.hypot(flat, up)
        along = (way @ way + lengths.upper_arm**2 - lengths.forearm**2) / (2 * lengths.upper_arm)
        if reach < 1e-9 or abs(along) > reach:
            continue
        for side, bent, flexed in itertools.product((1, -1), repeat=3):
            pitch = math.atan2(up, flat) + side * math.acos(along / reach)
            lift = -pitch
            direction = math.cos(pitch) * ahead + np.array([0, 0, math.sin(pitch)])
            forearm = (way - lengths.upper_arm * direction) / lengths.forearm
            turned = rot_z(pan) @ rot_y(lift)
            seen = turned.T @ forearm
            flex = bent * math.acos(np.clip(seen[0], -1, 1))
            if flex == 0:
                continue
            roll = math.atan2(seen[1] / math.sin(flex), -seen[2] / math.sin(flex))
            left = (turned @ rot_x(roll) @ rot_y(flex)).T @ pose[:3, :3]
            bend = flexed * math.acos(np.clip(left[0, 0], -1, 1))
            if bend == 0:
                continue
            forearm_roll = math.atan2(left[1, 0] / math.sin(bend), -left[2, 0] / math.sin(bend))
            hand = (rot_x(forearm_roll) @ rot_y(bend)).T @ left
            q = [pan, lift, roll, flex, forearm_roll, bend, math.atan2(hand[2, 1], hand[1, 1])]
            for i in (1, 2):
                q[i] += math.tau * round(((lower[i] + upper[i]) / 2 - q[i]) / math.tau)
            if all(lower[i] <= q[i] <= upper[i] for i in range(7)):
                found.append(q)
    return np.array(found).reshape(-1, 7)


def free(robot, arm, q, place):
    """(M,) whether postures are clear of a table and the body."""
    scene, rows = robot.scenes[robot.arms.index(arm)], torch.zeros(len(q), dtype=torch.long)
    kind = torch.full((len(q),), POSTURE)
    return ways_clear(arm, scene, place[rows], kind, torch.tensor(q)[:, None]).numpy()


def linked(arm, first, second):
    """(M, N) whether a posture can step to another."""
    away = first[:, None] - second[None]
    away[..., arm.continuous.numpy()] = (away[..., arm.continuous.numpy()] + math.pi) % math.tau
    away[..., arm.continuous.numpy()] -= math.pi
    return (np.abs(away) < MAX_STEP).all(axis=-1)


def tool_pose(position, steepness, side):
    heading = math.atan2(position[1], position[0]) + side
    return rot_z(heading) @ rot_y(steepness)


def can_grasp(robot, position, table):
    corners = footprint_corners(robot)
    if overlap(corners, table):
        return False
    place = places_of(*(torch.tensor(x)[None] for x in (position, table)))
    for arm in robot.arms:
        for steepness, side in APPROACHES:
            pose = np.eye(4)
            pose[:3, :3] = tool_pose(position, steepness, side)
            grasp = position + np.array([0, 0, 0.05])

            def at(point, pose=pose, arm=arm):
                pose = pose.copy()
                pose[:3, 3] = point
                q = postures(arm, pose)
                return q[free(robot, arm, q, place)]

            middle = at(grasp)
            kept = np.ones(len(middle), dtype=bool)
            for way in (-pose[:3, 0], np.array([0, 0, 1.0])):
                if not kept.any():
                    break
                reach = np.eye(len(middle), dtype=bool)
                here = middle
                for step in (0.05, 0.10):
                    there = at(grasp + step * way)
                    if not len(there):
                        kept[:] = False
                        break
                    reach = (reach @ linked(arm, here, there)).astype(bool)
                    here = there
                else:
                    kept &= reach.any(axis=1)
            if kept.any():
                return True
    return False


def footprint_corners(robot):
    x_min, x_max, y_min, y_max = robot.description.footprint
    return np.array([(x, y) for x in (x_min, x_max) for y in (y_min, y_max)])


def overlap(corners, table):
    """Whether the footprint and the table overlap, by projecting corners on every side's normal."""
    x, y, yaw, long, wide, _ = table
    c, s = math.cos(yaw), math.sin(yaw)
    other = np.array(
        [
            (x + c * u - s * v, y + s * u + c * v)
            for u in (-long / 2, long / 2)
            for v in (-wide / 2, wide / 2)
        ]
    )
    for axis in ((1, 0), (0, 1), (c, s), (-s, c)):
        one, two = corners @ axis, other @ axis
        if one.max() <= two.min() or two.max() <= one.min():
            return False
    return True


@pytest.mark.parametrize(("name", "count"), [("pr2", 60), ("fetch", 40)])
def test_labels_agree_with_the_reference(request, name, count):
    robot = request.getfixturevalue(name)
    position, table = random_scene(count, seed=11)
    labels = has_posture(robot, position, table).tolist()
    reference = [
        can_grasp(robot, p, t)
        for p, t in zip(position.double().numpy(), table.double().numpy(), strict=True)
    ]
    assert 0.2 * count <= sum(reference) <= 0.8 * count
    agreed = sum(a == b for a, b in zip(labels, reference, strict=True))
    assert agreed >= 0.97 * count
