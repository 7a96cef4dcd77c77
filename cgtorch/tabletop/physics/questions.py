"""Simulations with a memo of their results, in several processes.

An input is a row of numbers, and its result depends on it alone. So it does not matter what else is
simulated, in which process, or whether the result comes from the memo.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeAlias

import numpy
import torch
from torch import Tensor

from cgtorch import native
from cgtorch.ground import distributed
from cgtorch.ground.processes import counted, in_processes
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.drive import Watch, drive
from cgtorch.tabletop.physics.grasp import grasp
from cgtorch.tabletop.physics.model import Model, build
from cgtorch.tabletop.physics.plan import SEEN, planned, way_of
from cgtorch.tabletop.physics.scene import Scene
from cgtorch.tabletop.physics.thing import Thing

Answer: TypeAlias = Callable[["Physics", Tensor], Tensor]
"""Maps rows of inputs (n, Q) to rows of results (n, A), independently."""

PARTS = 8  # of the questions for each process: those that are ready early take another
WORTH_SHARING = 6  # questions for which processes are begun


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
    watch: Callable[[Model], None] | None = None

    def watch_of(self, model: Model) -> Watch | None:
        """The observer of a simulation of this model, or None."""
        watch = self.watch
        return None if watch is None else lambda _: watch(model)

    def model(self, arm: int | None, boxes: int) -> Model:
        """The model in which an arm, or only the base with None, moves; it is made once."""
        if (arm, boxes) not in self.models:
            self.models[arm, boxes] = build(self.robot, arm, boxes, self.thing)
        return self.models[arm, boxes]


def drives(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 11) base pose, object and whether it arrived, for scenes and goals (n, 16 + 5 K + 3)."""
    return _asked(physics, "motions", _drives, rows)


def grasps(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 9) whether the object is lifted, whether the arm touched anything, and the object's pose.

    Inputs are scenes and where the object is seen (n, 16 + 5 K + 3).
    """
    return _asked(physics, "grasps", _grasps, rows)


def _asked(physics: Physics, what: str, answer: Answer, rows: Tensor) -> Tensor:
    """Results (n, A), from the memo or simulated now."""
    if physics.watch is not None:
        return answer(physics, rows)
    keys = [what.encode() + row.tobytes() for row in rows.numpy()]
    new = {key: row for row, key in reversed([*enumerate(keys)]) if key not in physics.memo}
    order = sorted(new.values())
    if order:
        found = _found(physics, what, answer, rows[order])
        physics.memo.update((keys[row], one) for row, one in zip(order, found, strict=True))
    if not keys:
        return answer(physics, rows)
    return torch.stack([physics.memo[key] for key in keys])


def _found(physics: Physics, what: str, answer: Answer, rows: Tensor) -> Tensor:
    """Results (n, A), simulated on all ranks, and on each in several processes."""
    count = len(rows)
    if count < WORTH_SHARING:
        return answer(physics, rows)
    mine = rows[distributed.share(count)]
    for arm in (None, *range(len(physics.robot.arms))):
        physics.model(arm, (rows.shape[1] - 16 - SEEN) // 5)  # which processes then need not make
    parts = max(1, min(len(mine) // 2, PARTS * native.threads()))
    bounds = [*pairwise(torch.linspace(0, len(mine), parts + 1).long().tolist())]

    def work(part: int) -> Tensor:
        return answer(physics, mine[slice(*bounds[part])])

    more = counted(f"{what} in physics", len(mine))
    found = in_processes(work, parts, native.threads(), lambda part: more(len(part)))
    return distributed.all_gather(torch.cat(found), count)


def _drives(physics: Physics, rows: Tensor) -> Tensor:
    model = physics.model(None, (rows.shape[1] - 16 - SEEN) // 5)
    watch = physics.watch_of(model)
    out = [drive(model, Scene.of(row[:-SEEN]), row[-SEEN:], watch) for row in rows.double().numpy()]
    return _as_tensor(out, 11)


def _grasps(physics: Physics, rows: Tensor) -> Tensor:
    ways, boxes = planned(physics.robot, rows), (rows.shape[1] - 16 - SEEN) // 5
    out = []
    for i, row in enumerate(rows.double().numpy()):
        scene = Scene.of(row[:-SEEN])
        if not bool(ways.found[i]):
            out.append(numpy.array([0.0, 0.0, *scene.thing]))
            continue
        model = physics.model(int(ways.arm[i]), boxes)
        way = way_of(physics.robot, ways, i)
        out.append(grasp(model, scene, way, physics.watch_of(model)))
    return _as_tensor(out, 9)


def _as_tensor(rows: list[numpy.ndarray], width: int) -> Tensor:
    return torch.tensor(numpy.array(rows).reshape(-1, width), dtype=torch.float32)
