"""Driving the base: straight to its goal, then a turn, as motions are defined.

Wheels are velocity servos. They follow a motion that accelerates and decelerates evenly, and an
outer loop removes the remaining error. Without the ramps, the base ends 2 cm away.
"""

import math

import numpy
from numpy.typing import NDArray

from cgtorch.tabletop.physics.model import TIMESTEP, Model, Watch
from cgtorch.tabletop.physics.scene import Scene, advance, in_contact, put, thing_of

Array = NDArray[numpy.float64]

SPEED, TURN_SPEED = 1.0, 1.5  # m/s, rad/s at most
GATHER, TURN_GATHER = 1.0, 2.0  # m/s², rad/s²
CORRECTION = 5.0  # 1/s by which an error of the pose becomes speed
STEPS = 4  # of the simulation between two commands
REST = 0.3  # s after the motion, until the base stands
ARRIVED = 0.05, 0.05  # m, rad from the goal within which it has been reached


def drive(model: Model, scene: Scene, goal: Array, watch: Watch | None = None) -> Array:
    """Drive the base to a goal (3,) x, y, heading.

    Returned are (11,) its pose, the object's pose, and whether it arrived. It stops, and has not
    arrived, if it touches something.
    """
    d, tick, bumped = put(model, scene), STEPS * TIMESTEP, False
    for reference, speed in motion_to(scene.pose, goal, tick):
        d.ctrl[:] = speed + CORRECTION * (reference - d.qpos[:3])
        advance(model, STEPS, watch)
        bumped = in_contact(model, model.bumping)
        if bumped:
            break
    for _ in range(round(REST / tick)):
        d.ctrl[:] = 0.0 if bumped else CORRECTION * (goal_near(d.qpos[2], goal) - d.qpos[:3])
        advance(model, STEPS, watch)
    pose = numpy.array(d.qpos[:3])
    away = goal_near(pose[2], goal) - pose
    came = not bumped and math.hypot(*away[:2]) < ARRIVED[0] and abs(away[2]) < ARRIVED[1]
    return numpy.array([*pose, *thing_of(model), float(came)])


def goal_near(heading: float, goal: Array) -> Array:
    """The goal with its heading by the shorter way from a heading."""
    turn = (goal[2] - heading + math.pi) % math.tau - math.pi
    return numpy.array([goal[0], goal[1], heading + turn])


def motion_to(pose: Array, goal: Array, tick: float) -> list[tuple[Array, Array]]:
    """Poses (3,) and speeds (3,) at every tick (s), straight to the goal, then turning."""
    goal = goal_near(pose[2], goal)
    there = numpy.array([goal[0], goal[1], pose[2]])
    out: list[tuple[Array, Array]] = []
    for start, end, fast, gather in (
        (pose, there, SPEED, GATHER), (there, goal, TURN_SPEED, TURN_GATHER)
    ):  # fmt: skip
        way = end - start
        length = float(numpy.linalg.norm(way))
        if length >= 1e-9:
            for done, speed in ramp(length, fast, gather, tick):
                out.append((start + way * (done / length), way * (speed / length)))
    return out


def ramp(length: float, fast: float, gather: float, tick: float) -> list[tuple[float, float]]:
    """Distance and speed at every tick, over a given length, from rest to rest."""
    peak = min(fast, math.sqrt(length * gather))
    rise = peak / gather
    total = rise + length / peak
    out = []
    for k in range(1, math.ceil(total / tick) + 1):
        t = min(k * tick, total)
        left = total - t
        if t < rise:
            out.append((gather * t * t / 2, gather * t))
        elif t <= total - rise:
            out.append((peak * (t - rise / 2), peak))
        else:
            out.append((length - gather * left * left / 2, gather * left))
    return out
