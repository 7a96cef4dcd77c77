"""Scenes in a model: where robot, table, boxes and object are, and what touches."""

import math
from dataclasses import dataclass
from typing import Any

import numpy
from numpy.typing import NDArray

from cgtorch.tabletop.kinematics.grasping import TABLE_THICKNESS
from cgtorch.tabletop.physics.model import Model, Watch, mujoco

Array = NDArray[numpy.float64]

BLOCK = 0.40  # m that the table is closed from the floor up, and that obstacles are high
AWAY = 50.0  # m below the floor, where an obstacle that is not there is


@dataclass(frozen=True)
class Scene:
    """The initial state of a simulation.

    Attributes:
        pose: (3,) base x, y (m), heading (rad).
        table: (6,) centre x, centre y (m), yaw (rad), size x, size y, height of the top (m).
        thing: (7,) position of the object's centre (m) and its quaternion, w first.
        obstacles: (K, 5) boxes on the floor; one of size 0 is absent.
    """

    pose: Array
    table: Array
    thing: Array
    obstacles: Array

    @classmethod
    def of(cls, row: Array) -> "Scene":
        """The scene of a row of 16 + 5 K numbers."""
        return cls(row[:3], row[3:9], row[9:16], row[16:].reshape(-1, 5))


def put(model: Model, scene: Scene) -> Any:
    """The model's data, reset to rest in a scene: arms at home, grippers open."""
    mj, m, d = mujoco(), model.model, model.data
    mj.mj_resetData(m, d)
    *place, top = scene.table
    boxes = [(*place, top - TABLE_THICKNESS, top), (*place, 0, BLOCK)]
    boxes += [(*box, 0.0, BLOCK) for box in scene.obstacles]
    for part, box in zip(model.boxes, boxes, strict=True):
        _resize(m, d, part, box)
    d.qpos[:3] = scene.pose
    for joint in (*model.arm, *model.fingers):
        d.qpos[joint.qpos] = d.ctrl[joint.ctrl] = joint.open
    for at, value in model.begins:
        d.qpos[at] = value
    d.qpos[model.thing_qpos : model.thing_qpos + 7] = scene.thing
    mj.mj_forward(m, d)
    return d


def _resize(m: Any, d: Any, part: tuple[int, int, int], box: tuple[float, ...]) -> None:
    """Write a box (x, y, yaw, size x, size y, from z, to z) into model and data."""
    body, mocap, geom = part
    x, y, yaw, length, width, low, high = box
    there = length > 0 and width > 0
    half = numpy.array([length, width, high - low]) / 2 if there else numpy.full(3, 0.01)
    m.geom_size[geom], m.geom_rbound[geom] = half, math.sqrt(float(half @ half))
    m.geom_aabb[geom, 3:] = m.bvh_aabb[m.body_bvhadr[body], 3:] = half
    d.mocap_pos[mocap] = [x, y, (low + high) / 2 if there else -AWAY]
    d.mocap_quat[mocap] = [math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]


def advance(model: Model, steps: int, watch: Watch | None = None) -> None:
    """Simulate some steps under the present commands."""
    mujoco().mj_step(model.model, model.data, steps)
    if watch is not None:
        watch(model)


def thing_of(model: Model) -> Array:
    """(7,) the present pose of the object."""
    at = model.thing_qpos
    return numpy.array(model.data.qpos[at : at + 7])


def in_contact(model: Model, kinds: NDArray[numpy.bool_]) -> bool:
    """Whether two geoms of the given kinds (G, G) are in contact."""
    contact = model.data.contact
    if not len(contact.dist):
        return False
    first, second = contact.geom.T
    return bool((kinds[first, second] & (contact.dist < 0)).any())
