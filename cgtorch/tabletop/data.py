"""Data for Γ and C from a world: transitions of random driving, and labels of grasps (section V).

Labels are sampled where they are most informative, but never by a row's own label. So among equal
percepts they are as frequent as in the world, and probabilities learned from them are correct.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import Dataset, Lanes, start_lanes
from cgtorch.ground.errors import DataError
from cgtorch.native.processes import counted
from cgtorch.tabletop.world import PLACEMENTS, ObservedTabletop, Scenarios, draw_of
from cgtorch.tabletop.world.clear_motion import sweep_blocked
from cgtorch.tabletop.world.geometry import rectangle_in_frame, rotate
from cgtorch.tabletop.world.percepts import parts_of, percept_of, present

MOVES = 8  # of each robot that is driven at random
ARENA = 2.2  # m from the table's centre within which the robot is driven around the paper's
WIDE_ARENA = 3.5  # the same around other tables, from which robots start further away
NEAR = (0.3, 1.3)  # m between base and object where a grasp may be possible or not
WITHIN = 1.4  # m from the object, beyond which no arm can reach it
FARTHEST = 2.0  # m of a motion
TIMES, MORE = 2, 8  # as many poses are drawn as are needed, and so many more, as some are not free
BLIND = 0.3  # probability that motions go in any direction, from which Γ learns

ANYWHERE = 0.06  # share of the labels that are drawn anywhere, far from the table too
BESIDE = 0.7  # share that is drawn beside the boundary
ROUNDS = 2  # in which these are drawn, each nearer to the boundary
CANDIDATES = 8  # poses for each that is labelled beside the boundary
NEIGHBOURS = 4  # of either label that say how near the boundary is
SIDES_MATTER = 1.0  # m from the base; where the table ends further away matters no more
OBJECT_MATTERS = 2.0  # how much a distance between objects counts, against one between sides
PROBE = 200  # least number of poses that show whether there is anything to learn


@dataclass(frozen=True)
class Scenes:
    """The scenes in which data are collected.

    Attributes:
        world: Makes the world of given scenarios.
        kind: The kind of scenarios, as in `DRAWS`; for an edge, objects are along all edges.
        thrift: From 1 on, how sparingly the world is asked for more answers than needed; higher if
            each answer is a simulation.
    """

    world: Callable[[Scenarios], ObservedTabletop]
    kind: str = "perimeter"
    thrift: int = 1

    @property
    def paper_table(self) -> bool:
        """Whether the table is the paper's."""
        return self.kind in PLACEMENTS

    @property
    def arena(self) -> float:
        """The radius (m) around the table's centre within which the robot is driven."""
        return ARENA if self.paper_table else WIDE_ARENA

    @property
    def footprint(self) -> Tensor:
        """(4,) of the base (m)."""
        return self.world(self.draw(0, Generator())).footprint

    def draw(self, count: int, generator: Generator) -> Scenarios:
        """Scenarios, whose initial robot pose is not used; SettingsError for an unknown kind."""
        return draw_of("perimeter" if self.paper_table else self.kind)(count, generator)


def poses_around(scenes: Scenes, count: int, generator: Generator, wider: float = 1.0) -> Scenarios:
    """Scenarios with the robot at a uniform free pose in an arena `wider` times the usual one."""
    arena = wider * scenes.arena

    def put(base: Scenarios) -> Tensor:
        pose = 2 * torch.rand(len(base), 3, generator=generator) - 1
        return pose * torch.tensor([arena, arena, torch.pi])

    return _free_poses(scenes, count, generator, put)


def poses_at_object(scenes: Scenes, count: int, generator: Generator) -> Scenarios:
    """Scenarios with free poses, uniform in side, heading and distance up to just out of reach."""

    def put(base: Scenarios) -> Tensor:
        part = torch.rand(len(base), 3, generator=generator)
        distance = NEAR[0] + (NEAR[1] - NEAR[0]) * part[:, 0]
        bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
        offset = rotate(torch.stack([distance, torch.zeros_like(distance)], 1), bearing)
        return torch.cat([base.object + offset, heading[:, None]], 1)

    return _free_poses(scenes, count, generator, put)


