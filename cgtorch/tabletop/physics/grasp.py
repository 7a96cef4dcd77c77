"""An arm grasps the object: it follows its way, closes the fingers, lifts and holds."""

from dataclasses import dataclass
from itertools import pairwise

import numpy
import torch
from numpy.typing import NDArray
from torch import Tensor

from cgtorch.tabletop.kinematics import ArmWay, Robot, arm_ways
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT
from cgtorch.tabletop.physics.drive import CORRECTION
from cgtorch.tabletop.physics.model import TIMESTEP, Model, Watch
from cgtorch.tabletop.physics.scene import Scene, advance, in_contact, put, thing_of
from cgtorch.tabletop.world.geometry import rectangle_in_frame

Array = NDArray[numpy.float64]

STEPS = 2  # of the simulation between two commands
TICK = STEPS * TIMESTEP  # s
SWIFT, SLOW = 0.5, 0.2  # of the joints' greatest speeds, in the open and along the line
CLOSING, HOLDING, RESTING = 0.5, 0.5, 0.5  # s
LIFTED = 0.05  # m above where it stood
ACCELERATE = 0.3  # s to full speed, and from it to rest
SMOOTH = 0.1  # s over which corners of the way are rounded
SEEN = 3
"""Numbers at the end of a row: the perceived centre of the object, in the base frame (m)."""


@dataclass(frozen=True)
class Way:
    """The way of an arm: (W, n) postures from home, rad or m, and the indices of three of them.

    Before `pre_grasp` it is free in space; after it, the tool stays on its line.
    """

    joints: Array
    pre_grasp: int
    grasp: int
    lifted: int


def planned(robot: Robot, rows: Tensor) -> ArmWay:
    """The ways of an arm to objects; rows (n, ...) begin with pose and table, and end with `SEEN`.

    A grasp is planned for an object's centre at `GRASP_HEIGHT` above its support, where the last
    percept has it. The table is known exactly, as from a robot's own segmentation.
    """
    pose, table, seen = rows[:, :3], rows[:, 3:9], rows[:, -SEEN:]
    here = torch.cat([rectangle_in_frame(pose, table[:, :5]), table[:, 5:6]], 1)
    foot = seen - seen.new_tensor([0.0, 0.0, GRASP_HEIGHT])
    return arm_ways(robot, foot, here)


def way_of(robot: Robot, ways: ArmWay, row: int) -> Way:
    """The way of one row."""
    joints = len(robot.arms[int(ways.arm[row])].joint_names)
    lifted = int(ways.lifted[row])
    postures: Array = ways.joints[row, : lifted + 1, :joints].double().numpy()
    return Way(postures, int(ways.pre_grasp[row]), int(ways.grasp[row]), lifted)


@dataclass
class Hand:
    """Sends commands to the servos, and records whether the arm touched anything."""

    model: Model
    pose: Array
    watch: Watch | None
    touched: bool = False

    def follow(self, rows: Array) -> None:
        """Move the arm through postures (T, n), one per tick."""
        model, d = self.model, self.model.data
        lag = numpy.array([joint.lag for joint in model.arm])
        where = [joint.ctrl for joint in model.arm]
        # Damping holds a servo back behind a moving target.
        speed = numpy.gradient(rows, TICK, axis=0) if len(rows) > 1 else numpy.zeros_like(rows)
        for row in rows + lag * speed:
            d.ctrl[where] = row
            d.ctrl[:3] = CORRECTION * (self.pose - d.qpos[:3])
            advance(model, STEPS, self.watch)
            self.touched = self.touched or in_contact(model, model.touching)

    def wait(self, posture: Array, seconds: float) -> None:
        """Hold a posture (n,)."""
        self.follow(numpy.repeat(posture[None], round(seconds / TICK), 0))

    def close(self, closed: bool) -> None:
        """Close or open the fingers."""
        for finger in self.model.fingers:
            self.model.data.ctrl[finger.ctrl] = finger.closed if closed else finger.open


def grasp(model: Model, scene: Scene, way: Way, watch: Watch | None = None) -> Array:
    """Grasp the object: (9,) whether it was lifted, whether the arm touched anything, its pose (7).

    The arm of the model begins at home. A lifted object is put back where it was. Otherwise the arm
    goes home again, and the object stays wherever it is.
    """
    put(model, scene)
    *there, up = every = legs(way, numpy.array([joint.speed for joint in model.arm]))
    hand = Hand(model, scene.pose, watch)
    for leg in there:
        hand.follow(leg)
    hand.wait(way.joints[way.grasp], 0.1)
    hand.close(True)
    hand.wait(way.joints[way.grasp], CLOSING)
    hand.follow(up)
    hand.wait(way.joints[way.lifted], HOLDING)
    touched = float(hand.touched)
    if thing_of(model)[2] - scene.thing[2] >= LIFTED:
        return numpy.array([1.0, touched, *scene.thing])
    hand.close(False)
    hand.wait(way.joints[way.lifted], RESTING)
    for leg in reversed(every):
        hand.follow(leg[::-1])
    hand.wait(way.joints[0], RESTING)
    return numpy.array([0.0, touched, *thing_of(model)])


def legs(way: Way, most: Array) -> list[Array]:
    """Postures (T, n) at every tick of each part of the way, from rest to rest.

    The arm stops at every waypoint of the free way, at the grasp, and after the lift. No joint is
    faster than a share of `most` (n,), rad/s or m/s.
    """
    stops = [*range(way.pre_grasp + 1), way.grasp, way.lifted]
    return [
        timed(way.joints[start : end + 1], (SWIFT if end <= way.pre_grasp else SLOW) * most, TICK)
        for start, end in pairwise(stops)
    ]


def timed(way: Array, speed: Array, tick: float) -> Array:
    """Postures (T, n) at every tick (s) of a way (W, n), from rest to rest, corners rounded.

    No joint is faster than its `speed` (n,), rad/s or m/s, on any part of the way.
    """
    steps = numpy.abs(numpy.diff(way, axis=0))
    spent = numpy.concatenate([[0.0], numpy.cumsum((steps / speed).max(1, initial=0.0))])
    total = float(spent[-1])
    if total <= 0:
        return way[-1:]
    rise = min(ACCELERATE, total)
    lasts = total + rise
    when = numpy.minimum(numpy.arange(1, int(numpy.ceil(lasts / tick)) + 1) * tick, lasts)
    done = numpy.where(when < rise, when**2 / (2 * rise), when - rise / 2)
    late = when > lasts - rise
    done = numpy.where(late, total - (lasts - when) ** 2 / (2 * rise), done)
    rows = numpy.stack([numpy.interp(done, spent, column) for column in way.T], 1)
    window = round(SMOOTH / tick)
    first, last = (numpy.repeat(way[k][None], window, 0) for k in (0, -1))
    total_to = numpy.cumsum(numpy.concatenate([first, rows, last]), 0)
    mean: Array = (total_to[window:] - total_to[:-window]) / window
    mean[-1] = way[-1]
    return mean
