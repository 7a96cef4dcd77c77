"""Grasps from poses of the base: those that `graspable` accepts, and those that it refuses."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from solvability.finer import finer_search
from torch import Generator, Tensor

from cgtorch.commands.common import waiting
from cgtorch.tabletop.data import Scenes, label, poses_at_object
from cgtorch.tabletop.domain import Tabletop
from cgtorch.tabletop.kinematics.grasping import within_reach
from cgtorch.tabletop.physics import Physics, Thing
from cgtorch.tabletop.settings import TabletopSettings
from cgtorch.tabletop.world import Scenarios
from in_physics.tried import Rows, Sizes, Tried

SEED = 22_000_001
"""Of the poses, which nothing was tuned on."""
DRAWN = 2000  # poses at once
PART = 10  # grasps between two signs of progress
THINGS = {
    **{f"a radius of {r} mm": Thing(size=(r / 1000, 0.05)) for r in (15, 20, 30, 35, 38)},
    "a box of 50 mm": Thing("box", (0.025, 0.025, 0.05)),
}
"""Objects other than the cylinder of 25 mm that grasps are planned for."""


def accepted(folder: Path, sizes: Sizes) -> Rows:
    """The PR2, from poses from which `graspable` finds a way."""
    about = "PR2, poses from which there is a way"
    yield about, partial(from_poses, "pr2", Thing(), sizes.count, about, "99.5 %, 98 %")


def fetch(folder: Path, sizes: Sizes) -> Rows:
    """The Fetch, from fewer such poses."""
    about = "Fetch, poses from which there is a way"
    yield about, partial(from_poses, "fetch", Thing(), sizes.fewer, about, "–")


def objects(folder: Path, sizes: Sizes) -> Rows:
    """Other objects, from fewer such poses."""
    for name, thing in THINGS.items():
        about = f"PR2, such poses, {name}"
        yield about, partial(from_poses, "pr2", thing, sizes.fewer, about, "98 %")


def refused(folder: Path, sizes: Sizes) -> Rows:
    """Poses that are refused though an arm is long enough, by a finer search."""
    about = "PR2, poses that are refused though within reach, by a finer search"
    yield about, partial(from_refused, sizes.fewer, about)


def from_poses(robot: str, thing: Thing, count: int, about: str, asked: str) -> Tried:
    """Grasps of an object from poses from which there is a way."""
    domain = without_noise(robot)
    return carried_out(domain, thing, poses(domain, count, True), about, asked)


def from_refused(count: int, about: str) -> Tried:
    """Grasps that a finer search finds from poses that `graspable` refuses."""
    domain = without_noise("pr2")
    chosen = poses(domain, count, False)
    with finer_search():
        possible = in_parts(about, chosen, lambda part: label(Scenes(domain.world), part)[1])
        found = carried_out(domain, Thing(), chosen[possible], about, "3 % at most")
    return replace(found, tried=count)


def without_noise(robot: str) -> Tabletop:
    """The kinematic tabletop where everything is where it is said."""
    return Tabletop(TabletopSettings(robot=robot, position_noise=0, heading_noise=0))


def poses(domain: Tabletop, count: int, possible: bool) -> Scenarios:
    """So many scenarios within reach in which a grasp is possible, or is refused.

    Poses are uniform in side, heading and distance from the object, as labels of C are drawn.
    """
    scenes, generator = Scenes(domain.world), Generator().manual_seed(SEED)
    found = scenes.draw(0, generator)
    while len(found) < count:
        drawn = poses_at_object(scenes, DRAWN, generator)
        percept, graspable = label(scenes, drawn)
        keep = graspable if possible else ~graspable & within_reach(domain.robot, percept[:, 4:7])
        found = found.joined(drawn[keep])
    return found[:count]


def carried_out(
    domain: Tabletop, thing: Thing, scenarios: Scenarios, about: str, asked: str
) -> Tried:
    """Grasps of an object from where the robots are, planned for a cylinder of 25 mm."""
    strict = domain.in_world("mujoco").watched(Physics(domain.robot, thing))
    (allowed,) = strict.other_measures().values()  # which shares what physics has answered

    def lifted(part: Scenarios) -> Tensor:
        return torch.stack(
            [label(Scenes(world), part)[1] for world in (strict.world, allowed.world)], 1
        )

    found = in_parts(about, scenarios, lifted)
    return Tried(about, len(scenarios), int(found[:, 1].sum()), int(found[:, 0].sum()), asked)


def in_parts(about: str, scenarios: Scenarios, answer: Callable[[Scenarios], Tensor]) -> Tensor:
    """Answers (B, ...) on scenarios, with progress."""
    with waiting(about, False, len(scenarios)) as done:
        out = []
        for begin in range(0, max(1, len(scenarios)), PART):
            part = scenarios[begin : begin + PART]
            out.append(answer(part))
            done(len(part))
    return torch.cat(out)
