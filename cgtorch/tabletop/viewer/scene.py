"""One skill at work in three dimensions: robot, table, object, way, and percept."""

import io
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import viser
import yourdfpy
from torch import Tensor
from viser.extras import ViserUrdf

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, TABLE_THICKNESS
from cgtorch.tabletop.physics import Thing
from cgtorch.tabletop.viewer.timeline import Timeline
from cgtorch.tabletop.world.geometry import box_rectangle, corners, moved, rotate
from cgtorch.tabletop.world.percepts import BOX, present

Array = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

WOOD, LEG, OBJECT, BOX_COLOUR = (196, 154, 108), (120, 92, 66), (214, 39, 40), (140, 145, 152)
DONE, AHEAD, SEEN, GOAL, REFUSED, GRIP = (
    (31, 119, 180), (150, 170, 192), (0, 150, 136), (255, 140, 0), (214, 39, 40), (255, 214, 10),
)  # fmt: skip
OBJECT_RADIUS, LEG_SIDE, OBSTACLE_HEIGHT, CONTACT = Thing().size[0], 0.06, 0.35, 0.02  # m
FLOOR = 0.006  # m above the floor that lines are drawn


class Scene:
    """The drawing of one skill, under one name of the scene tree."""

    def __init__(self, server: viser.ViserServer, name: str, robot: Robot, y: float = 0.0):
        """A scene with the world's origin drawn at (0, y), m."""
        self.server, self.name, self.robot = server, name, robot
        self.place = server.scene.add_frame(name, show_axes=False, position=(0.0, y, 0.0))
        self.base = server.scene.add_frame(f"{name}/base", show_axes=False)
        # A model apart from the one that kinematics keep. Robots whose shapes are files of
        # meshes, which a run does not keep, show what they collide with.
        xml = io.BytesIO(robot.urdf.xml)
        model = yourdfpy.URDF.load(xml, load_meshes=False, build_collision_scene_graph=True)
        visual = bool(model.scene.geometry)
        # Where the URDF's root link is in the base frame.
        root = model.get_transform(model.base_link, robot.description.base_frame)
        turn = viser.transforms.SO3.from_matrix(root[:3, :3]).wxyz
        server.scene.add_frame(
            f"{name}/base/robot", show_axes=False, wxyz=turn, position=root[:3, 3]
        )
        self.drawn = ViserUrdf(
            server, model, root_node_name=f"{name}/base/robot",
            load_meshes=visual, load_collision_meshes=not visual,
        )  # fmt: skip
        self.rest = _rest(model, robot)
        self.actuated = model.actuated_joint_names
        self.columns: list[int] = []
        self.object = server.scene.add_cylinder(
            f"{name}/object", OBJECT_RADIUS, 2 * GRASP_HEIGHT, color=OBJECT
        )
        self.timeline: Timeline | None = None
        self.frame, self.marked = -1, 0

    def remove(self) -> None:
        """Remove everything."""
        self.place.remove()

    def load(self, timeline: Timeline) -> None:
        """Show another execution, from its start."""
        self.timeline, self.frame = timeline, -1
        self.columns = [self.actuated.index(name) for name in timeline.names]
        scene, run = timeline.execution.scenario, timeline.execution
        self._table(scene.table[0])
        for k, box in enumerate(scene.obstacles[0]):
            self._block(
                f"obstacle-{k}", box[:3], [*box[3:5].tolist(), OBSTACLE_HEIGHT],
                OBSTACLE_HEIGHT / 2, BOX_COLOUR, visible=bool(present(box)),
            )  # fmt: skip
        above = float(scene.table[0, 5]) + 0.5
        self.server.scene.add_label(
            f"{self.name}/label", run.skill.name, position=(0.0, 0.0, above),
            anchor="bottom-center", font_screen_scale=1.3,
        )  # fmt: skip
        stops = run.pose[torch.cat([torch.tensor([True]), (run.pose[1:] != run.pose[:-1]).any(1)])]
        self._lines("stops", self._footprints(stops), AHEAD, FLOOR, 1.5)
        self._lines("way", _segments(timeline.pose[:, :2]), AHEAD, FLOOR, 3)
        self.show(0)

    def show(self, frame: int) -> None:
        """Show one picture of the execution, the last one for numbers beyond it."""
        if (timeline := self.timeline) is None:
            return
        frame = min(frame, len(timeline) - 1)
        if frame == self.frame:
            return
        first, self.frame = self.frame < 0, frame
        x, y, turn = timeline.pose[frame].tolist()
        self.base.position = np.array([x, y, 0.0])
        self.base.wxyz = np.array([math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)])
        turned = viser.transforms.SO3(timeline.turned[frame].double().numpy())
        middle = turned.apply(np.array([0.0, 0.0, GRASP_HEIGHT]))
        self.object.position = timeline.object[frame].numpy() + middle
        self.object.wxyz = turned.wxyz
        self._contacts(timeline.contacts[frame].numpy())
        joints = timeline.joints[frame].double().numpy()
        if first or not np.array_equal(joints, self.rest[self.columns]):
            self.rest[self.columns] = joints
            self.drawn.update_cfg(self.rest)
        self._lines("driven", _segments(timeline.pose[: frame + 1, :2]), DONE, 2 * FLOOR, 5)
        self._perceived(timeline, int(timeline.seen[frame]))
        self._asked(timeline, int(timeline.step[frame]))

    def _contacts(self, points: Array) -> None:
        """Where the robot presses on something (C, 4), in red where it should not."""
        if not len(points) and not self.marked:
            return
        self.marked = len(points)
        points = points if len(points) else np.zeros((1, 4))  # as a cloud has one point at least
        self.server.scene.add_point_cloud(
            f"{self.name}/contacts", points[:, :3], np.where(points[:, 3:] > 0, REFUSED, GRIP),
            point_size=CONTACT, point_shape="circle", visible=self.marked > 0,
        )  # fmt: skip

    def _table(self, table: Tensor) -> None:
        x, y, yaw, sx, sy, height = table.tolist()
        self._block("table", table[:3], [sx, sy, TABLE_THICKNESS], height - TABLE_THICKNESS / 2,
                    WOOD)  # fmt: skip
        inner = torch.tensor([x, y, yaw, sx - 2 * LEG_SIDE, sy - 2 * LEG_SIDE])
        for k, corner in enumerate(corners(inner)):
            at, length = torch.cat([corner, table[2:3]]), height - TABLE_THICKNESS
            self._block(f"leg-{k}", at, [LEG_SIDE, LEG_SIDE, length], length / 2, LEG)

    def _block(
        self, name: str, at: Tensor, sides: list[float], z: float, colour: Colour, **how: Any
    ) -> None:
        x, y, yaw = at.tolist()
        self.server.scene.add_box(
            f"{self.name}/{name}", color=colour, dimensions=(sides[0], sides[1], sides[2]),
            position=(x, y, z), wxyz=(math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)), **how,
        )  # fmt: skip

    def _footprints(self, pose: Tensor) -> Tensor:
        """(4 n, 2, 2) outlines of the base at poses (n, 3)."""
        ring = corners(box_rectangle(torch.tensor(self.robot.description.footprint)))
        ring = rotate(ring.expand(len(pose), 4, 2), pose[:, None, 2]) + pose[:, None, :2]
        return torch.stack([ring, ring.roll(-1, 1)], 2).flatten(0, 1)

    def _perceived(self, timeline: Timeline, seen: int) -> None:
        """Draw the table's box and the object as perceived."""
        run, table = timeline.execution, timeline.execution.scenario.table[0]
        pose, percept = run.pose[seen], run.percept[seen]
        box = corners(box_rectangle(percept[:BOX]))
        box = rotate(box, pose[2]) + pose[:2]
        self._lines("perceived", torch.stack([box, box.roll(-1, 0)], 1), SEEN,
                    float(table[5]) + FLOOR, 3)  # fmt: skip
        at = rotate(percept[4:6], pose[2]) + pose[:2]
        arm = torch.tensor([[[-0.06, 0.0], [0.06, 0.0]], [[0.0, -0.06], [0.0, 0.06]]])
        self._lines("perceived-object", at + rotate(arm, pose[2].expand(2, 2)), SEEN,
                    float(percept[6]) + 2 * FLOOR, 4)  # fmt: skip

    def _asked(self, timeline: Timeline, step: int) -> None:
        """Draw the pose that the message commands, as the outline of the base."""
        run = timeline.execution
        message = run.message[step + 1, :3]
        there = len(message) == 3 and bool(message.isfinite().all())
        goal = moved(run.pose[step], message) if there else run.pose[step]
        lines = self._footprints(goal[None])
        nose = torch.stack([goal[:2], goal[:2] + rotate(torch.tensor([0.33, 0.0]), goal[2])])
        refused = (run.steps[step].name, run.steps[step].outcome) == ("MoveBase", "failure")
        self._lines("asked", torch.cat([lines, nose[None]]), REFUSED if refused else GOAL,
                    3 * FLOOR, 4, visible=there)  # fmt: skip

    def _lines(
        self, name: str, points: Tensor, colour: Colour, z: float, width: float, **how: Any
    ) -> None:
        """Lines (n, 2, 2) at a height, `width` pixels wide; none is drawn where there are none."""
        flat = torch.nn.functional.pad(points, (0, 1), value=z).double().numpy()
        self.server.scene.add_line_segments(
            f"{self.name}/{name}", flat if len(flat) else np.zeros((1, 2, 3)), colour,
            thickness=width, thickness_units="screen", **how,
        )  # fmt: skip


def _segments(points: Tensor) -> Tensor:
    """(n, 2, 2) the pieces of a polyline (F, 2) that have a length."""
    pieces = torch.stack([points[:-1], points[1:]], 1)
    return pieces[(pieces[:, 0] != pieces[:, 1]).any(1)]


def _rest(model: Any, robot: Robot) -> Array:
    """Positions of all joints: those of the description, else the ones nearest to 0."""
    held, positions = robot.description.held, []
    for joint in model.actuated_joints:
        limit = joint.limit
        bounded = joint.type != "continuous" and limit is not None
        nearest = min(max(0.0, limit.lower), limit.upper) if bounded else 0.0
        positions.append(held.get(joint.name, nearest))
    return np.array(positions)
