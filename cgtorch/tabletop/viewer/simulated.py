"""A skill at work in physics, as it is simulated: base, arm, fingers, contacts, falling objects."""

from dataclasses import replace

import numpy
import torch
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.bodies import gripper_joints
from cgtorch.tabletop.physics.model import Model
from cgtorch.tabletop.physics.scene import thing_of
from cgtorch.tabletop.viewer.execution import execute
from cgtorch.tabletop.viewer.timeline import (
    FPS,
    UPRIGHT,
    Moves,
    Timeline,
    joint_names,
    laid_out,
    seconds_of,
)
from cgtorch.tabletop.world import Scenarios


def simulated_timeline(skill: Skill, domain: Tabletop, scenario: Scenarios) -> Timeline:
    """Run a skill on one scenario of a domain in physics and lay out in time what is simulated.

    Steps that move nothing last as long as in the kinematic world.
    """
    recorder = Recorder(domain.robot)
    watched = domain.watched(replace(domain.physics, watch=recorder))
    execution = execute(skill, watched.world(scenario), ended=recorder.end_step)
    still = Moves(
        execution.pose[:1].double(), recorder.rest[None], execution.object[:1].double(),
        UPRIGHT[None], (),
    )  # fmt: skip
    pieces = []
    for step, moves in zip(execution.steps, recorder.steps, strict=True):
        pieces.append(moves or still.lasting(seconds_of(step.action)))
        still = pieces[-1].last
    return laid_out(execution, recorder.names, pieces)


class Recorder:
    """Takes pictures of what is simulated, as `Physics.watch`, step after step of a skill.

    Attributes:
        names: J joints whose positions are taken: of all arms, then of their fingers but those that
            follow others.
        rest: (J,) where arms are at home and grippers open, rad or m.
        steps: of each step its pictures, None where nothing was simulated.
    """

    def __init__(self, robot: Robot) -> None:
        """A recorder that has seen nothing."""
        fingers = _fingers(robot)
        held = [robot.description.held.get(name, 0.0) for name in fingers]
        self.names = (*joint_names(robot), *fingers)
        self.rest = torch.cat([*robot.home, torch.tensor(held)]).double()
        self.steps: list[Moves | None] = []
        self._model: Model | None = None
        self._taken: list[Moves] = []
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
        if self._model is None:
            self.steps.append(None)
            return
        self.steps.append(Moves.joined([*self._taken, self._seen(self._model)]))
        self._model, self._taken, self._before, self._time = None, [], 0, 0.0

    def _seen(self, model: Model) -> Moves:
        """One picture of what is simulated."""
        at, joints = model.data.qpos, self.rest.clone()
        for joint in (*model.arm, *model.fingers):
            joints[self.names.index(joint.name)] = float(at[joint.qpos])
        thing = torch.tensor(thing_of(model))
        foot = thing[:3] - model.thing.half_height * _upwards(thing[3:])
        pose = torch.tensor(at[:3].copy())
        return Moves(pose[None], joints[None], foot[None], thing[None, 3:], (contacts_of(model),))


def contacts_of(model: Model) -> Tensor:
    """(C, 4) points (m) where the robot presses on something, and 1 where it should not, else 0.

    It should press on the object alone, and that with an arm.
    """
    contact = model.data.contact
    if not len(contact.dist):
        return torch.zeros(0, 4, dtype=torch.float64)
    first, second = contact.geom.T
    touches, meets = model.touching[first, second], model.bumping[first, second]
    wrong = touches if model.arm else meets
    pressed = (touches | meets) & (contact.dist < 0)
    return torch.tensor(numpy.concatenate([contact.pos, wrong[:, None]], 1)[pressed])


def _fingers(robot: Robot) -> list[str]:
    every = [joint for arm in range(len(robot.arms)) for joint in gripper_joints(robot, arm)]
    return list(dict.fromkeys(joint.name for joint in every if joint.mimic is None))


def _upwards(quaternion: Tensor) -> Tensor:
    """(3,) the z axis of a body that is turned by a unit quaternion, w first."""
    w, x, y, z = quaternion
    return torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
