"""One skill at work, in three dimensions and as HTML: robot, table, object, percept, graph."""

import io
import math
import re
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import viser
import yourdfpy
from markupsafe import Markup
from matplotlib import rc_context
from torch import Tensor
from viser.extras import ViserUrdf

from cgtorch.graphs import Skill
from cgtorch.graphs.clusters import Cluster, clusters_of
from cgtorch.report.graph_picture import draw_clusters, gid_of
from cgtorch.report.html import STYLE, inline_svg, templates
from cgtorch.simulation.tracing import Step
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT, TABLE_THICKNESS
from cgtorch.tabletop.kinematics.urdf import at_rest
from cgtorch.tabletop.physics import Thing
from cgtorch.tabletop.viewer.timeline import Timeline
from cgtorch.tabletop.world.geometry import box_rectangle, corners, moved, rotate
from cgtorch.tabletop.world.percepts import BOX, percept_fields, present

Array = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

WOOD, LEG, OBJECT, BOX_COLOUR = (196, 154, 108), (120, 92, 66), (214, 39, 40), (140, 145, 152)
DONE, AHEAD, SEEN, GOAL, REFUSED, GRIP = (
    (31, 119, 180), (150, 170, 192), (0, 150, 136), (255, 140, 0), (214, 39, 40), (255, 214, 10),
)  # fmt: skip
OBJECT_RADIUS, LEG_SIDE, OBSTACLE_HEIGHT, CONTACT = Thing().size[0], 0.06, 0.35, 0.02  # m
FLOOR = 0.006  # m above the floor that lines are drawn
FINE, USUAL, BOLD, BROAD = 1.5, 3.0, 4.0, 5.0  # pixels, the width of lines
CROSS = torch.tensor([[[-0.06, 0.0], [0.06, 0.0]], [[0.0, -0.06], [0.0, 0.06]]])  # m
NOSE = torch.tensor([0.33, 0.0])  # m: the end of the line that shows a heading
TEMPLATES = templates("cgtorch.tabletop.viewer")
LIT, RIM = "#ffd60a", "#1c1f24"
SCALE = 0.94  # of pictures of graphs, where 1 is 96 pixels an inch
OUTER_HEIGHT = 2.1
"""The largest height, in inches, of a level that waits for the one within it."""


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
        root = model.get_transform(model.base_link, robot.description.base_frame)
        turn = viser.transforms.SO3.from_matrix(root[:3, :3]).wxyz
        below = f"{name}/base/robot"
        server.scene.add_frame(below, show_axes=False, wxyz=turn, position=root[:3, 3])
        self.drawn = ViserUrdf(
            server, model, root_node_name=below,
            load_meshes=visual, load_collision_meshes=not visual,
        )  # fmt: skip
        held = robot.description.held
        self.rest = np.array([held.get(j.name, at_rest(j)) for j in model.actuated_joints])
        self.actuated = model.actuated_joint_names
        self.columns: list[int] = []
        self.object = server.scene.add_cylinder(
            f"{name}/object", OBJECT_RADIUS, 2 * GRASP_HEIGHT, color=OBJECT
        )
        self.timeline: Timeline | None = None
        self.frame, self.marked = -1, 0

    def load(self, timeline: Timeline) -> None:
        """Show another execution, from its start."""
        self.timeline, self.frame = timeline, -1
        self.columns = [self.actuated.index(name) for name in timeline.names]
        scene, run = timeline.execution.scenario, timeline.execution
        x, y, yaw, sx, sy, height = scene.table[0].tolist()
        top = [sx, sy, TABLE_THICKNESS]
        self._block("table", (x, y, yaw), top, height - TABLE_THICKNESS / 2, WOOD)
        inner = torch.tensor([x, y, yaw, sx - 2 * LEG_SIDE, sy - 2 * LEG_SIDE])
        leg = [LEG_SIDE, LEG_SIDE, height - TABLE_THICKNESS]
        for k, (leg_x, leg_y) in enumerate(corners(inner).tolist()):
            self._block(f"leg-{k}", (leg_x, leg_y, yaw), leg, leg[2] / 2, LEG)
        for k, box in enumerate(scene.obstacles[0]):
            bx, by, turn, *sides = box.tolist()
            self._block(
                f"obstacle-{k}", (bx, by, turn), [*sides, OBSTACLE_HEIGHT], OBSTACLE_HEIGHT / 2,
                BOX_COLOUR, visible=bool(present(box)),
            )  # fmt: skip
        self.server.scene.add_label(
            f"{self.name}/label", run.skill.name, position=(0.0, 0.0, height + 0.5),
            anchor="bottom-center", font_screen_scale=1.3,
        )  # fmt: skip
        stops = run.pose[torch.cat([torch.tensor([True]), (run.pose[1:] != run.pose[:-1]).any(1)])]
        self._lines("stops", self._footprints(stops), AHEAD, FLOOR, FINE)
        self._lines("way", _segments(timeline.pose[:, :2]), AHEAD, FLOOR, USUAL)
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
        self.base.position, self.base.wxyz = np.array([x, y, 0.0]), np.array(_about_z(turn))
        turned = viser.transforms.SO3(timeline.turned[frame].double().numpy())
        middle = turned.apply(np.array([0.0, 0.0, GRASP_HEIGHT]))
        self.object.position = timeline.object[frame].numpy() + middle
        self.object.wxyz = turned.wxyz
        self._contacts(timeline.contacts[frame].numpy())
        joints = timeline.joints[frame].double().numpy()
        if first or not np.array_equal(joints, self.rest[self.columns]):
            self.rest[self.columns] = joints
            self.drawn.update_cfg(self.rest)
        self._lines("driven", _segments(timeline.pose[: frame + 1, :2]), DONE, 2 * FLOOR, BROAD)
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

    def _block(
        self, name: str, at: tuple[float, float, float], sides: list[float], z: float,
        colour: Colour, **how: Any,
    ) -> None:  # fmt: skip
        """A box with its centre at x, y (m), turned by a yaw (rad), and at a height."""
        self.server.scene.add_box(
            f"{self.name}/{name}", color=colour, dimensions=(sides[0], sides[1], sides[2]),
            position=(at[0], at[1], z), wxyz=_about_z(at[2]), **how,
        )  # fmt: skip

    def _footprints(self, pose: Tensor) -> Tensor:
        """(4 n, 2, 2) outlines of the base at poses (n, 3)."""
        ring = corners(box_rectangle(torch.tensor(self.robot.description.footprint)))
        ring = rotate(ring.expand(len(pose), 4, 2), pose[:, None, 2]) + pose[:, None, :2]
        return torch.stack([ring, ring.roll(-1, 1)], 2).flatten(0, 1)

    def _perceived(self, timeline: Timeline, seen: int) -> None:
        """Draw the table's box and the object as perceived."""
        run, top = timeline.execution, float(timeline.execution.scenario.table[0, 5])
        pose, percept = run.pose[seen], run.percept[seen]
        box = rotate(corners(box_rectangle(percept[:BOX])), pose[2]) + pose[:2]
        self._lines("perceived", torch.stack([box, box.roll(-1, 0)], 1), SEEN, top + FLOOR, USUAL)
        at = rotate(percept[4:6], pose[2]) + pose[:2]
        cross, height = rotate(CROSS, pose[2].expand(2, 2)), float(percept[6]) + 2 * FLOOR
        self._lines("perceived-object", at + cross, SEEN, height, BOLD)

    def _asked(self, timeline: Timeline, step: int) -> None:
        """Draw the pose that the message commands, as the outline of the base."""
        run = timeline.execution
        message = run.message[step + 1, :3]
        there = len(message) == 3 and bool(message.isfinite().all())
        goal = moved(run.pose[step], message) if there else run.pose[step]
        nose = torch.stack([goal[:2], goal[:2] + rotate(NOSE, goal[2])])
        lines = torch.cat([self._footprints(goal[None]), nose[None]])
        refused = (run.steps[step].name, run.steps[step].outcome) == ("MoveBase", "failure")
        self._lines("asked", lines, REFUSED if refused else GOAL, 3 * FLOOR, BOLD, visible=there)

    def _lines(
        self, name: str, points: Tensor, colour: Colour, z: float, width: float, **how: Any
    ) -> None:
        """Lines (n, 2, 2) at a height, `width` pixels wide; none is drawn where there are none."""
        flat = torch.nn.functional.pad(points, (0, 1), value=z).double().numpy()
        self.server.scene.add_line_segments(
            f"{self.name}/{name}", flat if len(flat) else np.zeros((1, 2, 3)), colour,
            thickness=width, thickness_units="screen", **how,
        )  # fmt: skip


