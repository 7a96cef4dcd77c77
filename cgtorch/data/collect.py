"""Collecting what Γ and C learn from: the world driven at random (section V)."""

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from cgtorch.data.dataset import Dataset
from cgtorch.environment import Lanes, start_lanes
from cgtorch.errors import DataError
from cgtorch.world import Scenarios, TabletopWorld, random_scenarios
from cgtorch.world.geometry import rectangle_in_frame, rotate, sweep_blocked, wrap

ARENA = 2.2  # m from the table's centre within which the robot is driven
REACH = (0.3, 1.1)  # m between base and object where a grasp may be possible or not
MAX_MOVE = 2.0  # m
LABEL_SPREAD = 0.25  # m from an edge within which objects for labels stand

WorldOf = Callable[[Scenarios], TabletopWorld]


def collect(world_of: WorldOf, transitions: int, labels: int, generator: Generator) -> Dataset:
    """Drive at random for transitions, and try grasps for balanced labels.

    Args:
        world_of: makes the world of given scenarios.
        transitions: how many (p, u, p′).
        labels: how many percepts with the result of a grasp, half of them successes.
        generator: of all random choices.

    Raises:
        DataError: hardly any pose allows a grasp, or hardly any does not.
    """
    percept, motion, after = drive(world_of, transitions, generator)
    at, graspable = balanced_labels(world_of, labels, generator)
    return Dataset(percept, motion, after, at, graspable)


def drive(
    world_of: WorldOf, count: int, generator: Generator, moves: int = 8
) -> tuple[Tensor, Tensor, Tensor]:
    """`count` transitions p (n, 7), u (n, 3), p′ (n, 7) of robots driven at random.

    Each robot starts at a random pose around the table and makes random moves; those that the
    table blocks or that would leave the arena are not made.
    """
    rows: list[tuple[Tensor, Tensor, Tensor]] = []
    have = 0
    while have < count:
        robots = 2 + (count - have) // 2
        world = world_of(poses_around(world_of, robots, generator))
        lanes = start_lanes(world, torch.arange(robots), 0, 0)
        for _ in range(moves):
            motion = random_motions(robots, generator)
            before = lanes
            lanes, ok = world.step(lanes, motion)
            ok &= lanes.state[:, :2].norm(dim=1) <= ARENA
            lanes = _either(ok, lanes, before)
            rows.append((before.percept[ok], motion[ok], lanes.percept[ok]))
            have += int(ok.sum())
    p, u, q = (torch.cat(part) for part in zip(*rows, strict=True))
    pick = torch.randperm(len(p), generator=generator)[:count]
    return p[pick], u[pick], q[pick]


def _either(first: Tensor, yes: Lanes, no: Lanes) -> Lanes:
    """Lanes from `yes` where `first` (n,), else from `no`."""
    merged = {
        name: torch.where(first.view(-1, *[1] * (a.dim() - 1)), a, getattr(no, name))
        for name, a in vars(yes).items()
    }
    return Lanes(**merged)


def random_motions(count: int, generator: Generator) -> Tensor:
    """(n, 3) motions in a random direction; a third hardly turns, the others turn any angle."""
    draw = torch.rand(count, 4, generator=generator)
    length, direction = MAX_MOVE * draw[:, 0], 2 * torch.pi * draw[:, 1]
    turn = torch.pi * (2 * draw[:, 2] - 1)
    turn = torch.where(draw[:, 3] < 1 / 3, turn / 12, turn)
    return torch.stack([length * direction.cos(), length * direction.sin(), turn], 1)


def poses_around(world_of: WorldOf, count: int, generator: Generator) -> Scenarios:
    """Scenarios with the robot at a random free pose anywhere around the table."""
    return _resample(count, lambda n: _around(n, ARENA, generator), world_of)


def _around(count: int, arena: float, generator: Generator) -> Scenarios:
    base = random_scenarios("perimeter", count, generator)
    draw = 2 * torch.rand(count, 3, generator=generator) - 1
    pose = draw * torch.tensor([arena, arena, torch.pi])
    return Scenarios(pose, base.table, base.object, base.seed)


def poses_at_object(count: int, generator: Generator) -> Scenarios:
    """Scenarios with the robot within or just out of reach of the object, any side, any heading.

    Headings are drawn mostly towards the object; objects stand along all edges.
    """
    base = random_scenarios("perimeter", count, generator)
    draw = torch.rand(count, 4, generator=generator)
    distance = REACH[0] + (REACH[1] - REACH[0]) * draw[:, 0]
    bearing = torch.pi * (2 * draw[:, 1] - 1)
    offset = rotate(torch.stack([distance, torch.zeros_like(distance)], 1), bearing)
    look = torch.where(draw[:, 3] < 0.7, 0.5, 1.0) * torch.pi * (2 * draw[:, 2] - 1)
    inward = base.object * (1 - (LABEL_SPREAD - 0.1) * draw[:, 3:])
    heading = wrap(bearing + torch.pi + look)[:, None]
    return Scenarios(torch.cat([inward + offset, heading], 1), base.table, inward, base.seed)


