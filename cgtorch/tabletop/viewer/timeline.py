"""From the steps of an execution to pictures in time: the positions of base, arms and object.

Pictures are rows (F, 10 + J): the base's x, y (m) and θ (rad), where the object stands or is held,
its foot (m), its quaternion, w first, and the positions of J joints (rad or m).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy
import torch
from torch import Tensor

from cgtorch.graphs import Action, Skill
from cgtorch.tabletop.actions import Detect, Grasp
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot, arm_ways
from cgtorch.tabletop.kinematics.grasping import GRASP_HEIGHT
from cgtorch.tabletop.physics.bodies import gripper_joints
from cgtorch.tabletop.physics.model import Model
from cgtorch.tabletop.physics.scene import thing_of
from cgtorch.tabletop.viewer.execution import Execution, execute
from cgtorch.tabletop.world import ObservedTabletop, Scenarios
from cgtorch.tabletop.world.geometry import rectangle_in_frame, to_frame, wrap
from cgtorch.training.evaluate import check_percepts

FPS = 20
DRIVE, TURN, SWING = 0.6, 1.2, 1.2
"""Speeds of the base (m/s, rad/s) and of an arm's fastest joint (rad/s)."""
NEAR = 0.05
"""The least time (s) of a hand between two waypoints of its line to the object and up."""
THINK, LOOK, REST = 0.4, 0.8, 1.0
"""Durations (s) of a step without motion, of one that perceives, and of the end."""
UPRIGHT = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
"""The quaternion of an object that stands, w first."""
NO_CONTACT = torch.empty(0, 4, dtype=torch.float64)


@dataclass(frozen=True)
class Candidate:
    """A skill that can be shown, and its tabletop."""

    skill: Skill
    domain: Tabletop

    def world(self, scenarios: Scenarios) -> ObservedTabletop:
        """The world of scenarios; SettingsError if the skill reads other percepts."""
        world = self.domain.world(scenarios)
        check_percepts(self.skill, world.percept_size, "such scenarios")
        return world


@dataclass(frozen=True)
class Timeline:
    """F pictures of an execution, `FPS` per second.

    Attributes:
        names: J joints, those of all arms first, one arm after the other.
        pose: (F, 3) base x, y (m), θ (rad).
        object: (F, 3) where the object stands or is held, its foot, m.
        turned: (F, 4) its quaternion, w first.
        joints: (F, J) positions of the joints, rad or m.
        contacts: F times (C, 4): points (m) where the robot presses on something, and 1 where it
            should not, else 0.
        step: (F,) long, the present step.
        seen: (F,) long, the number of steps before the present percept.
    """

    execution: Execution
    names: tuple[str, ...]
    pose: Tensor
    object: Tensor
    turned: Tensor
    joints: Tensor
    contacts: tuple[Tensor, ...]
    step: Tensor
    seen: Tensor

    def __len__(self) -> int:
        """F."""
        return len(self.step)

    def start_of(self, step: int) -> int:
        """The first picture of a step; the last picture of all if there is no such step."""
        at = (self.step >= step).nonzero()
        return int(at[0]) if len(at) else len(self) - 1


def joint_names(robot: Robot) -> tuple[str, ...]:
    """The joints of all arms, one arm after the other."""
    return tuple(name for arm in robot.arms for name in arm.joint_names)


def timeline_of(execution: Execution, robot: Robot) -> Timeline:
    """The pictures of an execution; the base drives straight and then turns, as in the world.

    If a grasp succeeds, an arm follows its way from home to the pre-grasp, grasps and lifts the
    object (`cgtorch.tabletop.kinematics.arm_ways`).
    """
    scene = execution.scenario
    joints = torch.cat(robot.home).double()[None]
    thing = torch.cat([scene.object[0], scene.table[0, 5:6]]).double()[None]
    pieces = []
    for k, step in enumerate(execution.steps):
        pose = _drive(execution.pose[k].double(), execution.pose[k + 1].double())
        grasped = isinstance(step.action, Grasp) and step.outcome == "success"
        if grasped:
            joints, thing = _grasp(execution, k, robot, joints[-1], thing[-1])
        elif len(pose) == 1:
            pose = pose.expand(_count(seconds_of(step.action)), 3)
        count = max(len(pose), len(joints))
        parts = (_held(rows, count) for rows in (pose, thing, UPRIGHT[None], joints))
        pieces.append(torch.cat([*parts], 1))
        joints = joints[-1:]
        thing = thing[-1:] if grasped else execution.object[k + 1 : k + 2].double()
    return laid_out(execution, joint_names(robot), pieces)


