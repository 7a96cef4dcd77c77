"""A robot in MuJoCo carries out an exported skill, given only motions and arm commands.

A real robot's driver has the same structure: `move` calls its navigation, `carry_out` calls its arm
and gripper controllers.

    cgtorch-export runs/reference --format state-machine --output S3.py
    python -m examples.robot_driver S3.py

The second command prints how the skill ends.
"""

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import torch

from cgtorch.tabletop.arm_command import arm_command
from cgtorch.tabletop.kinematics import Robot, load_robot
from cgtorch.tabletop.physics import Physics
from cgtorch.tabletop.physics.drive import drive
from cgtorch.tabletop.physics.scene import Scene, put, thing_of
from cgtorch.tabletop.world import Scenarios, draw_of, motion_possible, percept_of
from cgtorch.tabletop.world.geometry import moved, rectangle_in_frame

STEPS = 2  # of the simulation between two commands of the servos
HOLD = 0.5  # s


class SimulatedRobot:
    """A robot in front of a table, which perceives, moves and uses its arms; percepts are noisy."""

    def __init__(self, robot: Robot, scenario: Scenarios, noise: float = 0.005) -> None:
        """A robot at the start of the first scenario; the noise of percepts is in m."""
        table, placed = scenario.table[0].double(), scenario.object[0].double()
        centre = [*placed.tolist(), float(table[5]) + 0.05]
        thing = np.array([*centre, 1.0, 0, 0, 0])
        pose = scenario.pose[0].double().numpy()
        self.scene = Scene(pose, table.numpy(), thing, np.zeros((0, 5)))
        self.robot, self.physics, self.noise = robot, Physics(robot), noise
        self.random = np.random.default_rng(int(scenario.seed[0]))

    def look(self) -> list[float]:
        """The percept: the table's box, and the object's x, y and z, m, in the base frame."""
        pose, table = torch.from_numpy(self.scene.pose), torch.from_numpy(self.scene.table)
        exact = percept_of(pose, table, torch.from_numpy(self.scene.thing[:2]))
        seen: list[float] = (exact.numpy() + self.noise * self.random.normal(size=7)).tolist()
        return seen

    def move(self, *motion: float) -> bool:
        """Drive by dx, dy (m), then turn by dθ (rad), if the motion is clear."""
        pose, control = (torch.tensor([list(x)]).double() for x in (self.scene.pose, motion))
        table = torch.from_numpy(self.scene.table)[None, :5]
        footprint = torch.tensor(self.robot.description.footprint).double()
        if not bool(motion_possible(control, rectangle_in_frame(pose, table), footprint)):
            return False
        goal = moved(pose, control)[0].numpy()
        found = drive(self.physics.model(None, 0), self.scene, goal)
        self.scene = Scene(found[:3], self.scene.table, found[3:10], self.scene.obstacles)
        return bool(found[10])

    def carry_out(self, command: Any) -> bool:
        """Send an `ArmCommand` to the servos; returns whether the object is then in the air."""
        arm = next(k for k, a in enumerate(self.robot.arms) if a.name == command.arm)
        model = self.physics.model(arm, 0)
        data, servos = put(model, self.scene), {j.name: j for j in (*model.arm, *model.fingers)}
        names = [*command.joints, *command.gripper]
        targets = np.concatenate([command.positions, command.openings], 1)
        began = [servos[name].open for name in names]
        times, targets = np.array([0.0, *command.times]), np.vstack([began, targets])
        tick = STEPS * model.model.opt.timestep
        for now in np.arange(tick, times[-1] + HOLD, tick):
            for name, column in zip(names, targets.T, strict=True):
                servo = servos[name]
                later = np.interp(now + servo.lag, times, column)  # what damping holds back
                data.ctrl[servo.ctrl] = later
            data.ctrl[:3] = 5 * (self.scene.pose - data.qpos[:3])  # the base stays where it is
            mujoco.mj_step(model.model, data, STEPS)
        thing = thing_of(model)
        held = bool(thing[2] > self.scene.thing[2] + 0.05)
        if not held:
            self.scene = Scene(self.scene.pose, self.scene.table, thing, self.scene.obstacles)
        return held


def states_of(skill: ModuleType, robot: SimulatedRobot) -> dict[str, Any]:
    """The exported skill's classes, with their methods implemented."""

    class Drive(skill.MoveBase):  # type: ignore[misc, name-defined]
        def move(self, userdata: Any, *motion: float) -> bool:
            done = robot.move(*motion)
            userdata.percept = robot.look()
            return done

    class Look(skill.Detect):  # type: ignore[misc, name-defined]
        def detect(self, userdata: Any) -> list[float]:
            return robot.look()

    class Grip(skill.Grasp):  # type: ignore[misc, name-defined]
        def plan(self, userdata: Any) -> Any:
            found = arm_command(robot.robot, torch.tensor(userdata.percept))
            return None if found is None else skill.ArmCommand(**found)

        def carry_out(self, command: Any) -> bool:
            return robot.carry_out(command)

    return {"MoveBase": Drive, "Detect": Look, "Grasp": Grip}


def module_of(path: Path) -> ModuleType:
    """An exported state machine, which is executed; use only files that you trust."""
    spec = importlib.util.spec_from_file_location("exported_skill", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is no Python file; give one that cgtorch-export has written")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def main(words: Sequence[str]) -> None:
    """Run a skill on a random scenario; the words are a file and, optionally, a seed."""
    seed = int(words[1]) if len(words) > 1 else 0
    scenario = draw_of("perimeter")(1, torch.Generator().manual_seed(seed))
    skill, robot = module_of(Path(words[0])), SimulatedRobot(load_robot(), scenario)
    print(skill.run(robot.look(), states_of(skill, robot)))  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
