"""Distances of solids, as checks of ways measure them, against points on their surfaces."""

import math
from unittest.mock import patch

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.tabletop.kinematics import clear_ways, load_robot
from cgtorch.tabletop.kinematics.clear_ways import HELD, LIFT, OWN, TABLE, Places, Scene, ways_clear
from cgtorch.tabletop.kinematics.solids import fixed_solids

TOLERANCE = 2e-5  # m
BALL = (0.0, 0.0, 0.0, 0.0, 0.1)
CYLINDER = (0.0, 0.0, 0.2, 0.1, 0.0)
CAPSULE = (0.0, 0.0, 0.2, 0.0, 0.1)
BOX = (0.1, 0.2, 0.3, 0.0, 0.0)
LEVEL = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]  # z to x
ARM = load_robot().arms[0]


def pose(x=0.0, y=0.0, z=0.0, turn=None):
    made = torch.eye(4, dtype=torch.float64)
    made[:3, 3] = torch.tensor([x, y, z])
    if turn is not None:
        made[:3, :3] = torch.tensor(turn)
    return made


def apart(a, at, b, there, margin):
    """Whether a solid in an arm's hand keeps a distance (m) from another one."""
    q = torch.zeros(1, 1, len(ARM.joint_names), dtype=torch.float64)
    hand = torch.linalg.inv(ARM.frames(q[0])[-1, 0])
    size = torch.tensor([a], dtype=torch.float64).expand(OWN, 5)
    solids = fixed_solids(torch.eye(4, dtype=torch.float64)[:3].expand(OWN, 3, 4), size)
    frame = torch.tensor([-1, -1, len(ARM.chain(q)[1].kind) - 1])
    pairs = torch.tensor([[HELD, TABLE, LIFT]])
    scene = Scene(solids.pose, size, solids.radius, frame, pairs, torch.zeros(1, q.shape[2]))
    other = torch.tensor([b], dtype=torch.float64)
    places = Places(there[None, :3], other, there[None, :3], (hand @ at)[None, :3])
    with patch.object(clear_ways, "MARGIN", margin):
        return bool(ways_clear(ARM, scene.to(q), places, torch.tensor([LIFT]), q))


@pytest.mark.parametrize(
    ("a", "b", "there", "wanted"),
    [
        (BALL, BALL, pose(x=0.5), 0.3),
        (BALL, BOX, pose(x=0.5), 0.3),
        (CYLINDER, CYLINDER, pose(x=0.5), 0.3),
        (CYLINDER, CYLINDER, pose(z=0.5), 0.1),
        (CYLINDER, CAPSULE, pose(z=0.7), 0.2),
        (CYLINDER, BALL, pose(x=0.4, z=0.6), math.hypot(0.3, 0.4) - 0.1),
        (CYLINDER, BOX, pose(x=0.6, turn=LEVEL), 0.2),
        (BOX, BOX, pose(x=0.3, y=0.6, z=1.2), math.sqrt(0.01 + 0.04 + 0.36)),
    ],
)
def test_known_distances(a, b, there, wanted):
    for one, at, other, place in ((a, pose(), b, there), (b, there, a, pose())):
        assert apart(one, at, other, place, wanted - TOLERANCE)
        assert not apart(one, at, other, place, wanted + TOLERANCE)


def test_a_cylinder_ends_where_a_capsule_is_round():
    """A table's edge just beside the rim of the end of a cylinder."""
    corner = pose(x=0.1 + 0.09, z=0.3 + 0.19)
    assert not apart(CYLINDER, pose(), BOX, corner, TOLERANCE)
    assert apart((0.0, 0.0, 0.1, 0.0, 0.1), pose(), BOX, corner, 0.01)


@pytest.mark.parametrize("a", [BALL, CYLINDER, CAPSULE, BOX])
@pytest.mark.parametrize("b", [BALL, CYLINDER, CAPSULE, BOX])
def test_solids_that_meet_are_not_apart(a, b):
    assert not apart(a, pose(), b, pose(x=0.05, y=0.02, z=0.01), TOLERANCE)


def rotation(numbers):
    q, r = np.linalg.qr(np.array(numbers).reshape(3, 3) + 2 * np.eye(3))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def surface(size, count, generator):
    """Points on a solid: a point of the box, of the disc and of the ball, added up."""
    box = generator.uniform(-1, 1, (count, 3))
    side = generator.integers(3, size=count)
    box[np.arange(count), side] = np.sign(box[np.arange(count), side])
    angle, share = generator.uniform(0, math.tau, count), generator.uniform(0, 1, count) ** 0.3
    disc = np.stack([share * np.cos(angle), share * np.sin(angle), 0 * angle], 1)
    way = generator.normal(size=(count, 3))
    ball = way / np.linalg.norm(way, axis=1, keepdims=True)
    return box * size[:3] + size[3] * disc + size[4] * ball


def point_distance(points, size):
    """From points to a box, a cylinder or a capsule about the origin, by their formulas."""
    x, y, z, disc, ball = size
    if disc:
        out = np.hypot(np.maximum(np.hypot(points[:, 0], points[:, 1]) - disc, 0),
                       np.maximum(np.abs(points[:, 2]) - z, 0))  # fmt: skip
    else:
        out = np.linalg.norm(np.maximum(np.abs(points) - (x, y, z), 0), axis=1)
    return out - ball


numbers = st.floats(-1, 1)
solids = st.sampled_from(
    [BALL, CYLINDER, CAPSULE, BOX, (0.1, 0.1, 0.02, 0, 0), (0, 0, 0.01, 0.2, 0)]
)


@given(solids, solids, st.lists(numbers, min_size=9, max_size=9), st.tuples(*[numbers] * 3))
@settings(max_examples=60, deadline=None)
def test_no_sampled_point_is_nearer_and_some_is_as_near(a, b, turn, shift):
    matrix, shift = rotation(turn), np.array(shift)
    points = surface(np.array(a), 4000, np.random.default_rng(0)) @ matrix.T + shift
    nearest, at = point_distance(points, b).min(), pose(*shift, turn=matrix.tolist())
    assert not apart(a, at, b, pose(), max(nearest, 0) + TOLERANCE)
    if nearest > 0.05:
        assert apart(a, at, b, pose(), nearest - 0.05)


def test_the_ball_around_a_solid_holds_it():
    size = torch.tensor([BALL, CYLINDER, CAPSULE, BOX], dtype=torch.float64)
    radius = fixed_solids(pose()[:3].expand(4, 3, 4), size).radius
    for each, most in zip(size.numpy(), radius.tolist(), strict=True):
        points = surface(each, 2000, np.random.default_rng(1))
        assert np.linalg.norm(points, axis=1).max() <= most + 1e-12
