"""The common frame: what every library is given, what is counted, and when a task is solved.

A library has a function `search(trial)`, which goes on while `trial.open`. It draws the starts of
its episodes from the trial, runs them in the trial's worlds, says how many individuals it has
evaluated, and offers its champions. What a champion is worth in training decides whether it is
tried, and 100 fresh episodes decide whether the task is solved.
"""

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import torch
from torch import Generator, Tensor

from cgtorch.ground.environment import Lanes, start_lanes
from standard.task import Starts, Task

FRESH = 100
"""Episodes of a test, where starts differ."""

Player: TypeAlias = Callable[[Any], Tensor]
"""Plays all B episodes of a world, and says what they return (B,)."""


class Policy(Protocol):
    """What says what to do; lanes stay in their rows until the last of them is over."""

    def __call__(self, percept: Tensor, memory: Any, live: Tensor) -> tuple[Tensor, Any]:
        """Controls (n, U) for percepts (n, D) float32, and what to remember until the next.

        The memory is None at first. What is said for rows that are not live (n,) does not count.
        """


@dataclass(frozen=True)
class Budget:
    """After how much a search is given up; a generation that has begun is finished."""

    cpu_seconds: float
    evaluations: int


BUDGETS: dict[str, Budget] = {
    "cartpole": Budget(120, 100_000),
    "acrobot": Budget(120, 100_000),
    "mountain_car_continuous": Budget(120, 100_000),
    "lunar_lander": Budget(300, 100_000),
    "pendulum": Budget(300, 100_000),
    "cartpole_no_velocities": Budget(120, 100_000),
    "narrow_cartpole_no_velocities": Budget(120, 100_000),
    "acrobot_no_velocities": Budget(120, 100_000),
    "pendulum_no_velocity": Budget(120, 100_000),
    "double_pole": Budget(300, 100_000),
    "double_pole_no_velocities": Budget(300, 100_000),
    "repeat_first": Budget(120, 100_000),
    "repeat_previous": Budget(120, 100_000),
}
"""The same for all libraries."""


@dataclass(frozen=True)
class Result:
    """What one search of a library has cost, and whether it has solved the task.

    Attributes:
        task: its name.
        library: its name.
        seed: of the search.
        solved: whether a champion has passed the test.
        evaluations: individuals that were evaluated; like the next two without the tests.
        episodes: that were begun.
        world_steps: of episodes that were not over.
        cpu_seconds: of the process, with compilation and tests, without imports.
        compile_seconds: of these for compilation, where it can be told apart.
        mean_return: of fresh episodes, by the champion that solved it or else the last one.
        note: what else is to be said.
    """

    task: str
    library: str
    seed: int
    solved: bool
    evaluations: int
    episodes: int
    world_steps: int
    cpu_seconds: float
    compile_seconds: float | None
    mean_return: float | None
    note: str = ""


@dataclass
class Counts:
    """What a search has used so far."""

    evaluations: int = 0
    episodes: int = 0
    world_steps: int = 0