def laid_out(
    execution: Execution,
    names: tuple[str, ...],
    pieces: Sequence[Tensor],
    contacts: Sequence[Tensor] = (),
) -> Timeline:
    """The pictures of all steps one after the other, and the last one for a while."""
    rest = pieces[-1][-1:].expand(_count(REST), -1)
    rows, counts = torch.cat([*pieces, rest]).float(), torch.tensor([*map(len, pieces)])
    step = torch.arange(len(pieces)).repeat_interleave(counts)
    seen = step.clone()
    seen[counts.cumsum(0) - 1] += 1
    pose, thing, turned, joints = rows.split([3, 3, 4, len(names)], 1)
    every = (*contacts, *[NO_CONTACT] * (len(rows) - len(contacts)))
    step, seen = _held(step, len(rows)), _held(seen, len(rows))
    return Timeline(execution, names, pose, thing, turned, joints, every, step, seen)


def seconds_of(action: Action) -> float:
    """How long a step of an action lasts that moves nothing (s)."""
    return LOOK if isinstance(action, Detect | Grasp) else THINK


def _count(seconds: float) -> int:
    return max(1, round(seconds * FPS))


def _held(rows: Tensor, count: int) -> Tensor:
    """The rows, with the last one repeated until there are `count`."""
    return torch.cat([rows, rows[-1:].expand(count - len(rows), *rows.shape[1:])])


def _line(start: Tensor, end: Tensor, seconds: float) -> Tensor:
    """(F, n) points on the straight line, with its end and without its start."""
    count = _count(seconds)
    return start + torch.arange(1, count + 1, dtype=start.dtype)[:, None] / count * (end - start)


def _drive(before: Tensor, after: Tensor) -> Tensor:
    """(F, 3) poses from one to another: straight, then turning; a single one without motion."""
    way, turn = float((after - before)[:2].norm()), wrap(after[2:] - before[2:])
    if way == 0 and float(turn) == 0:
        return after[None]
    corner = torch.cat([after[:2], before[2:]])
    end = torch.cat([after[:2], before[2:] + turn])
    turning = _line(corner, end, float(turn.abs()) / TURN)
    return torch.cat([_line(before, corner, way / DRIVE), turning])


def _grasp(
    execution: Execution, k: int, robot: Robot, joints: Tensor, thing: Tensor
) -> tuple[Tensor, Tensor]:
    """Joints (F, J) and objects (F, 3) while the object is grasped and lifted, from step k on."""
    pose, scene = execution.pose[k : k + 1], execution.scenario
    at = torch.cat([to_frame(pose, scene.object), scene.table[:, 5:6]], 1)
    table = torch.cat([rectangle_in_frame(pose, scene.table[:, :5]), scene.table[:, 5:6]], 1)
    ways = arm_ways(robot, at, table)
    if not ways.found[0]:
        return joints[None], thing[None]
    which, pre_grasp = int(ways.arm[0]), int(ways.pre_grasp[0])
    arm = robot.arms[which]
    first, count = sum(len(a.joint_names) for a in robot.arms[:which]), len(arm.joint_names)
    way = ways.joints[0, : int(ways.lifted[0]) + 1, :count].double()
    moving = [way[:1]]
    for i, (here, goal) in enumerate(pairwise(way)):
        seconds = float((goal - here).abs().max()) / SWING
        moving.append(_line(here, goal, seconds if i < pre_grasp else max(seconds, NEAR)))
    path = torch.cat(moving)
    grasped = sum(len(part) for part in moving[: int(ways.grasp[0]) + 1])
    all_joints = joints.expand(len(path), -1).clone()
    all_joints[:, first : first + count] = path
    things = thing.expand(len(path), 3).clone()
    things[grasped:, 2] = arm.frames(path[grasped:])[-1][:, 2, 3] - GRASP_HEIGHT
    return all_joints, things


