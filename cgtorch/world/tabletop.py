"""The tabletop world, which stands for the real robot in all experiments (section VI)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.environment import Lanes
from cgtorch.world.geometry import (
    bounding_box,
    moved,
    rectangle_in_frame,
    sweep_blocked,
    to_frame,
)
from cgtorch.world.scenarios import Scenarios

MAX_TRANSLATION = 2.5  # m; a navigation goal further away is refused
CLEARANCE = 0.02  # m kept between base and table, four times the odometry noise

Graspable: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Object positions (n, 3) and tables (n, 6) in the base frame to (n,) bool."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what the robot does and sees.

    Attributes:
        position: m, of each coordinate after a motion and of each number of a percept.
        heading: rad, of the heading after a motion.
    """

    position: float = 0.005
    heading: float = torch.pi / 360  # 0.5°


def percept_of(pose: Tensor, table: Tensor, placed: Tensor) -> Tensor:
    """The percept (..., 7) without noise: table box and object in the base frame (m).

    Args:
        pose: (..., 3) base pose.
        table: (..., 6) table in the world.
        placed: (..., 2) object in the world.
    """
    box = bounding_box(rectangle_in_frame(pose, table[..., :5]))
    return torch.cat([box, to_frame(pose, placed), table[..., 5:6]], -1)


class TabletopWorld:
    """An `Environment` of B scenarios in the true world.

    A lane's state (n, 11) is base pose (3), table (6) and object (2). Noise is drawn once for
    each scenario and step, so a rollout does not depend on what else runs beside it.
    """

    percept_size = 7
    control_size = 3

    def __init__(
        self,
        scenarios: Scenarios,
        graspable: Graspable,
        footprint: tuple[float, float, float, float],
        generator: Generator,
        noise: Noise | None = None,
        steps: int = 64,
    ):
        """Set up the world.

        Args:
            scenarios: the B scenarios.
            graspable: whether a collision-free arm solution exists.
            footprint: base x min, x max, y min, y max (m).
            generator: for the noise.
            noise: its size, default that of a good lab robot (5 mm, 0.5°).
            steps: for how many steps noise is drawn; later ones repeat it.
        """
        noise = noise or Noise()
        self.scenarios, self.graspable, self.steps = scenarios, graspable, steps
        self.footprint = torch.tensor(footprint)
        shape = (len(scenarios), steps + 1)
        drift = torch.randn(*shape, 3, generator=generator)
        self.drift = drift * torch.tensor([noise.position, noise.position, noise.heading])
        self.blur = torch.randn(*shape, 7, generator=generator) * noise.position

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.scenarios)

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        s = self.scenarios[scenario]
        state = torch.cat([s.pose, s.table, s.object], 1)
        return state, self._perceive(state, scenario, torch.full_like(scenario, -1))

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Drive straight by dx, dy and turn by dθ, or stay where the way is blocked."""
        pose, table = lanes.state[:, :3], lanes.state[:, 3:9]
        here = rectangle_in_frame(pose, table[:, :5])
        free = ~sweep_blocked(control, here, self.footprint, CLEARANCE)
        free &= control[:, :2].norm(dim=1) <= MAX_TRANSLATION
        drift = self.drift[lanes.scenario, lanes.step % self.steps]
        pose = torch.where(free[:, None], moved(pose, control + drift), pose)
        state = torch.cat([pose, lanes.state[:, 3:]], 1)
        percept = self._perceive(state, lanes.scenario, lanes.step)
        percept = torch.where(free[:, None], percept, lanes.percept)
        return replace(lanes, state=state, percept=percept), free

    def observe(self, lanes: Lanes) -> Lanes:
        """Detect table and object again, with fresh noise."""
        percept = self._perceive(lanes.state, lanes.scenario, lanes.step)
        return replace(lanes, percept=percept)

    def success(self, lanes: Lanes) -> Tensor:
        """(n,) 1 where a grasp would succeed, 0 elsewhere."""
        pose, table = lanes.state[:, :3], lanes.state[:, 3:9]
        at = torch.cat([to_frame(pose, lanes.state[:, 9:11]), table[:, 5:6]], 1)
        seen = torch.cat([rectangle_in_frame(pose, table[:, :5]), table[:, 5:6]], 1)
        return self.graspable(at, seen).to(lanes.percept.dtype)

    def _perceive(self, state: Tensor, scenario: Tensor, step: Tensor) -> Tensor:
        exact = percept_of(state[:, :3], state[:, 3:9], state[:, 9:11])
        # The last column of the drawn noise belongs to the first look.
        index = torch.where(step < 0, self.steps, step % self.steps)
        return exact + self.blur[scenario, index]
