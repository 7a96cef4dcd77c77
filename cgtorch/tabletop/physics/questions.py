"""Asking physics, never the same question twice, many questions in several processes.

A question is a row of numbers, and its answer follows from it alone. So it does not matter what
else is asked, in which process, or whether it is remembered.
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
from cgtorch.ground.processes import in_processes
from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.physics.drive import Watch, drive
from cgtorch.tabletop.physics.grasp import grasp
from cgtorch.tabletop.physics.model import Model, build
from cgtorch.tabletop.physics.plan import SEEN, planned, way_of
from cgtorch.tabletop.physics.scene import Scene
from cgtorch.tabletop.physics.thing import Thing

Answer: TypeAlias = Callable[["Physics", Tensor], Tensor]
"""Rows of questions (n, Q) to rows of answers (n, A), each by itself."""

PARTS = 8  # of the questions for each process: those that are ready early take another
WORTH_SHARING = 6  # questions for which processes are begun


@dataclass(frozen=True, eq=False)
class Physics:
    """What is simulated, and what is known of it.

    Attributes:
        robot: the robot.
        thing: the object.
        memo: answers by question.
        models: compiled models, by the arm that moves and the number of obstacles.
        watch: is told of a model after every command to its servos; then nothing is remembered.
    """

    robot: Robot
    thing: Thing = field(default_factory=Thing)
    memo: dict[bytes, Tensor] = field(default_factory=dict)
    models: dict[tuple[int | None, int], Model] = field(default_factory=dict)
    watch: Callable[[Model], None] | None = None

    def watch_of(self, model: Model) -> Watch | None:
        """What a simulation of a model is watched by."""
        watch = self.watch
        return None if watch is None else lambda _: watch(model)

    def model(self, arm: int | None, boxes: int) -> Model:
        """The model in which an arm moves, or with None the base, made once."""
        if (arm, boxes) not in self.models:
            self.models[arm, boxes] = build(self.robot, arm, boxes, self.thing)
        return self.models[arm, boxes]


def drives(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 11) base pose, object and whether it came, of scenes and goals (n, 16 + 5 K + 3)."""
    return _asked(physics, b"drive", _drives, rows)


def grasps(physics: Physics, rows: Tensor) -> Tensor:
    """(n, 9) whether the object is lifted, the arm touched anything, and where the object is then.

    Of scenes and where the object is seen (n, 16 + 5 K + 3).
    """
    return _asked(physics, b"grasp", _grasps, rows)


def _asked(physics: Physics, what: bytes, answer: Answer, rows: Tensor) -> Tensor:
    """Answers (n, A), from the memo or found out now."""
    if physics.watch is not None:
        return answer(physics, rows)
    keys = [what + row.tobytes() for row in rows.numpy()]
    new = {key: row for row, key in reversed([*enumerate(keys)]) if key not in physics.memo}
    order = sorted(new.values())
    if order:
        found = _found(physics, answer, rows[order])
        physics.memo.update((keys[row], one) for row, one in zip(order, found, strict=True))
    if not keys:
        return answer(physics, rows)
    return torch.stack([physics.memo[key] for key in keys])


def _found(physics: Physics, answer: Answer, rows: Tensor) -> Tensor:
    """Answers (n, A), shared out among all ranks, and on each among processes."""
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

    return distributed.all_gather(torch.cat(in_processes(work, parts, native.threads())), count)


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
