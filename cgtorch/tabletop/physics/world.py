"""The tabletop world with physics: motions and grasps are simulated, and can fail.

A simulation's input is a row of numbers, and its result depends on it alone: not on what else is
simulated, nor in which process, nor on whether the result is remembered.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TypeAlias

import numpy
import torch
from torch import Tensor

from cgtorch import native
from cgtorch.ground import distributed
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.native.processes import counted, in_processes
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.drive import drive
from cgtorch.tabletop.physics.grasp import SEEN, grasp, planned, way_of
from cgtorch.tabletop.physics.model import Model, Thing, Watch, build
from cgtorch.tabletop.physics.scene import Scene
from cgtorch.tabletop.world.clear_motion import motion_possible
from cgtorch.tabletop.world.geometry import moved, rectangle_in_frame, wrap
from cgtorch.tabletop.world.percepts import TABLETOP
from cgtorch.tabletop.world.scenarios import Scenarios
from cgtorch.tabletop.world.tabletop import LAB_NOISE, Noise, ObservedTabletop

Simulate: TypeAlias = Callable[["Physics", Tensor], Tensor]
"""Maps rows of inputs (n, Q) to rows of results (n, A), independently."""

PARTS = 8  # of the simulations of each process: those that are ready early take another
WORTH_SHARING = 6  # simulations for which processes are begun
TOUCH = ("fails", "allowed")
"""Whether a grasp has failed if the arm touched table or robot."""
EXTRA = 6
"""Additional columns of a state: height of the object's centre (m), its quaternion (4), w first,
and 1 if an arm has touched anything but the object, else 0."""


@dataclass(frozen=True, eq=False)
class Physics:
    """The simulated robot and object, and known results.

    Attributes:
        robot: The robot.
        thing: The object.
        memo: Results by input.
        models: Compiled models, by the moving arm and the number of obstacles.
        watch: Is called with a model after every command to its servos; then there is no memo.
    """

    robot: Robot
    thing: Thing = field(default_factory=Thing)
    memo: dict[bytes, Tensor] = field(default_factory=dict)
    models: dict[tuple[int | None, int], Model] = field(default_factory=dict)
    watch: Watch | None = None

    def model(self, arm: int | None, boxes: int) -> Model:
        """The model in which an arm, or only the base with None, moves; it is made once."""
        if (arm, boxes) not in self.models:
            self.models[arm, boxes] = build(self.robot, arm, boxes, self.thing)
        return self.models[arm, boxes]


def drives(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 11) base pose, object and whether it arrived, for scenes and goals (n, 16 + 5 K + 3)."""
    return _remembered(physics, "motions", _drives, rows)


def grasps(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 9) whether the object is lifted, whether the arm touched anything, and the object's pose.

    Inputs are scenes and where the object is seen (n, 16 + 5 K + 3).
    """
    return _remembered(physics, "grasps", _grasps, rows)


def _remembered(physics: Physics, what: str, simulate: Simulate, rows: Tensor) -> Tensor:
    """Results (n, A), from the memo or simulated now."""
    if physics.watch is not None or not len(rows):
        return simulate(physics, rows)
    keys = [what.encode() + row.tobytes() for row in rows.numpy()]
    new = {key: row for row, key in reversed([*enumerate(keys)]) if key not in physics.memo}
    order = sorted(new.values())
    if order:
        found = _shared(physics, what, simulate, rows[order])
        physics.memo.update((keys[row], one) for row, one in zip(order, found, strict=True))
    return torch.stack([physics.memo[key] for key in keys])


def _shared(physics: Physics, what: str, simulate: Simulate, rows: Tensor) -> Tensor:
    """Results (n, A), simulated on all ranks, and on each in several processes."""
    count = len(rows)
    if count < WORTH_SHARING:
        return simulate(physics, rows)
    mine = rows[distributed.share(count)]
    for arm in (None, *range(len(physics.robot.arms))):
        physics.model(arm, _boxes(rows))  # which processes then need not make
    parts = max(1, min(len(mine) // 2, PARTS * native.threads()))
    bounds = [*pairwise(torch.linspace(0, len(mine), parts + 1).long().tolist())]

    def work(part: int) -> Tensor:
        return simulate(physics, mine[slice(*bounds[part])])

    more = counted(f"{what} in physics", len(mine))
    found = in_processes(work, parts, native.threads(), lambda part: more(len(part)))
    return distributed.all_gather(torch.cat(found), count)


def _boxes(rows: Tensor) -> int:
    """The number of obstacles in rows (n, 16 + 5 K + 3)."""
    return (rows.shape[1] - 16 - SEEN) // 5


def _drives(physics: Physics, rows: Tensor) -> Tensor:
    model = physics.model(None, _boxes(rows))
    pairs = ((Scene.of(row[:-SEEN]), row[-SEEN:]) for row in rows.double().numpy())
    return _as_tensor([drive(model, scene, goal, physics.watch) for scene, goal in pairs], 11)


def _grasps(physics: Physics, rows: Tensor) -> Tensor:
    robot, ways = physics.robot, planned(physics.robot, rows)
    out = []
    for i, row in enumerate(rows.double().numpy()):
        scene = Scene.of(row[:-SEEN])
        if bool(ways.found[i]):
            model = physics.model(int(ways.arm[i]), _boxes(rows))
            out.append(grasp(model, scene, way_of(robot, ways, i), physics.watch))
        else:
            out.append(numpy.array([0.0, 0.0, *scene.thing]))
    return _as_tensor(out, 9)


def _as_tensor(rows: list[numpy.ndarray], width: int) -> Tensor:
    return torch.tensor(numpy.array(rows).reshape(-1, width), dtype=torch.float32)


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
        done[rows] = found[:, 10].bool()
        return replace(lanes, state=state, percept=percept), done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """The lanes after a grasp, and (n,) 1 if it succeeded, else 0."""
        state = lanes.state
        seen = torch.cat([lanes.percept[:, 4:6], state[:, -EXTRA, None]], 1)
        found = grasps(self.physics, torch.cat([self.scene(state), seen], 1))
        lifted, touched = found[:, :2].bool().unbind(1)
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
