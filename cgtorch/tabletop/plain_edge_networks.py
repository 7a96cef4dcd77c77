"""The networks of `cgtorch.tabletop.edge_networks` for one percept at a time, in plain Python."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from cgtorch.export.plain import BranchingNN, ContinuousNN

Box = tuple[float, float, float, float]
Rectangle = tuple[float, float, float, float, float]  # centre x, y (m), yaw (rad), sizes (m)
Point = tuple[float, float]

CLEARANCE = 0.02  # m that MoveBase keeps from things
VIAS, LONGEST, ROOM, AWAY, WORTH_TURNING = (
    3,
    1.9,
    1.05,
    0.05,
    0.001,
)  # see cgtorch.tabletop.world.routes
TURN_STEPS = 12


class Frame(NamedTuple):
    """The frame of the edge nearest to the object, in the robot's base frame.

    Its origin is the object (m), and its x axis points at `yaw` (rad) into the table; y is to the
    right of it if `mirror` is -1. `extent` is from the object to the nearest edge, the opposite
    one, and the ends of the table at positive and at negative y (m).
    """

    origin: tuple[float, float]
    yaw: float
    mirror: float
    extent: tuple[float, float, float, float]


class EdgeNN(ContinuousNN):
    """Maps the scene to a pose of the base, both in the edge's frame; sends the motion to it."""

    def sees(self, percept: list[float]) -> list[float]:
        """The scene without obstacles."""
        return table_scene(edge_frame(percept), percept)

    def motion(self, percept: list[float]) -> list[float]:
        """The motion dx, dy (m), dθ (rad) to the pose."""
        frame = edge_frame(percept)
        x, y, heading = self.output(percept)
        dx, dy = turned((x, frame.mirror * y), frame.yaw)
        turn = wrapped(frame.yaw + frame.mirror * heading)
        return [frame.origin[0] + dx, frame.origin[1] + dy, turn]


class EdgeWayNN(EdgeNN):
    """An `EdgeNN` that sends the first motion of a route to its pose around what is seen."""

    def __init__(self, parameters: Sequence[float], footprint: Box, **sizes: Any):
        super().__init__(parameters, **sizes)
        self.footprint = footprint

    def motion(self, percept: list[float]) -> list[float]:
        """The first motion dx, dy (m), dθ (rad) of a route to the pose."""
        return first_motion(things(percept), super().motion(percept), self.footprint)


class EdgeBranchingNN(BranchingNN):
    """Maps the scene in the edge's frame to one of two branches."""

    def sees(self, percept: list[float]) -> list[float]:
        """The scene, including obstacles."""
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
    """For each obstacle, its centre's x and y and half its mean side (m)."""
    seen: list[float] = []
    for i in range(9 if (len(percept) - 7) % 4 else 7, len(percept), 4):
        x0, x1, y0, y1 = percept[i : i + 4]
        if any((x0, x1, y0, y1)):
            centre = into(frame, ((x0 + x1) / 2, (y0 + y1) / 2))
            seen += [*centre, (x1 - x0 + y1 - y0) / 4]
        else:
            seen += [-3.0, 0.0, 0.0]  # missing things are far behind the edge
    return seen


def into(frame: Frame, point: tuple[float, float]) -> tuple[float, float]:
    """A point of the base frame in the edge's frame."""
    x, y = turned((point[0] - frame.origin[0], point[1] - frame.origin[1]), -frame.yaw)
    return x, frame.mirror * y


def turned(point: tuple[float, float], angle: float) -> tuple[float, float]:
    """A point turned about the origin."""
    c, s = math.cos(angle), math.sin(angle)
    return c * point[0] - s * point[1], s * point[0] + c * point[1]


