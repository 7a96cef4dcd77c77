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

    position: float
    heading: float


LAB_NOISE = Noise(0.005, torch.pi / 360)
"""A good lab robot: 5 mm and 0.5°."""


def motion_possible(motion: Tensor, table: Tensor, footprint: Tensor) -> Tensor:
    """(n,) bool, whether the base can make motions (n, 3) beside tables (n, 5) in its frame.

    False where the swept footprint would come within `CLEARANCE` of the table, beyond
    `MAX_TRANSLATION`, and for motions that are not finite.
    """
    short = motion[:, :2].norm(dim=1) <= MAX_TRANSLATION
    finite = torch.isfinite(motion).all(1)
    return short & finite & ~sweep_blocked(motion, table, footprint, CLEARANCE)


def percept_of(pose: Tensor, table: Tensor, placed: Tensor) -> Tensor:
    """The percept (..., 7) without noise: table box and object in the base frame (m).

    Args:
        pose: (..., 3) base pose.
        table: (..., 6) table in the world.
        placed: (..., 2) object in the world.
    """
    box = bounding_box(rectangle_in_frame(pose, table[..., :5]))
    return torch.cat([box, to_frame(pose, placed), table[..., 5:6]], -1)


def draw_noise(seed: Tensor, looks: int) -> Tensor:
    """(B, looks, 10) standard normal numbers that depend on each scenario's own seed only."""
    generator = Generator()
    rows = [
        torch.randn(looks, 10, generator=generator.manual_seed(value)) for value in seed.tolist()
    ]
    return torch.stack(rows) if rows else torch.zeros(0, looks, 10)


class TabletopWorld:
    """An `Environment` of B scenarios in the true world.

    A lane's state (n, 12) is base pose (3), table (6), object (2) and how often the robot has
    perceived. The noise of a lane depends on its scenario's seed and on that count alone, so it
    depends neither on what else runs beside it nor on how the skill is nested in another one.
    """

    percept_size = 7
    control_size = 3

    def __init__(
        self,
        scenarios: Scenarios,
        graspable: Graspable,
        footprint: tuple[float, float, float, float],
        noise: Noise = LAB_NOISE,
        looks: int = 64,
    ):
        """Set up the world.

        Args:
            scenarios: the B scenarios.
            graspable: whether a collision-free arm solution exists.
            footprint: base x min, x max, y min, y max (m).
            noise: its size, default that of a good lab robot (5 mm, 0.5°).
            looks: for how many percepts noise is drawn; later ones use it again.
        """
        self.scenarios, self.graspable, self.looks = scenarios, graspable, looks
        self.footprint = torch.tensor(footprint)
        drawn = draw_noise(scenarios.seed, looks)
        scale = torch.tensor([noise.position, noise.position, noise.heading])
        self.drift, self.blur = drawn[..., :3] * scale, drawn[..., 3:] * noise.position

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.scenarios)

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        s = self.scenarios[scenario]
        state = torch.cat([s.pose, s.table, s.object, s.pose.new_zeros(len(scenario), 1)], 1)
        return self._perceive(state, scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Drive straight by dx, dy and turn by dθ, or stay where the way is blocked."""
        pose, table = lanes.state[:, :3], lanes.state[:, 3:9]
        here = rectangle_in_frame(pose, table[:, :5])
        free = motion_possible(control, here, self.footprint)
        drift = self.drift[lanes.scenario, self._look(lanes.state)]
        state = torch.cat([moved(pose, control + drift), lanes.state[:, 3:]], 1)
        state, percept = self._perceive(state, lanes.scenario)
        state = torch.where(free[:, None], state, lanes.state)
        percept = torch.where(free[:, None], percept, lanes.percept)
        return replace(lanes, state=state, percept=percept), free

    def observe(self, lanes: Lanes) -> Lanes:
        """Detect table and object again, with fresh noise."""
        state, percept = self._perceive(lanes.state, lanes.scenario)
        return replace(lanes, state=state, percept=percept)

    def success(self, lanes: Lanes) -> Tensor:
        """(n,) 1 where a grasp would succeed, 0 elsewhere."""
        pose, table = lanes.state[:, :3], lanes.state[:, 3:9]
        at = torch.cat([to_frame(pose, lanes.state[:, 9:11]), table[:, 5:6]], 1)
        seen = torch.cat([rectangle_in_frame(pose, table[:, :5]), table[:, 5:6]], 1)
        return self.graspable(at, seen).to(lanes.percept.dtype)

    def _look(self, state: Tensor) -> Tensor:
        return state[:, 11].long() % self.looks

    def _perceive(self, state: Tensor, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """The states after one more look, and what is seen (n, 7)."""
        exact = percept_of(state[:, :3], state[:, 3:9], state[:, 9:11])
        percept = exact + self.blur[scenario, self._look(state)]
        return torch.cat([state[:, :11], state[:, 11:] + 1], 1), percept
