"""A stand-in for a real robot: the PR2 in physics, in a process of its own.

    python -m cgtorch.tabletop.stand_in --port 7654
    cgtorch-train --driver cgtorch.tabletop.stand_in:StandIn --run-dir runs/robot

The first command is the robot. It keeps one scene, draws its noise from the operating system, and
can neither repeat anything nor be put back. The second one knows nothing of it but the driver.
"""

import json
import os
import socket
import socketserver
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import torch
from torch import Generator

from cgtorch.domains.robot import RobotDriver
from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import RobotError
from cgtorch.ground.files import JsonLines
from cgtorch.tabletop.settings import WORLDS, TabletopSettings

ADDRESS = "CGTORCH_STAND_IN"
"""The environment variable with the robot's address, HOST:PORT."""
HERE = "127.0.0.1:7654"
MOTION, GRASP = 10.0, 20.0  # s that a robot takes


class StandIn(RobotDriver):
    """The driver of the robot at `ADDRESS`."""

    def __init__(self) -> None:
        """Connect; RobotError if there is no robot."""
        self._address = os.environ.get(ADDRESS, HERE)
        host, _, port = self._address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)))
        except (OSError, ValueError) as e:
            raise RobotError(
                f"no stand-in robot answers at {self._address!r}; start it with python -m "
                f"cgtorch.tabletop.stand_in, or set {ADDRESS} to its HOST:PORT"
            ) from e
        self._file = self._socket.makefile("rw")

    def arrange(self, kind: str) -> None:
        """See `RobotDriver.arrange`: another object on the table, the robot before it."""
        self._call("arrange", kind)

    def perceive(self) -> Sequence[float]:
        """See `RobotDriver.perceive`."""
        seen: Sequence[float] = self._call("perceive")
        return seen

    def move_base(self, control: Sequence[float]) -> bool:
        """Drive by dx, dy (m) and turn by dθ (rad)."""
        return bool(self._call("move_base", list(control)))

    def grasp(self) -> bool:
        """Whether the object was grasped and lifted."""
        return bool(self._call("grasp"))

    def _call(self, name: str, *given: Any) -> Any:
        self._file.write(json.dumps([name, *given]) + "\n")
        self._file.flush()
        answer = self._file.readline()
        if not answer:
            raise ConnectionError(f"the stand-in robot at {self._address!r} does not answer")
        return json.loads(answer)


class Scene:
    """The robot's state: its world of one scene, and where it is."""

    world: Environment
    lanes: Lanes

    def __init__(self, settings: TabletopSettings, speed: float, done: JsonLines | None) -> None:
        """A scene on a perimeter; every action is noted in `done`."""
        self.settings, self.speed, self.done = settings, speed, done
        self.arrange("perimeter")

    def arrange(self, kind: str) -> None:
        """Another scene of a kind, by numbers from the operating system."""
        from cgtorch.tabletop.domain import Tabletop

        domain = Tabletop(self.settings).for_run(kind, "compose")
        chance = Generator()
        chance.seed()
        self.world = domain.world(domain.draw(kind, 1, chance))
        self.lanes = start_lanes(self.world, torch.zeros(1, dtype=torch.long), 0, 0)

    def perceive(self) -> list[float]:
        """The percept, seen anew."""
        self.lanes = self.world.observe(self.lanes)
        return [float(x) for x in self.lanes.percept[0]]

    def move_base(self, control: Sequence[float]) -> bool:
        """Whether a motion was carried out."""
        self._wait(MOTION)
        self.lanes, done = self.world.step(self.lanes, torch.tensor([control]))
        self._note("motion")
        return bool(done)

    def grasp(self) -> bool:
        """Whether a grasp succeeded."""
        self._wait(GRASP)
        self.lanes, good = self.world.success(self.lanes)
        self._note("test")
        return bool(good)

    def _note(self, what: str) -> None:
        if self.done is not None:
            self.done.append({"what": what})

    def _wait(self, seconds: float) -> None:
        if self.speed:
            time.sleep(seconds / self.speed)


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True


@click.command()
@click.option("--port", type=click.IntRange(0, 65535), default=7654, show_default=True)
@click.option(
    "--robot", default="pr2", show_default=True, help="The robot: pr2, fetch or a folder."
)
@click.option("--world", type=click.Choice(WORLDS), default="mujoco", show_default=True)
@click.option(
    "--speed",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="How many times faster than a robot it acts: 1 for real time, 0 for as fast as possible.",
)
@click.option("--count", type=click.Path(path_type=Path), help="Note every action in this file.")
def main(port: int, robot: str, world: str, speed: float, count: Path | None) -> None:
    """Be a robot on this machine, for drivers that connect to the port."""
    torch.set_num_threads(1)
    settings = TabletopSettings(robot=robot, world=world, noise="fresh")
    scene = Scene(settings, speed, JsonLines(count) if count else None)

    class Handler(socketserver.StreamRequestHandler):
        """One driver's connection; each line is a call, and its answer is a line."""

        def handle(self) -> None:
            with suppress(ConnectionError):  # a driver may be killed at any moment
                for line in self.rfile:
                    name, *given = json.loads(line)
                    answer = getattr(scene, name)(*given) if name in CALLS else None
                    self.wfile.write((json.dumps(answer) + "\n").encode())

    with _Server(("127.0.0.1", port), Handler) as server:
        click.echo(f"a robot is at 127.0.0.1:{server.server_address[1]}")
        server.serve_forever()


CALLS = ("arrange", "perceive", "move_base", "grasp")

if __name__ == "__main__":
    main()
