"""A grasp lifts the object; servos and joints stay within their limits; failures leave a mess."""

import numpy
import pytest
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.grasp import TICK, Way, grasp, legs
from cgtorch.tabletop.physics.plan import planned, way_of
from cgtorch.tabletop.physics.scene import Scene
from cgtorch.tabletop.physics.timing import timed

SCENE = torch.tensor(
    [[-0.95, 0.0, 0.0, 0, 0, 0, 0.8, 1.2, 0.74, -0.3, 0.1, 0.79, 1, 0, 0, 0, 0.65, 0.1, 0.79]]
)


def scene_and_way(robot: Robot, rows: Tensor) -> tuple[Scene, Way, int]:
    ways = planned(robot, rows)
    assert bool(ways.found[0])
    scene = Scene.of(rows[0, :-3].double().numpy())
    return scene, way_of(robot, ways, 0), int(ways.arm[0])


def test_a_grasp_lifts_within_all_limits(robot: Robot, physics: Physics) -> None:
    scene, way, arm = scene_and_way(robot, SCENE)
    model = physics.model(arm, 0)
    top, strain = 0.0, 0.0
    q = [joint.qpos for joint in model.arm]
    limits = model.model.jnt_range[[model.model.joint(j.name).id for j in model.arm]]
    ends = model.model.jnt_limited[[model.model.joint(j.name).id for j in model.arm]] == 1

    def watch(data: object) -> None:
        nonlocal top, strain
        top = max(top, float(data.qpos[model.thing_qpos + 2]))  # type: ignore[attr-defined]
        force = numpy.abs(data.actuator_force)  # type: ignore[attr-defined]
        strain = max(strain, float((force / model.model.actuator_forcerange[:, 1]).max()))
        posture = data.qpos[q][ends]  # type: ignore[attr-defined]
        assert (posture > limits[ends, 0] - 0.02).all()
        assert (posture < limits[ends, 1] + 0.02).all()
        assert numpy.isfinite(data.qvel).all()  # type: ignore[attr-defined]

    found = grasp(model, scene, way, watch)
    assert found[:2].tolist() == [1, 0]
    assert numpy.array_equal(found[2:], scene.thing), "what was lifted is put back"
    assert top > 0.79 + 0.09
    assert strain <= 1 + 1e-9


def test_an_object_that_is_elsewhere_is_not_lifted(robot: Robot, physics: Physics) -> None:
    """Eight centimetres beside where it is seen, it is missed, or pushed over."""
    scene, way, arm = scene_and_way(robot, SCENE)
    thing = scene.thing + numpy.array([0.0, 0.08, 0, 0, 0, 0, 0])
    moved = Scene(scene.pose, scene.table, thing, scene.obstacles)
    found = grasp(physics.model(arm, 0), moved, way)
    assert found[0] == 0
    assert numpy.isfinite(found).all()
    assert numpy.linalg.norm(found[5:9]) == pytest.approx(1, abs=1e-6)


def test_a_way_through_the_table_is_a_touch(robot: Robot, physics: Physics) -> None:
    scene, way, arm = scene_and_way(robot, SCENE)
    table, thing = scene.table.copy(), scene.thing.copy()
    table[5] += 0.07
    thing[2] += 0.07
    higher = Scene(scene.pose, table, thing, scene.obstacles)
    assert grasp(physics.model(arm, 0), higher, way)[1] == 1


def test_legs_go_all_the_way_and_no_joint_is_too_fast(robot: Robot, physics: Physics) -> None:
    _, way, arm = scene_and_way(robot, SCENE)
    model = physics.model(arm, 0)
    most = numpy.array([model.gains.speed[joint.name] for joint in model.arm])
    every = legs(way, most)
    assert len(every) == way.pre_grasp + 2
    assert numpy.allclose(every[-1][-1], way.joints[way.lifted])
    assert numpy.allclose(every[-2][-1], way.joints[way.grasp])
    for leg in every:
        assert (numpy.abs(numpy.diff(leg, axis=0)) / TICK <= most / 2 + 1e-6).all()


def test_a_way_of_no_length_takes_no_time() -> None:
    still = numpy.ones((3, 2))
    assert len(timed(still, numpy.ones(2), 0.01)) == 1
