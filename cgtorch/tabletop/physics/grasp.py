"""An arm grasps the object: it follows its way, closes the fingers, lifts and holds."""

from dataclasses import dataclass
from itertools import pairwise

import numpy
from numpy.typing import NDArray

from cgtorch.tabletop.physics.drive import CORRECTION, Watch
from cgtorch.tabletop.physics.engine import mujoco
from cgtorch.tabletop.physics.model import TIMESTEP, Model
from cgtorch.tabletop.physics.scene import Scene, in_contact, put, thing_of
from cgtorch.tabletop.physics.timing import timed

Array = NDArray[numpy.float64]

STEPS = 2  # of the simulation between two commands
TICK = STEPS * TIMESTEP  # s
SWIFT, SLOW = 0.5, 0.2  # of the joints' greatest speeds, in the open and along the line
CLOSING, HOLDING, RESTING = 0.5, 0.5, 0.5  # s
LIFTED = 0.05  # m above where it stood


@dataclass(frozen=True)
class Way:
    """The way of an arm: (W, n) postures from home, rad or m, and the indices of three of them.

    Before `pre_grasp` it is free in space; after it, the tool stays on its line.
    """

    joints: Array
    pre_grasp: int
    grasp: int
    lifted: int

    @classmethod
    def of(cls, row: Array, joints: int) -> "Way":
        """The way of a row: three indices, then postures of `joints` joints."""
        pre_grasp, grasp, lifted = (int(x) for x in row[:3])
        return cls(row[3:].reshape(-1, joints)[: lifted + 1], pre_grasp, grasp, lifted)


@dataclass
class Hand:
    """Sends commands to the servos, and records whether the arm touched anything."""

    model: Model
    pose: Array
    watch: Watch | None
    touched: bool = False

    def follow(self, rows: Array) -> None:
        """Move the arm through postures (T, n), one per tick."""
        mj, m, d = mujoco(), self.model.model, self.model.data
        lag = numpy.array([joint.lag for joint in self.model.arm])
        where = [joint.ctrl for joint in self.model.arm]
        # What damps a servo would hold it back behind a target that moves.
        speed = numpy.gradient(rows, TICK, axis=0) if len(rows) > 1 else numpy.zeros_like(rows)
        for row in rows + lag * speed:
            d.ctrl[where] = row
            d.ctrl[:3] = CORRECTION * (self.pose - d.qpos[:3])
            mj.mj_step(m, d, STEPS)
            self.touched = self.touched or in_contact(self.model, self.model.touching)
            if self.watch is not None:
                self.watch(d)

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
    every = legs(way, numpy.array([model.gains.speed[joint.name] for joint in model.arm]))
    hand = Hand(model, scene.pose, watch)
    there, lift = way.joints[way.grasp], way.joints[way.lifted]
    for leg in every[:-1]:
        hand.follow(leg)
    hand.wait(there, 0.1)
    hand.close(True)
    hand.wait(there, CLOSING)
    hand.follow(every[-1])
    hand.wait(lift, HOLDING)
    touched = hand.touched
    if thing_of(model)[2] - scene.thing[2] >= LIFTED:
        return numpy.array([1.0, float(touched), *scene.thing])
    hand.close(False)
    hand.wait(lift, RESTING)
    for leg in reversed(every):
        hand.follow(leg[::-1])
    hand.wait(way.joints[0], RESTING)
    return numpy.array([0.0, float(touched), *thing_of(model)])


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