def wrapped(angle: float) -> float:
    """The same angle within [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def things(percept: list[float]) -> list[Rectangle]:
    """The table, and boxes around present obstacles."""
    found = [table(percept)]
    for i in range(9 if (len(percept) - 7) % 4 else 7, len(percept), 4):
        x0, x1, y0, y1 = percept[i : i + 4]
        found.append(((x0 + x1) / 2, (y0 + y1) / 2, 0.0, x1 - x0, y1 - y0))
    return [thing for thing in found if min(thing[3:]) > 0]


def first_motion(seen: list[Rectangle], motion: list[float], footprint: Box) -> list[float]:
    """The first motion of the shortest route past corners; see `cgtorch.tabletop.world.routes`."""
    best, total = motion, 0.0 if possible(motion, seen, footprint) else math.inf
    for turn in (0.0, motion[2]) if total else ():
        length, via = shortest(seen, motion, turn, footprint)
        if length < total - WORTH_TURNING:
            best, total = [*via, turn], length
    distance = math.hypot(*best[:2])
    if math.isfinite(total) and distance > LONGEST:
        return [best[0] * LONGEST / distance, best[1] * LONGEST / distance, 0.0]
    return best


def shortest(
    seen: list[Rectangle], motion: list[float], turn: float, footprint: Box
) -> tuple[float, Point]:
    """The length of the shortest route past corners, or infinity, and its first corner."""
    corner = [point for thing in seen for point in corners(thing, footprint)]
    away = [turned(point, -turn) for point in corner]
    after = [(*turned(thing[:2], -turn), thing[2] - turn, *thing[3:]) for thing in seen]
    goal, left = turned((motion[0], motion[1]), -turn), wrapped(motion[2] - turn)
    length, first = [], list(corner)
    for point in corner:
        far = math.hypot(*point)
        begins = far > AWAY and possible([*point, turn], seen, footprint)
        length.append(far if begins else math.inf)
    for _ in range(VIAS - 1):
        before, leads = list(length), list(first)
        for i, one in enumerate(away):
            for j, other in enumerate(away):
                step = [other[0] - one[0], other[1] - one[1], 0.0]
                further = before[i] + math.hypot(*step[:2])
                if further < length[j] and possible(step, beside(after, one), footprint):
                    length[j], first[j] = further, leads[i]
    best, via = math.inf, (0.0, 0.0)
    for j, one in enumerate(away):
        last = [goal[0] - one[0], goal[1] - one[1], left]
        whole = length[j] + math.hypot(*last[:2])
        if whole < best and possible(last, beside(after, one), footprint):
            best, via = whole, first[j]
    return best, via


def corners(thing: Rectangle, footprint: Box) -> list[Point]:
    """The corners of a thing enlarged by what the base needs to turn there."""
    x, y, yaw, *sizes = thing
    reach = ROOM * math.hypot(
        max(map(abs, footprint[:2])) + CLEARANCE, max(map(abs, footprint[2:])) + CLEARANCE
    )
    half = [size / 2 + reach for size in sizes]
    offsets = [(sx * half[0], sy * half[1]) for sx, sy in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return [(x + dx, y + dy) for dx, dy in (turned(offset, yaw) for offset in offsets)]


def beside(seen: list[Rectangle], place: Point) -> list[Rectangle]:
    """Things as seen from a place."""
    return [(x - place[0], y - place[1], *rest) for x, y, *rest in seen]  # type: ignore[misc]


def possible(motion: list[float], seen: list[Rectangle], footprint: Box) -> bool:
    """Whether the base can drive straight and then turn without touching a thing."""
    dx, dy, turn = motion
    if not all(map(math.isfinite, motion)):
        return False
    x0, x1, y0, y1 = footprint
    body = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2 + CLEARANCE, (y1 - y0) / 2 + CLEARANCE
    for x, y, yaw, *size in seen:
        there: Rectangle = (x - dx, y - dy, yaw, size[0], size[1])
        if meets((x, y, yaw, size[0], size[1]), body, dx, dy):
            return False
        for i in range(1, TURN_STEPS + 1) if turn else ():
            angle = wrapped(turn) * i / TURN_STEPS
            place = turned(there[:2], -angle)
            if meets((*place, yaw - angle, size[0], size[1]), body, 0.0, 0.0):
                return False
    return True


def meets(thing: Rectangle, body: Box, dx: float, dy: float) -> bool:
    """Whether the hull of a body, centre and half sides, before and after a drive meets a thing."""
    (bx, by, hx, hy), yaw, w, h = body, thing[2], thing[3] / 2, thing[4] / 2
    x, y, c, s = thing[0] - bx, thing[1] - by, math.cos(yaw), math.sin(yaw)
    along, across = dx * c + dy * s, dy * c - dx * s
    ac, as_ = abs(c), abs(s)
    checks = (
        (x, dx, hx + ac * w + as_ * h),
        (y, dy, hy + as_ * w + ac * h),
        (x * c + y * s, along, w + ac * hx + as_ * hy),
        (y * c - x * s, across, h + as_ * hx + ac * hy),
    )
    if any(p - max(way, 0) > reach or p - min(way, 0) < -reach for p, way, reach in checks):
        return False
    reach = abs(dy) * hx + abs(dx) * hy + abs(across) * w + abs(along) * h
    return abs(y * dx - x * dy) <= reach
