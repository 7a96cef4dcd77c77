"""The tabletop world with physics: motions and grasps are simulated, and can fail."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.physics.questions import Physics, drives, grasps
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import moved, rectangle_in_frame, wrap
from cgtorch.tabletop.world.observed import LAB_NOISE, Noise, ObservedTabletop
from cgtorch.tabletop.world.percepts import TABLETOP
from cgtorch.tabletop.world.scenarios import Scenarios

TOUCH = ("fails", "allowed")
"""Whether a grasp has failed if the arm touched table or robot."""
EXTRA = 6
"""Additional columns of a state: height of the object's centre (m), its quaternion (4), w first,
and 1 if an arm has touched anything but the object, else 0."""


class MujocoWorld(ObservedTabletop):
    """The same robot, scenarios, percepts and noise, with masses, friction, servos and contacts.

    A motion is refused if it is not clear, as in `TabletopWorld`. Otherwise the base drives it; if
    it touches something, it stops and the motion has failed. A grasp is planned for where the
    object is seen. It succeeds if the object is lifted and held. A lifted object is put back;
    otherwise it stays wherever it is. A state has `EXTRA` additional columns.
    """

    def __init__(
        self,
        scenarios: Scenarios,
        physics: Physics,
        noise: Noise = LAB_NOISE,
        looks: int = 64,
        percept: str = "box",
        touch: str = "fails",
    ):
        """Set up the world of B scenarios; see `ObservedTabletop`, and `TOUCH`."""
        if touch not in TOUCH:
            raise SettingsError(f"touch is {touch!r}; use one of {', '.join(TOUCH)}")
        footprint = physics.robot.description.footprint
        super().__init__(scenarios, footprint, noise, looks, percept)
        self.physics, self.touch = physics, touch

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`: the object stands upright."""
        s = self.scenarios[scenario]
        looks, n = s.pose.new_zeros(len(scenario), 1), len(scenario)
        centre = s.table[:, 5:6] + self.physics.thing.half_height
        upright = s.pose.new_tensor([1.0, 0, 0, 0, 0]).expand(n, 5)
        parts = [s.pose, s.table, s.object, looks, s.obstacles.flatten(1), centre, upright]
        return self._perceive(torch.cat(parts, 1), scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Drive straight by dx, dy (m) and turn by dθ (rad); see `ObservedTabletop.step`.

        A lane that touches something has moved, but its motion has failed.
        """
        pose, table, _, looks, obstacles = self._parts(lanes.state)
        here = rectangle_in_frame(pose[:, None], torch.cat([table[:, None, :5], obstacles], 1))
        free = motion_possible(control, here, self.footprint)
        rows = free.nonzero()[:, 0]
        goal = moved(pose, control + self.drift_at(lanes.scenario, looks))[rows]
        found = drives(self.physics, torch.cat([self.scene(lanes.state[rows]), goal], 1))
        state = lanes.state.clone()
        state[rows, :2], state[rows, 2] = found[:, :2], wrap(found[:, 2])
        state[rows] = self._with_thing(state[rows], found[:, 3:10])
        seen, percept = self._perceive(state, lanes.scenario)
        state = torch.where(free[:, None], seen, lanes.state)
        percept = torch.where(free[:, None], percept, lanes.percept)
        done = free.clone()
        done[rows] = found[:, 10] > 0.5
        return replace(lanes, state=state, percept=percept), done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """The lanes after a grasp, and (n,) 1 if it succeeded, else 0."""
        state = lanes.state
        seen = torch.cat([lanes.percept[:, 4:6], state[:, -EXTRA, None]], 1)
        found = grasps(self.physics, torch.cat([self.scene(state), seen], 1))
        lifted, touched = (found[:, i] > 0.5 for i in (0, 1))
        after = self._with_thing(state, found[:, 2:9])
        after = torch.cat([after[:, :-1], after[:, -1:].maximum(found[:, 1:2])], 1)
        good = lifted & ~touched if self.touch == "fails" else lifted
        return replace(lanes, state=after), good.to(lanes.percept.dtype)

    def placed(self, state: Tensor) -> Tensor:
        """See `ObservedTabletop.placed`; for a lying object it is equally far below its centre."""
        foot = state[:, -EXTRA, None] - self.physics.thing.half_height
        return torch.cat([super().placed(state)[:, :2], foot], 1)

    def exact(self, state: Tensor) -> Tensor:
        """See `ObservedTabletop.exact`; the object's z is that of `placed`."""
        seen = super().exact(state)[:, : TABLETOP - 1]
        return torch.cat([seen, self.placed(state)[:, 2:]], 1)

    def scene(self, state: Tensor) -> Tensor:
        """(n, 16 + 5 K) rows for `cgtorch.tabletop.physics.scene.Scene.of`, from states."""
        pose, table, placed, _, obstacles = self._parts(state)
        thing = torch.cat([placed, state[:, -EXTRA:-1]], 1)
        return torch.cat([pose, table, thing, obstacles.flatten(1)], 1)

    def _with_thing(self, state: Tensor, thing: Tensor) -> Tensor:
        """States with the object's pose (n, 7)."""
        middle = state[:, 11 : state.shape[1] - EXTRA]
        return torch.cat([state[:, :9], thing[:, :2], middle, thing[:, 2:], state[:, -1:]], 1)
