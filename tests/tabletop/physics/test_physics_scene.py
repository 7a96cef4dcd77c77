"""Scenes in a model: what is put where, at rest, and what touches."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.grasping import TABLE_THICKNESS
from cgtorch.tabletop.physics import Thing
from cgtorch.tabletop.physics.grasp import ACCELERATE, SMOOTH, Hand, timed
from cgtorch.tabletop.physics.model import Model, build
from cgtorch.tabletop.physics.scene import (
    AWAY,
    BLOCK,
    Scene,
    advance,
    in_contact,
    put,
    thing_of,
)

POSE, TABLE = [-1.5, 0.2, 0.3], [0.1, 0.2, math.pi / 2, 0.8, 1.2, 0.74]
THING = [-0.1, 0.2, 0.79, 1.0, 0.0, 0.0, 0.0]
BOXES = [1.0, 2.0, 0.0, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def model(robot: Robot) -> Model:
    return build(robot, 0, 2, Thing())


@pytest.fixture
def scene() -> Scene:
    return Scene.of(np.array([*POSE, *TABLE, *THING, *BOXES]))


def test_everything_is_at_rest_where_the_scene_says(model: Model, scene: Scene) -> None:
    model.data.qpos[:], model.data.qvel[:], model.data.time = 9.0, 9.0, 9.0
    d, m = put(model, scene), model.model
    assert d is model.data
    assert d.time == 0
    assert not d.qvel.any()
    assert d.qpos[:3].tolist() == POSE
    for joint in (*model.arm, *model.fingers):
        assert d.qpos[joint.qpos] == d.ctrl[joint.ctrl] == joint.open
    for at, value in model.begins:
        assert d.qpos[at] == value
    assert thing_of(model).tolist() == THING
    slab, block, box, absent = model.boxes
    top, turned = TABLE[5], [math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4)]
    for (body, mocap, geom), size, place, turn in (
        (slab, [0.8, 1.2, TABLE_THICKNESS], [0.1, 0.2, top - TABLE_THICKNESS / 2], turned),
        (block, [0.8, 1.2, BLOCK], [0.1, 0.2, BLOCK / 2], turned),
        (box, [0.3, 0.4, BLOCK], [1.0, 2.0, BLOCK / 2], [1, 0, 0, 0]),
        (absent, [0.02] * 3, [0.0, 0.0, -AWAY], [1, 0, 0, 0]),
    ):
        half = np.array(size) / 2
        assert m.geom_size[geom] == pytest.approx(half)
        assert m.geom_rbound[geom] == pytest.approx(np.linalg.norm(half))
        assert m.geom_aabb[geom, 3:] == pytest.approx(half)
        assert m.bvh_aabb[m.body_bvhadr[body], 3:] == pytest.approx(half)
        assert d.mocap_pos[mocap] == pytest.approx(place)
        assert d.mocap_quat[mocap] == pytest.approx(turn)
        assert d.xpos[body] == pytest.approx(place)  # as kinematics have been computed


def test_time_goes_on_and_is_watched(model: Model, scene: Scene) -> None:
    seen = list[float]()
    put(model, scene)
    advance(model, 3, lambda given: seen.append(given.data.time))
    advance(model, 1)
    step = model.model.opt.timestep
    assert seen == [pytest.approx(3 * step)]
    assert model.data.time == pytest.approx(4 * step)
    kept = thing_of(model)
    model.data.qpos[model.thing_qpos] += 1.0
    assert thing_of(model)[0] == kept[0] + 1.0  # and what was told before stays
    assert kept[0] == pytest.approx(THING[0], abs=0.01)


def test_only_what_presses_is_in_contact() -> None:
    kinds = np.zeros((3, 3), bool)
    kinds[0, 1] = True

    def touches(geom: list[list[int]], dist: list[float]) -> bool:
        contact = SimpleNamespace(geom=np.array(geom).reshape(-1, 2), dist=np.array(dist))
        given: Any = SimpleNamespace(data=SimpleNamespace(contact=contact))
        return in_contact(given, kinds)

    assert not touches([], [])
    assert touches([[1, 2], [0, 1]], [-0.1, -0.1])
    assert not touches([[1, 2], [0, 1]], [-0.1, 0.0])
    assert not touches([[1, 2]], [-0.1])


def test_a_way_takes_the_time_of_its_slowest_joint_and_begins_and_ends_at_rest() -> None:
    way = np.array([[0.0, 0.0], [1.0, 0.5], [1.0, 2.0]])
    rows = timed(way, np.array([1.0, 0.5]), 0.01)
    spent = 1.0 + 3.0
    assert len(rows) == round((spent + ACCELERATE + SMOOTH) / 0.01)
    assert rows[-1].tolist() == [1.0, 2.0]
    speed = np.abs(np.diff(rows, axis=0)) / 0.01
    assert (speed.max(0) <= np.array([1.0, 0.5]) + 1e-9).all()
    assert speed.max(0) == pytest.approx([1.0, 0.5])
    assert speed[0].max() < 0.1
    assert speed[-1].max() < 0.1
    backward = timed(way[::-1], np.array([1.0, 0.5]), 0.01)
    assert backward[-1].tolist() == [0.0, 0.0]
    middle = rows[len(rows) // 4]
    assert middle[1] == pytest.approx(middle[0] / 2, abs=0.02)
    short = timed(np.array([[0.0], [0.01]]), np.array([1.0]), 0.01)
    assert short[-1].tolist() == [0.01]
    assert len(short) == 2 + round(SMOOTH / 0.01)


def test_a_hand_leads_its_servos_by_their_lag_and_opens_and_closes(
    model: Model, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(model, scene)
    sent, commands = list[Any](), [joint.ctrl for joint in model.arm]
    monkeypatch.setattr(
        "cgtorch.tabletop.physics.grasp.advance",
        lambda given, steps, watch: sent.append((steps, model.data.ctrl[commands].copy())),
    )
    hand = Hand(model, np.array([-1.5, 0.25, 0.3]), None)
    home = np.array([joint.open for joint in model.arm])
    rows = home + np.array([[0.0], [0.01], [0.02]])
    hand.follow(rows)
    lag = np.array([joint.lag for joint in model.arm])
    assert [steps for steps, _ in sent] == [2] * 3
    for (_, ctrl), row in zip(sent, rows, strict=True):
        assert ctrl == pytest.approx(row + lag * 1.0)  # rad/s, at ticks of 10 ms
    assert model.data.ctrl[:3].tolist() == pytest.approx([0.0, 5.0 * 0.05, 0.0])
    assert hand.touched is False
    hand.wait(home, 0.1)
    assert len(sent) == 3 + 10
    assert sent[-1][1] == pytest.approx(home)
    hand.follow(home[None])
    assert sent[-1][1] == pytest.approx(home)
    for closed in (True, False):
        hand.close(closed)
        for finger in model.fingers:
            wanted = finger.closed if closed else finger.open
            assert model.data.ctrl[finger.ctrl] == wanted
    monkeypatch.setattr("cgtorch.tabletop.physics.grasp.in_contact", lambda given, kinds: True)
    hand.follow(home[None])
    assert hand.touched is True
    monkeypatch.setattr("cgtorch.tabletop.physics.grasp.in_contact", lambda given, kinds: False)
    hand.follow(home[None])
    assert hand.touched is True