def _about_z(turn: float) -> tuple[float, float, float, float]:
    """The quaternion of a turn about the vertical axis, w first."""
    return math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)


def _segments(points: Tensor) -> Tensor:
    """(n, 2, 2) the pieces of a polyline (F, 2) that have a length."""
    pieces = torch.stack([points[:-1], points[1:]], 1)
    return pieces[(pieces[:, 0] != pieces[:, 1]).any(1)]


def levels_html(skill: Skill, step: Step) -> str:
    """The levels of a step, outermost first, as HTML, with its nodes and last edge highlighted."""
    clusters = [_clusters(skill)[id(inner)] for inner, _ in step.places]
    nodes = [c.nodes[f"{c.key}_n{s}"] for c, (_, s) in zip(clusters, step.places, strict=True)]
    ended = nodes[-1].key, step.outcome
    (edge,) = (e for e in clusters[-1].edges if (e.tail, e.outcome) == ended)
    gids = [gid_of(c, node) for c, node in zip(clusters, nodes, strict=True)]
    return TEMPLATES.get_template("levels.html").render(
        nodes=[(_selector(gid), _selector(f"text:{gid}")) for gid in gids],
        edge=_selector(gid_of(clusters[-1], edge)),
        pictures=[_picture(skill, inner, inner is step.places[-1][0]) for inner, _ in step.places],
        lit=LIT,
        rim=RIM,
    )


