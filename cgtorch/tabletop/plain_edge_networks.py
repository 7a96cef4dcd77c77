"""The networks of `cgtorch.tabletop.edge_networks`, one percept at a time, in plain Python."""

import math
from typing import NamedTuple

from cgtorch.export.plain.networks import BranchingNN, ContinuousNN


class Frame(NamedTuple):
    """The frame of the edge nearest to the object, in the robot's base frame.

    Origin at the object (m), x axis at `yaw` (rad) into the table, y to the right of it where
    `mirror` is -1; `extent` from the object to the nearest edge, the one opposite, and the ends of
    the table at positive and at negative y (m).
    """

    origin: tuple[float, float]
    yaw: float
    mirror: float
    extent: tuple[float, float, float, float]


class EdgeNN(ContinuousNN):
    """From the scene to a pose to stand at, both in the edge's frame; sent as a motion to there."""

    def sees(self, percept: list[float]) -> list[float]:
        """The scene without obstacles."""
        return table_scene(edge_frame(percept), percept)

    def motion(self, percept: list[float]) -> list[float]:
        """The motion dx, dy (m), dθ (rad) to the pose."""
        frame = edge_frame(percept)
        x, y, heading = self.output(percept)
        dx, dy = turned((x, y * frame.mirror), frame.yaw)
        turn = wrapped(frame.yaw + heading * frame.mirror)
        return [frame.origin[0] + dx, frame.origin[1] + dy, turn]


class EdgeBranchingNN(BranchingNN):
    """From the scene in the edge's frame to one of two branches."""

    def sees(self, percept: list[float]) -> list[float]:
        """The scene, obstacles too."""
        frame = edge_frame(percept)
        return table_scene(frame, percept) + obstacles(frame, percept)


def edge_frame(percept: list[float]) -> Frame:
    """The frame of the edge nearest to the object."""
    cx, cy, yaw, size_x, size_y = table(percept)
    placed = percept[4], percept[5]
    x, y = turned((placed[0] - cx, placed[1] - cy), -yaw)
    # Edges at -x, -y, +x, +y of the table: a quarter turn from each to the next.
    gaps = [size_x / 2 + x, size_y / 2 + y, size_x / 2 - x, size_y / 2 - y]
    nearest = min(range(4), key=gaps.__getitem__)
    front, right, back, left = (gaps[(nearest + k) % 4] for k in range(4))
    yaw = wrapped(yaw + math.pi / 2 * nearest)
    _, robot = turned((-placed[0], -placed[1]), -yaw)
    if robot < 0:
        return Frame(placed, yaw, -1.0, (front, back, right, left))
    return Frame(placed, yaw, 1.0, (front, back, left, right))


def table(percept: list[float]) -> tuple[float, float, float, float, float]:
    """The table as centre x, y (m), yaw (rad) and sizes (m)."""
    x0, x1, y0, y1 = percept[:4]
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    width, height = x1 - x0, y1 - y0
    if (len(percept) - 7) % 4 == 0:  # a percept without the side that tells the yaw
        return cx, cy, 0.0, width, height
    length, yaw = math.hypot(*percept[7:9]), math.atan2(percept[8], percept[7]) / 2
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    other = s * (width - length * c) + c * (height - length * s)
    return cx, cy, yaw, length, max(other, 0.0)


def table_scene(frame: Frame, percept: list[float]) -> list[float]:
    """The robot's x, y (m), cosine and sine of its heading, the extents, the object's height."""
    heading = -frame.mirror * frame.yaw
    robot = into(frame, (0.0, 0.0))
    return [*robot, math.cos(heading), math.sin(heading), *frame.extent, percept[6]]


def obstacles(frame: Frame, percept: list[float]) -> list[float]:
    """Of each obstacle its centre's x and y and half its mean side (m)."""
    seen: list[float] = []
    for i in range(9 if (len(percept) - 7) % 4 else 7, len(percept), 4):
        x0, x1, y0, y1 = percept[i : i + 4]
        if any((x0, x1, y0, y1)):
            centre = into(frame, ((x0 + x1) / 2, (y0 + y1) / 2))
            seen += [*centre, (x1 - x0 + y1 - y0) / 4]
        else:
            seen += [-3.0, 0.0, 0.0]  # what is not there is said to be far behind the edge
    return seen


def into(frame: Frame, point: tuple[float, float]) -> tuple[float, float]:
    """A point of the base frame in the edge's frame."""
    x, y = turned((point[0] - frame.origin[0], point[1] - frame.origin[1]), -frame.yaw)
    return x, y * frame.mirror


def turned(point: tuple[float, float], angle: float) -> tuple[float, float]:
    """A point turned about the origin."""
    c, s = math.cos(angle), math.sin(angle)
    return c * point[0] - s * point[1], s * point[0] + c * point[1]


def wrapped(angle: float) -> float:
    """The same angle within [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
