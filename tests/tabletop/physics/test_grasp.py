"""A grasp lifts the object; servos and joints stay within their limits; failures leave a mess."""

from dataclasses import replace

import numpy
import pytest
import torch

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.grasp import (
    CLOSING,
    HOLDING,
    RESTING,
    SLOW,
    SWIFT,
    TICK,
    Way,
    grasp,
    legs,
    planned,
    timed,
    way_of,
)
from cgtorch.tabletop.physics.model import Model
from cgtorch.tabletop.physics.scene import Scene

ROWS = torch.tensor(
    [[-0.95, 0.0, 0.0, 0, 0, 0, 0.8, 1.2, 0.74, -0.3, 0.1, 0.79, 1, 0, 0, 0, 0.65, 0.1, 0.79]]
)
SCENE = Scene.of(ROWS[0, :-3].double().numpy())


@pytest.fixture(scope="module")
def planned_way(robot: Robot, physics: Physics) -> tuple[Model, Way]:
    """The model of the arm that can grasp, and its way."""
    ways = planned(robot, ROWS)
    assert bool(ways.found[0])
    return physics.model(int(ways.arm[0]), 0), way_of(robot, ways, 0)


Sent = tuple[list[float], bool]


def sent_to(model: Model) -> Sent:
    """The commands to the arm, and whether its fingers are told to close."""
    ctrl = model.data.ctrl
    closed = {bool(ctrl[finger.ctrl] == finger.closed) for finger in model.fingers}
    assert len(closed) == 1
    return ctrl[[joint.ctrl for joint in model.arm]].tolist(), closed.pop()


def parts_of(model: Model, way: Way) -> tuple[int, ...]:
    """How many commands lead to the grasp, wait there, close, lift and hold."""
    *there, up = legs(way, numpy.array([joint.speed for joint in model.arm]))
    waits, closes, holds = (round(seconds / TICK) for seconds in (0.1, CLOSING, HOLDING))
    return sum(map(len, there)), waits, closes, len(up), holds


def test_a_grasp_lifts_within_all_limits(planned_way: tuple[Model, Way]) -> None:
    model, way = planned_way
    top, strain, sent = [0.0], [0.0], list[Sent]()
    q = [joint.qpos for joint in model.arm]
    joints = [model.model.joint(joint.name).id for joint in model.arm]
    ends = model.model.jnt_limited[joints] == 1
    low, high = model.model.jnt_range[joints][ends].T

    def watch(seen: Model) -> None:
        data = seen.data
        sent.append(sent_to(seen))
        top.append(float(data.qpos[model.thing_qpos + 2]))
        force = numpy.abs(data.actuator_force) / model.model.actuator_forcerange[:, 1]
        strain.append(float(force.max()))
        assert ((data.qpos[q][ends] > low - 0.02) & (data.qpos[q][ends] < high + 0.02)).all()
        assert numpy.isfinite(data.qvel).all()

    found = grasp(model, SCENE, way, watch)
    assert found[:2].tolist() == [1, 0]
    there, waits, closes, up, holds = parts_of(model, way)
    assert len(sent) == there + waits + closes + up + holds
    assert {closed for _, closed in sent[: there + waits]} == {False}
    assert {closed for _, closed in sent[there + waits :]} == {True}
    for command, _ in sent[there : there + waits + closes]:
        assert command == pytest.approx(way.joints[way.grasp])
    for command, _ in sent[-holds:]:
        assert command == pytest.approx(way.joints[way.lifted])
    assert numpy.array_equal(found[2:], SCENE.thing), "what was lifted is put back"
    assert max(top) > 0.79 + 0.09
    assert max(strain) <= 1 + 1e-9


def test_an_object_that_is_elsewhere_is_not_lifted(planned_way: tuple[Model, Way]) -> None:
    """Eight centimetres beside where it is seen, it is missed, or pushed over."""
    thing = SCENE.thing + numpy.array([0.0, 0.08, 0, 0, 0, 0, 0])
    model, way = planned_way
    sent = list[Sent]()
    found = grasp(model, replace(SCENE, thing=thing), way, lambda seen: sent.append(sent_to(seen)))
    assert found[0] == 0
    parts = parts_of(model, way)
    every = legs(way, numpy.array([joint.speed for joint in model.arm]))
    back = round(RESTING / TICK), sum(map(len, every)), round(RESTING / TICK)
    assert len(sent) == sum(parts) + sum(back)
    opens = sum(parts)
    assert {closed for _, closed in sent[opens:]} == {False}
    assert sent[opens][0] == pytest.approx(way.joints[way.lifted])
    assert sent[opens + back[0] - 1][0] == pytest.approx(way.joints[way.lifted])
    assert sent[-1][0] == sent[-back[2]][0] == pytest.approx(way.joints[0])
    assert numpy.isfinite(found).all()
    assert numpy.linalg.norm(found[5:9]) == pytest.approx(1, abs=1e-6)


def test_a_way_through_the_table_is_a_touch(planned_way: tuple[Model, Way]) -> None:
    table, thing = SCENE.table.copy(), SCENE.thing.copy()
    table[5] += 0.07
    thing[2] += 0.07
    higher = replace(SCENE, table=table, thing=thing)
    assert grasp(planned_way[0], higher, planned_way[1])[1] == 1


def test_legs_go_all_the_way_and_no_joint_is_too_fast(planned_way: tuple[Model, Way]) -> None:
    model, way = planned_way
    most = numpy.array([joint.speed for joint in model.arm])
    every = legs(way, most)
    assert len(every) == way.pre_grasp + 2
    assert numpy.allclose(every[-1][-1], way.joints[way.lifted])
    assert numpy.allclose(every[-2][-1], way.joints[way.grasp])
    for leg in every:
        assert (numpy.abs(numpy.diff(leg, axis=0)) / TICK <= most / 2 + 1e-6).all()
    shares = [float((numpy.abs(numpy.diff(leg, axis=0)) / TICK / most).max()) for leg in every]
    assert shares[:-2] == pytest.approx([SWIFT] * way.pre_grasp, rel=0.1)
    assert 0.1 * SLOW < max(shares[-2:]) <= SLOW + 1e-6
    assert len(timed(numpy.ones((3, 2)), numpy.ones(2), 0.01)) == 1, "no length takes no time"
