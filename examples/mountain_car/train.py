"""From a car that has never moved to a skill that forgets nothing: Algorithm 1 in two stages."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial

import torch
from torch import Generator, Tensor

from cgtorch.environment import Dataset
from cgtorch.environment import start_lanes
from cgtorch.evolution import EvolutionSettings
from cgtorch.graphs import Skill
from cgtorch.improvement.events import StageStarted, Watch
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.stopping import Budget
from cgtorch.simulation import Rollouts, rollout
from examples.mountain_car.actions import car_actions
from examples.mountain_car.models import fit_models, imagine, learn
from examples.mountain_car.world import ANYWHERE, PERCEPT, VALLEY, MountainCar, Starts, draw_starts

STAGES = {"valley": VALLEY, "anywhere": ANYWHERE}
"""Each skill and where it starts from."""

CARS, PUSHES = 100, 40  # that are driven at random, and how often each is pushed
ROWS = 800  # transitions, and tests, of theirs that Γ and C are learned from
PRACTICE = 100  # starts that a stage is about, and fresh ones after it
SPENT = PERCEPT.index("spent")


def points(runs: Rollouts, probability: Tensor) -> Tensor:
    """The fitness: what an episode earns of 100 points; without the flag, half the hope of it.

    What it has cost is in the last percept, so the models know it, too.
    """
    earned = probability - runs.percept[..., SPENT]
    return torch.where(runs.succeeded, earned, probability / 2)


def drive(generator: Generator) -> Dataset:
    """What cars experience that start anywhere and push at random, in random order.

    Of the tests whether a car has succeeded, those at the end of an episode are all kept.
    """
    world = MountainCar(draw_starts(CARS, generator, ANYWHERE))
    lanes = start_lanes(world, torch.arange(CARS), 0, 0)
    moves, tests, ends = [], [], []
    for _ in range(PUSHES):
        force = 2 * torch.rand(len(lanes), 1, generator=generator) - 1
        after, _ = world.step(lanes, force)
        moves.append((lanes.percept, force, after.percept))
        tests.append((after.percept, world.success(after)[1] > 0.5))
        ends.append(world.over(after))
        lanes = after.rows((~ends[-1]).nonzero()[:, 0])
    p, u, q = (torch.cat(part) for part in zip(*moves, strict=True))
    tested, succeeded = (torch.cat(part) for part in zip(*tests, strict=True))
    over = torch.cat(ends)
    some = torch.randperm(len(p), generator=generator)[:ROWS]
    first = torch.argsort(torch.rand(len(p), generator=generator) - over.float())[:ROWS]
    first = first[torch.randperm(ROWS, generator=generator)]
    return Dataset(p[some], u[some], q[some], tested[first], succeeded[first])


def car_setup() -> Setup[Starts]:
    """What Algorithm 1 works with."""
    return Setup(
        actions=car_actions(),
        world_of=MountainCar,
        imagine=imagine,
        learn=learn,
        evolution=EvolutionSettings(population=120, fitness=points),
        budget=Budget(generations=30, stall=8, patience=3, enough=0.9),
        attempts=8,
        group=8,
        lanes=16,
        trials=1,  # nothing is noisy here
        max_transitions=60,
    )


def train(
    seed: int, watch: Watch, working: Callable[[str], AbstractContextManager[None]]
) -> Progress[Starts]:
    """All stages, from one seed.

    Args:
        seed: of everything.
        watch: told what happens.
        working: makes a context in which a long step runs under a message.
    """
    generator, setup = Generator().manual_seed(seed), car_setup()
    with working("driving at random"):
        data = drive(generator)
    with working("fitting Γ and C"):
        models = fit_models(data, seed)
    nothing = draw_starts(0, generator)
    progress = Progress(None, nothing, nothing, models)
    for name, between in STAGES.items():
        starts = progress.missed.joined(draw_starts(PRACTICE, generator, between))
        sizes = len(progress.solved), len(starts)
        watch(StageStarted(name, tuple(STAGES), *sizes, setup.attempts))
        progress = improve(
            setup,
            progress,
            name,
            starts,
            torch.ones(len(starts), dtype=torch.bool),
            partial(draw_starts, PRACTICE, between=between),
            generator,
            watch,
        )
    return progress


def tried(skill: Skill, starts: Starts) -> tuple[Tensor, Tensor]:
    """What a skill does in the environment.

    Returns:
        (B,) bool whether it reaches the flag with enough points, and (B,) points.
    """
    runs = rollout(
        skill.graph, skill.actions, MountainCar(starts), max_transitions=skill.max_transitions
    )
    return runs.succeeded[0], runs.state[0, :, 3]
