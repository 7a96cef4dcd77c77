"""The kinematic tabletop world, in place of the real robot in all experiments (section VI)."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import torch
from torch import Tensor

from cgtorch.ground.environment import Lanes
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import moved, rectangle_in_frame, to_frame
from cgtorch.tabletop.world.observed import LAB_NOISE, Noise, ObservedTabletop
from cgtorch.tabletop.world.scenarios import Scenarios

Graspable: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Maps object positions (n, 3) and tables (n, 6) in the base frame to (n,) bool."""


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