def _selector(gid: str) -> Markup:
    """The CSS selector of an element; names come from files and may contain anything."""
    escaped = re.sub(r"[^\w .:›-]", lambda found: f"\\{ord(found[0]):x} ", gid)
    return Markup(f'[data-part="{escaped}"]')  # noqa: S704  nothing of HTML is left


@cache
def _clusters(skill: Skill) -> dict[int, Cluster]:
    return {id(cluster.skill): cluster for cluster in clusters_of(skill)}


@cache
def _picture(skill: Skill, inner: Skill, last: bool) -> Markup:
    """One level as an SVG element."""
    cluster = _clusters(skill)[id(inner)]
    with rc_context(STYLE):
        figure = draw_clusters([cluster])
    scale = SCALE if last else min(SCALE, OUTER_HEIGHT / figure.get_size_inches()[1])
    return inline_svg(figure, cluster.key, cluster.path, scale)


def percept_rows(percept: Tensor) -> list[tuple[str, str]]:
    """Names and values of a percept (D,)."""
    values = zip(percept_fields(len(percept)), percept.tolist(), strict=True)
    return [(field.name, f"{value:.3f} {field.unit}") for field, value in values]


def message_rows(message: Tensor) -> list[tuple[str, str]]:
    """Names and values of a message (M,), none where there is no message."""
    if not message.isfinite().all():
        return []
    known = [(field.name, f" {field.unit}") for field in Tabletop.control]
    known += [(f"{i}", "") for i in range(len(known), len(message))]
    values = zip(known, message.tolist(), strict=False)
    return [(name, f"{value:+.3f}{unit}") for (name, unit), value in values]


def headline(timeline: Timeline, frame: int) -> str:
    """One line: the number of the step, the node that runs, and its outcome."""
    run, k = timeline.execution, int(timeline.step[frame])
    step = run.steps[k]
    skill, slot = step.places[-1]
    end = f" · {run.skill.name} ended with {run.end}" if frame == len(timeline) - 1 else ""
    node = f"{skill.name} · {step.name}_{slot}"
    return f"step {k + 1} of {len(run.steps)}: {node} → {step.outcome}{end}"


def readings_html(timeline: Timeline, frame: int) -> str:
    """The headline, the percept and the message at one picture, as HTML."""
    run = timeline.execution
    message = run.message[min(int(timeline.step[frame]) + 1, len(run.message) - 1)]
    return TEMPLATES.get_template("readings.html").render(
        headline=headline(timeline, frame),
        percept=percept_rows(run.percept[int(timeline.seen[frame])]),
        message=message_rows(message) or [("none yet", "")],
    )