def _resample(count: int, draw: Callable[[int], Scenarios], world_of: WorldOf) -> Scenarios:
    """`count` drawn scenarios in which the base does not stand in the table."""
    parts: list[Scenarios] = []
    have = 0
    while have < count:
        scenarios = draw(2 * (count - have) + 8)
        free = ~in_table(scenarios, world_of(scenarios[:0]).footprint)
        parts.append(scenarios[free.nonzero()[:, 0]])
        have += int(free.sum())
    fields = zip(*(vars(part).values() for part in parts), strict=True)
    return Scenarios(*(torch.cat(f) for f in fields))[:count]


def in_table(scenarios: Scenarios, footprint: Tensor) -> Tensor:
    """(B,) bool, whether the base would stand in the table."""
    table = rectangle_in_frame(scenarios.pose, scenarios.table[:, :5])
    return sweep_blocked(torch.zeros_like(scenarios.pose), table, footprint)


def label(world_of: WorldOf, scenarios: Scenarios) -> tuple[Tensor, Tensor]:
    """What is seen from each pose (B, 7), and (B,) bool whether a grasp succeeds there."""
    world = world_of(scenarios)
    lanes = start_lanes(world, torch.arange(len(scenarios)), 0, 0)
    return lanes.percept, world.success(lanes) > 0.5


def balanced_labels(world_of: WorldOf, count: int, generator: Generator) -> tuple[Tensor, Tensor]:
    """`count` percepts (n, 7) and (n,) bool labels, half of them successes.

    A third is drawn around the object and a third beside the boundary, as small displacements of
    poses next to which the label changes: there a classifier has most to learn. The failures of
    the last third are drawn anywhere, in the table too, so that models do not believe in grasps
    at places where nobody has been.

    Raises:
        DataError: fewer than one pose in a hundred has either label.
    """
    third = count // 3
    around = poses_at_object(2 * count, generator)
    percept, graspable = label(world_of, around)
    rate = float(graspable.float().mean())
    if not 0.01 <= rate <= 0.99:
        raise DataError(
            f"a grasp succeeds at {rate:.1%} of random poses around the object; check that the "
            "arms of the robot description reach the table"
        )
    boundary = label(world_of, _displaced(around, percept, graspable, 2 * third, generator))
    anywhere = label(world_of, _around(third, 2 * ARENA, generator))
    far, fails = torch.cat([anywhere[0], percept]), torch.cat([anywhere[1], graspable])
    parts = [
        _balanced(percept, graspable, count - 2 * third, generator),
        _balanced(*boundary, third, generator),
        _balanced(far, fails, third, generator, first=third),
    ]
    p, y = (torch.cat(part) for part in zip(*parts, strict=True))
    order = torch.randperm(len(p), generator=generator)
    return p[order], y[order]


def _displaced(
    wide: Scenarios, percept: Tensor, graspable: Tensor, count: int, generator: Generator
) -> Scenarios:
    """Small displacements of the graspable poses closest to a pose with the other label."""
    yes, no = graspable.nonzero()[:, 0], (~graspable).nonzero()[:, 0]
    gap = torch.cdist(percept[yes], percept[no])
    close = torch.cat([yes[gap.amin(1).argsort()], no[gap.amin(0).argsort()]])
    pool = close[torch.randint(len(close), (count,), generator=generator)]
    spread = torch.tensor([0.05, 0.05, 0.15])
    pose = wide.pose[pool] + torch.randn(len(pool), 3, generator=generator) * spread
    seed = torch.randint(2**31, (len(pool),), generator=generator)
    return Scenarios(pose, wide.table[pool], wide.object[pool], seed)


def _balanced(
    percept: Tensor, graspable: Tensor, count: int, generator: Generator, first: int = 0
) -> tuple[Tensor, Tensor]:
    """Up to `count` rows, as many graspable as not; the `first` rows are taken before others."""
    order = torch.randperm(len(percept), generator=generator)
    order = torch.cat([order[order < first], order[order >= first]])
    yes, no = order[graspable[order]], order[~graspable[order]]
    half = min(count // 2, len(yes), len(no))
    pick = torch.cat([yes[:half], no[:half]])
    return percept[pick], graspable[pick]
