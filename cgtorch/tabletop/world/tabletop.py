"""The tabletop: percepts and states of all its worlds, and the kinematic one of section VI."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import moved, rectangle_in_frame, to_frame
from cgtorch.tabletop.world.percepts import (
    BOX,
    PERCEPTS,
    TABLETOP,
    obstacles_seen,
    percept_of,
    present,
    side_seen,
)
from cgtorch.tabletop.world.scenarios import Scenarios


@dataclass(frozen=True)
class Noise:
    """Standard deviations of motions and percepts.

    Attributes:
        position: Of each coordinate after a motion, and of each number of a percept, m.
        heading: Of the heading after a motion, rad.
        repeats: Whether a scenario's noise is always the same. If not, it is drawn anew at every
            motion and look, from the operating system's random numbers.
    """

    position: float
    heading: float
    repeats: bool = True


Graspable: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps object positions (n, 3) and tables (n, 6) in the base frame to (n,) bool."""

LAB_NOISE = Noise(0.005, torch.pi / 360)
"""The noise of a good lab robot: 5 mm and 0.5°."""


_CHANCE = Generator()
_CHANCE.seed()  # from the operating system: noise that nothing can repeat


def draw_noise(seed: Tensor, looks: int, *sizes: int) -> list[Tensor]:
    """(B, looks, size) standard normal numbers that depend only on each scenario's own seed.

    Sizes are drawn in turn, so earlier numbers do not depend on later sizes.
    """
    generator = Generator()
    out = [torch.empty(len(seed), looks, size) for size in sizes]
    for row, value in enumerate(seed.tolist()):
        generator.manual_seed(value)
        for noise in out:
            noise[row] = torch.randn(looks, noise.shape[2], generator=generator)
    return out