def simulated_timeline(skill: Skill, domain: Tabletop, scenario: Scenarios) -> Timeline:
    """Run a skill on one scenario of a domain in physics and lay out in time what is simulated.

    Steps that move nothing last as long as in the kinematic world.
    """
    recorder = Recorder(domain.robot)
    watched = domain.watched(replace(domain.physics, watch=recorder))
    execution = execute(skill, watched.world(scenario), ended=recorder.end_step)
    start = execution.pose[0].double(), execution.object[0].double(), UPRIGHT, recorder.rest
    last, pieces, contacts = torch.cat(start), list[Tensor](), list[Tensor]()
    for step, pictures in zip(execution.steps, recorder.steps, strict=True):
        if not pictures:
            pictures = [(last, NO_CONTACT)] * _count(seconds_of(step.action))
        pieces.append(torch.stack([row for row, _ in pictures]))
        contacts += [points for _, points in pictures]
        last = pieces[-1][-1]
    return laid_out(execution, recorder.names, pieces, contacts)


class Recorder:
    """Takes pictures of what is simulated, as `Physics.watch`, step after step of a skill.

    Attributes:
        names: J joints whose positions are taken: of all arms, then of their fingers but those that
            follow others.
        rest: (J,) where arms are at home and grippers open, rad or m.
        steps: of each step its pictures (10 + J,) with their contacts; none without a simulation.
    """

    def __init__(self, robot: Robot) -> None:
        """A recorder that has seen nothing."""
        every = [joint for arm in range(len(robot.arms)) for joint in gripper_joints(robot, arm)]
        fingers = dict.fromkeys(joint.name for joint in every if joint.mimic is None)
        held = [robot.description.held.get(name, 0.0) for name in fingers]
        self.names = (*joint_names(robot), *fingers)
        self.rest = torch.cat([*robot.home, torch.tensor(held)]).double()
        self.steps: list[list[tuple[Tensor, Tensor]]] = []
        self._model: Model | None = None
        self._taken: list[tuple[Tensor, Tensor]] = []
        self._before, self._time = 0, 0.0  # pictures before this simulation, and its latest time, s

    def __call__(self, model: Model) -> None:
        """Take a picture if it is time to."""
        if model.data.time < self._time:
            self._before = len(self._taken)
        self._model, self._time = model, model.data.time
        if self._time * FPS >= len(self._taken) - self._before:
            self._taken.append(self._seen(model))

    def end_step(self) -> None:
        """A step of the skill ends, and so do its pictures."""
        last = [] if self._model is None else [self._seen(self._model)]
        self.steps.append([*self._taken, *last])
        self._model, self._taken, self._before, self._time = None, [], 0, 0.0

    def _seen(self, model: Model) -> tuple[Tensor, Tensor]:
        """One picture of what is simulated, and its contacts."""
        at, joints = model.data.qpos, self.rest.clone()
        for joint in (*model.arm, *model.fingers):
            joints[self.names.index(joint.name)] = float(at[joint.qpos])
        thing = torch.tensor(thing_of(model))
        foot = thing[:3] - model.thing.half_height * _upwards(thing[3:])
        row = torch.cat([torch.tensor(at[:3].copy()), foot, thing[3:], joints])
        return row, contacts_of(model)


def contacts_of(model: Model) -> Tensor:
    """(C, 4) points (m) where the robot presses on something, and 1 where it should not, else 0.

    It should press on the object alone, and that with an arm.
    """
    contact = model.data.contact
    if not len(contact.dist):
        return NO_CONTACT
    first, second = contact.geom.T
    touches, meets = model.touching[first, second], model.bumping[first, second]
    wrong = touches if model.arm else meets
    pressed = (touches | meets) & (contact.dist < 0)
    return torch.tensor(numpy.concatenate([contact.pos, wrong[:, None]], 1)[pressed])


def _upwards(quaternion: Tensor) -> Tensor:
    """(3,) the z axis of a body that is turned by a unit quaternion, w first."""
    w, x, y, z = quaternion
    return torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