def in_table(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base overlaps the table or an obstacle."""
    still = torch.zeros_like(scenarios.pose)
    inside = torch.zeros(len(scenarios), dtype=torch.bool)
    for thing in (scenarios.table[:, :5], *scenarios.obstacles.unbind(1)):
        here = rectangle_in_frame(scenarios.pose, thing)
        inside |= present(thing) & sweep_blocked(still, here, footprint)
    return inside


def _free_poses(
    scenes: Scenes, count: int, generator: Generator, put: Callable[[Scenarios], Tensor]
) -> Scenarios:
    """`count` scenarios with the robot placed by `put` (n, 3), where the base is free."""
    found, footprint = scenes.draw(0, Generator()), scenes.footprint
    while len(found) < count:
        base = scenes.draw(TIMES * (count - len(found)) + MORE, generator)
        drawn = replace(base, pose=put(base))
        found = found.joined(drawn[~in_table(drawn, footprint)])
    return found[:count]


def collect(scenes: Scenes, transitions: int, labels: int, generator: Generator) -> Dataset:
    """Drive at random for transitions (p, u, p′), and try grasps for labels.

    DataError if almost no pose allows a grasp, or almost all do.
    """
    percept, motion, after = drive(scenes, transitions, generator)
    at, graspable = grasp_labels(scenes, labels, generator)
    return Dataset(percept, motion, after, at, graspable)


def drive(scenes: Scenes, count: int, generator: Generator) -> tuple[Tensor, Tensor, Tensor]:
    """`count` moves p (n, D), u (n, 3), p′ (n, D) of robots driven at random from random poses.

    Moves that are blocked or would leave the arena are not made.
    """
    rows: list[tuple[Tensor, Tensor, Tensor]] = []
    have, more = 0, counted("transitions", count)
    while have < count:
        robots = 2 + (count - have) // (2 * scenes.thrift)
        world = scenes.world(poses_around(scenes, robots, generator))
        lanes = start_lanes(world, torch.arange(robots), 0, 0)
        for _ in range(MOVES):
            motion = random_motions(robots, generator)
            before = lanes
            lanes, ok = world.step(lanes, motion)
            ok &= lanes.state[:, :2].norm(dim=1) <= scenes.arena
            lanes = _either(ok, lanes, before)
            rows.append((before.percept[ok], motion[ok], lanes.percept[ok]))
            have += int(ok.sum())
            more(int(ok.sum()))
    p, u, q = (torch.cat(part) for part in zip(*rows, strict=True))
    pick = torch.randperm(len(p), generator=generator)[:count]
    return p[pick], u[pick], q[pick]


def _either(first: Tensor, yes: Lanes, no: Lanes) -> Lanes:
    """Lanes from `yes` where `first` (n,), else from `no`."""
    pairs = zip(vars(yes).values(), vars(no).values(), strict=True)
    return Lanes(*(torch.where(first.view(-1, *[1] * (a.dim() - 1)), a, b) for a, b in pairs))


def label(scenes: Scenes, scenarios: Scenarios) -> tuple[Tensor, Tensor]:
    """The percept at each pose (B, D), and (B,) bool whether a grasp succeeds there."""
    world = scenes.world(scenarios)
    lanes = start_lanes(world, torch.arange(len(scenarios)), 0, 0)
    return lanes.percept, world.success(lanes)[1].bool()


def grasp_labels(scenes: Scenes, count: int, generator: Generator) -> tuple[Tensor, Tensor]:
    """`count` percepts (n, D) and (n,) bool labels, in random order.

    Some poses are around the object, more are close to the boundary between success and failure,
    and the others are anywhere, so that models do not predict success where there are no data. The
    base never overlaps the table, as no skill can bring it there. DataError if fewer than one pose
    in a hundred around the object has either label.
    """
    anywhere, beside = int(ANYWHERE * count), int(BESIDE * count) // ROUNDS
    first = count - anywhere - ROUNDS * beside
    poses = poses_at_object(scenes, max(first, PROBE), generator)
    answered = counted("labels", len(poses) + ROUNDS * beside + anywhere)
    percept, graspable = label(scenes, poses)
    answered(len(poses))
    rate = float(graspable.float().mean())
    if not 0.01 < rate < 0.99:
        raise DataError(
            f"a grasp succeeds at {rate:.1%} of random poses around the object; check that the "
            "arms of the robot description reach the table"
        )
    probes = len(percept)
    for _ in range(ROUNDS):
        more = poses_at_object(scenes, CANDIDATES * beside, generator)
        more = more[nearest_to_boundary(more, percept, graspable, beside)]
        seen, answer = label(scenes, more)
        percept, graspable = torch.cat([percept, seen]), torch.cat([graspable, answer])
        answered(beside)
    far, fails = label(scenes, poses_around(scenes, anywhere, generator, 2))
    answered(anywhere)
    percept = torch.cat([percept[:first], percept[probes:], far])
    graspable = torch.cat([graspable[:first], graspable[probes:], fails])
    order = torch.randperm(count, generator=generator)
    return percept[order], graspable[order]


def nearest_to_boundary(
    scenarios: Scenarios, percept: Tensor, graspable: Tensor, count: int
) -> Tensor:
    """Indices (count,) of scenarios about equally far from known successes and known failures.

    The known percepts are (n, D), and their labels `graspable` (n,), with some of either.
    """
    seen = percept_of(scenarios.pose, scenarios.table, scenarios.object)
    to_success = _distance(seen, percept[graspable])
    to_failure = _distance(seen, percept[~graspable])
    uneven = (to_success - to_failure).abs() / (to_success + to_failure)
    return uneven.topk(count, largest=False).indices


def _distance(seen: Tensor, known: Tensor) -> Tensor:
    """Mean distance (B,) from percepts (B, 7) to the nearest few of the known ones (n, D)."""

    def place(percept: Tensor) -> Tensor:
        part = parts_of(percept)
        sides = part.box.clamp(-SIDES_MATTER, SIDES_MATTER)
        return torch.cat([sides, OBJECT_MATTERS * part.object], 1)

    few = min(NEIGHBOURS, len(known))
    parts = [
        torch.cdist(place(part), place(known)).topk(few, largest=False).values
        for part in seen.split(2048)
    ]
    return torch.cat(parts).mean(1)


def motions_to_try(percept: Tensor, count: int, generator: Generator) -> Tensor:
    """(n, 3) random motions for a percept (D,), uniform in side, heading and distance.

    What is too far for one motion is approached.
    """
    if float(torch.rand((), generator=generator)) < BLIND:
        return random_motions(count, generator)
    part = torch.rand(count, 3, generator=generator)
    distance = NEAR[0] + (NEAR[1] - NEAR[0]) * part[:, 0]
    bearing, heading = (torch.pi * (2 * part[:, 1:] - 1)).unbind(1)
    offset = torch.stack([distance * bearing.cos(), distance * bearing.sin()], 1)
    to = parts_of(percept).object + offset
    to = to * (FARTHEST / to.norm(dim=1, keepdim=True).clamp_min(1e-6)).clamp_max(1)
    return torch.cat([to, heading[:, None]], 1)


def random_motions(count: int, generator: Generator) -> Tensor:
    """(n, 3) motions in random directions; a third turn very little, the others by any angle."""
    draw = torch.rand(count, 4, generator=generator)
    length, direction = FARTHEST * draw[:, 0], 2 * torch.pi * draw[:, 1]
    turn = torch.pi * (2 * draw[:, 2] - 1)
    turn = torch.where(draw[:, 3] < 1 / 3, turn / 12, turn)
    return torch.stack([length * direction.cos(), length * direction.sin(), turn], 1)