class ObservedTabletop(ABC):
    """An `Environment` of B scenarios; a subclass defines the results of motions and grasps.

    A percept is that of `cgtorch.tabletop.world.percepts`, with noise on everything present. A
    lane's state (n, 12 + 5K) is base pose (3), table (6), object (2), the number of percepts so
    far, and K obstacles; subclasses may append more. The noise of a lane depends only on its
    scenario's seed and on that number. So it depends neither on other lanes nor on how the skill is
    nested in another one.
    """

    control_size = 3

    def __init__(
        self,
        scenarios: Scenarios,
        footprint: tuple[float, float, float, float],
        noise: Noise,
        looks: int,
        percept: str,
    ):
        """Set up the percepts of B scenarios.

        The base's footprint is x min, x max, y min, y max (m). Noise is drawn for `looks` percepts;
        later ones repeat it. `percept` is a key of `PERCEPTS`, else a SettingsError is raised.
        """
        if percept not in PERCEPTS:
            raise SettingsError(f"percept is {percept!r}; use one of {', '.join(PERCEPTS)}")
        self.tabletop = PERCEPTS[percept]
        self.scenarios, self.looks = scenarios, looks
        self.footprint = torch.tensor(footprint)
        self.num_obstacles = scenarios.obstacles.shape[1]
        self.noise = noise
        sizes = (3 + TABLETOP, self.tabletop - TABLETOP, BOX * self.num_obstacles)
        seed = scenarios.seed if noise.repeats else scenarios.seed[:0]
        drawn, *more = draw_noise(seed, looks, *sizes)
        self._scale = torch.tensor([noise.position, noise.position, noise.heading])
        self.drift = drawn[..., :3] * self._scale
        self.blur = torch.cat([drawn[..., 3:], *more], 2) * noise.position

    @property
    def num_scenarios(self) -> int:
        """B."""
        return len(self.scenarios)

    @property
    def seeds(self) -> Tensor:
        """See `cgtorch.ground.environment.Seeded.seeds`; they are those of the noise."""
        return self.scenarios.seed

    @property
    def percept_size(self) -> int:
        """7 or 9, and 4 for each obstacle that a scenario of this batch may have."""
        return self.tabletop + BOX * self.num_obstacles

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        s = self.scenarios[scenario]
        looks = s.pose.new_zeros(len(scenario), 1)
        state = torch.cat([s.pose, s.table, s.object, looks, s.obstacles.flatten(1)], 1)
        return self._perceive(state, scenario)

    @abstractmethod
    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Drive straight by dx, dy (m) and turn by dθ (rad).

        The control (n, 3) is in the robot's frame; also (n,) bool, which lanes have moved.
        """

    @abstractmethod
    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """The lanes after a grasp, and (n,) 1 if it succeeds, else 0."""

    def observe(self, lanes: Lanes) -> Lanes:
        """Detect table, object and obstacles again, with fresh noise."""
        state, percept = self._perceive(lanes.state, lanes.scenario)
        return replace(lanes, state=state, percept=percept)

    def drift_at(self, scenario: Tensor, look: Tensor) -> Tensor:
        """(n, 3) by how much motions of scenarios (n,) miss: m, m and rad."""
        return self._noise_at(self.drift, self._scale, scenario, look)

    def _noise_at(self, seeded: Tensor, scale: Tensor, scenario: Tensor, look: Tensor) -> Tensor:
        """(n, k) noise: that of the scenarios' seeds, or drawn anew if noise does not repeat."""
        if self.noise.repeats:
            return seeded[scenario, look]
        return torch.randn(len(scenario), seeded.shape[2], generator=_CHANCE) * scale

    def _parts(self, state: Tensor) -> tuple[Tensor, ...]:
        """Pose (n, 3), table (n, 6), object (n, 2), whose noise (n,), obstacles (n, K, 5)."""
        boxes = 5 * self.num_obstacles
        pose, table, placed, count, obstacles = state[:, : 12 + boxes].split([3, 6, 2, 1, boxes], 1)
        look = count[:, 0].long() % self.looks
        return pose, table, placed, look, obstacles.unflatten(1, (self.num_obstacles, 5))

    def placed(self, state: Tensor) -> Tensor:
        """(n, 3) where the object is, m."""
        _, table, placed, _, _ = self._parts(state)
        return torch.cat([placed, table[:, 5:6]], 1)

    def exact(self, state: Tensor) -> Tensor:
        """The percepts (n, 7) of table and object, without noise."""
        pose, table, placed, _, _ = self._parts(state)
        return percept_of(pose, table, placed)

    def _perceive(self, state: Tensor, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """The states after one more percept, and the percept (n, D)."""
        pose, table, _, look, obstacles = self._parts(state)
        exact = self.exact(state)
        if self.tabletop > TABLETOP:
            exact = torch.cat([exact, side_seen(pose, table)], 1)
        blur = self._noise_at(self.blur, self._scale[:1], scenario, look)
        percept = exact + blur[:, : self.tabletop]
        if self.num_obstacles:
            noise = blur[:, self.tabletop :] * present(obstacles).repeat_interleave(BOX, 1)
            percept = torch.cat([percept, obstacles_seen(pose, obstacles) + noise], 1)
        return torch.cat([state[:, :11], state[:, 11:12] + 1, state[:, 12:]], 1), percept


class TabletopWorld(ObservedTabletop):
    """An `Environment` of B scenarios in the true world, without dynamics."""

    def __init__(
        self,
        scenarios: Scenarios,
        graspable: Graspable,
        footprint: tuple[float, float, float, float],
        noise: Noise = LAB_NOISE,
        looks: int = 64,
        percept: str = "box",
    ):
        """Set up the world of B scenarios; see `ObservedTabletop`.

        A grasp is possible if an arm can reach the object without collision (`graspable`).
        """
        super().__init__(scenarios, footprint, noise, looks, percept)
        self.graspable = graspable

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Drive straight by dx, dy (m) and turn by dθ (rad), or stay if the motion is blocked.

        The control (n, 3) is in the robot's frame. Also returned is (n,) bool, which lanes have
        moved.
        """
        pose, table, _, looks, obstacles = self._parts(lanes.state)
        things = torch.cat([table[:, None, :5], obstacles], 1)
        here = rectangle_in_frame(pose[:, None], things)
        free = motion_possible(control, here, self.footprint)
        drift = self.drift_at(lanes.scenario, looks)
        state = torch.cat([moved(pose, control + drift), lanes.state[:, 3:]], 1)
        state, percept = self._perceive(state, lanes.scenario)
        state = torch.where(free[:, None], state, lanes.state)
        percept = torch.where(free[:, None], percept, lanes.percept)
        return replace(lanes, state=state, percept=percept), free

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """The lanes, and (n,) 1 if a grasp would succeed, else 0."""
        pose, table, placed, _, _ = self._parts(lanes.state)
        at = torch.cat([to_frame(pose, placed), table[:, 5:6]], 1)
        seen = torch.cat([rectangle_in_frame(pose, table[:, :5]), table[:, 5:6]], 1)
        return lanes, self.graspable(at, seen).to(lanes.percept.dtype)