class CountedWorld:
    """A world with rewards that counts its episodes and steps; all else is the world's own."""

    def __init__(self, world: Any, counts: Counts) -> None:
        """The same world, counted there."""
        self.world, self.counts = world, counts

    def __getattr__(self, name: str) -> Any:
        return getattr(self.world, name)

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """See `Environment.start`."""
        self.counts.episodes += len(scenario)
        return self.world.start(scenario)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """See `Environment.step`; a lane that is over has no more steps."""
        self.counts.world_steps += len(lanes) - int(self.world.over(lanes).sum())
        return self.world.step(lanes, control)

    def over(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.over`."""
        return self.world.over(lanes)

    def returns(self, lanes: Lanes) -> Tensor:
        """See `Rewarded.returns`."""
        return self.world.returns(lanes)


class Trial:
    """One search of one library for a solution of one task."""

    def __init__(self, task: Task, library: str, seed: int, budget: Budget) -> None:
        """Begins now; all randomness of the world follows from the seed."""
        self.task, self.library, self.seed, self.budget = task, library, seed, budget
        self.counts, self.solved = Counts(), False
        self.compile_seconds: float | None = None
        self.mean_return: float | None = None
        self._began = time.process_time()
        self._training = Generator().manual_seed(2 * seed)
        self._testing = Generator().manual_seed(2 * seed + 1)
        self._champion: Player | None = None
        self._tested_before: set[Hashable] = set()
        self._alike = alike(task)

    @property
    def cpu_seconds(self) -> float:
        """Since the beginning."""
        return time.process_time() - self._began

    @property
    def open(self) -> bool:
        """Whether the task is not solved yet, and the budget not used up."""
        used_up = (
            self.cpu_seconds >= self.budget.cpu_seconds
            or self.counts.evaluations >= self.budget.evaluations
        )
        return not self.solved and not used_up

    def starts(self, count: int) -> int:
        """So many starts, or 1 where all episodes of the task begin alike."""
        return 1 if self._alike else count

    def world(self, count: int) -> CountedWorld:
        """The world of so many new starts for training; their seeds are even."""
        return CountedWorld(self.task.world(_starts(count, self._training, 0)), self.counts)

    def evaluated(self, individuals: int) -> None:
        """Count individuals that were evaluated."""
        self.counts.evaluations += individuals

    def returns(
        self, policy: Policy, individuals: int, count: int, *, common: bool = True
    ) -> Tensor:
        """(P, B) returns of P individuals, whose lanes follow each other, in B episodes each.

        They are counted. All individuals meet the same starts, or if not `common`, each its own.
        """
        count = self.starts(count)
        if common:
            return self.returns_in(self.world(count), policy, individuals)
        self.evaluated(individuals)
        world = self.world(individuals * count)
        return played(world, policy, torch.arange(individuals * count)).view(individuals, count)

    def returns_in(self, world: CountedWorld, policy: Policy, individuals: int) -> Tensor:
        """The same, in a world of the trial's, whose B starts all individuals meet."""
        self.evaluated(individuals)
        count = world.num_scenarios
        scenario = torch.arange(count).repeat(individuals)
        return played(world, policy, scenario).view(individuals, count)

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Within it something is compiled, and at most tried once."""
        began = time.process_time()
        yield
        self.compile_seconds = (self.compile_seconds or 0.0) + time.process_time() - began

    def offer(self, champion: Player, fitness: float, identity: Hashable = None) -> None:
        """Say which individual is the best, and its mean return in training.

        Where all episodes begin alike, no individual is tested twice: give its identity.
        """
        self._champion = champion
        if fitness < self.task.solved or (self._alike and identity in self._tested_before):
            return
        if identity is not None:
            self._tested_before.add(identity)
        self.mean_return = self._tested()
        self.solved = self.mean_return >= self.task.solved and self._passed()

    def result(self, note: str = "") -> Result:
        """What has come out, at the end."""
        cpu_seconds = self.cpu_seconds
        if not self.solved and self._champion is not None:
            self.mean_return = self._tested()
        return Result(
            task=self.task.name,
            library=self.library,
            seed=self.seed,
            solved=self.solved,
            evaluations=self.counts.evaluations,
            episodes=self.counts.episodes,
            world_steps=self.counts.world_steps,
            cpu_seconds=round(cpu_seconds, 3),
            compile_seconds=None
            if self.compile_seconds is None
            else round(self.compile_seconds, 3),
            mean_return=self.mean_return,
            note=note,
        )

    def _tested(self) -> float:
        """The champion's mean return in fresh episodes; their seeds are odd."""
        assert self._champion is not None  # noqa: S101
        starts = _starts(self.starts(FRESH), self._testing, 1)
        return float(self._champion(self.task.world(starts)).double().mean())

    def _passed(self) -> bool:
        """Whether the champion passes the task's further tests, the shortest first."""
        assert self._champion is not None  # noqa: S101
        for challenge in sorted(self.task.test or (), key=lambda one: one.least):
            returns = self._champion(challenge.world())
            if int((returns >= challenge.least).sum()) < challenge.enough:
                return False
        return True


def _starts(count: int, generator: Generator, odd: int) -> Starts:
    """Starts with even or with odd seeds, so that none is both trained on and tested on."""
    return Starts(2 * torch.randint(2**30, (count,), generator=generator) + odd)


def alike(task: Task) -> bool:
    """Whether episodes of a task all begin in the same state, from which all else follows."""
    world = task.world(Starts(torch.arange(8)))
    state, _ = world.start(torch.arange(8))
    return bool((state == state[:1]).all())


def player(policy: Policy) -> Player:
    """What plays the episodes of a world once by a policy."""
    return lambda world: played(world, policy, torch.arange(world.num_scenarios))


@torch.no_grad()
def played(world: Any, policy: Policy, scenario: Tensor) -> Tensor:
    """(n,) returns of episodes from these scenarios (n,); lanes that are over leave the world."""
    lanes, memory = start_lanes(world, scenario, 0, 0), None
    percept, returns = lanes.percept.clone(), torch.zeros(len(scenario), dtype=torch.float64)
    row, live = torch.arange(len(scenario)), torch.ones(len(scenario), dtype=torch.bool)
    while len(row):
        control, memory = policy(percept, memory, live)
        lanes, _ = world.step(lanes, control[row].nan_to_num())
        over = world.over(lanes)
        if bool(over.any()):
            returns[row[over]] = world.returns(lanes)[over].double()
            live[row[over]] = False
            lanes, row = lanes.rows((~over).nonzero()[:, 0]), row[~over]
        percept[row] = lanes.percept
    return returns
