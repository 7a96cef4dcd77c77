"""The interfaces that skills run in: scenarios, lanes, data, environments.

A *lane* is one skill on one scenario. Everything that runs skills works on a batch of lanes.
"""

from dataclasses import dataclass, fields, replace
from typing import Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from cgtorch.ground.asked import Asked


@dataclass(frozen=True)
class ScenarioBatch:
    """B initial states of a world.

    A subclass is a frozen dataclass of tensors with B rows, such as positions or a seed. A skill
    that runs again on a scenario behaves in the same way, so a world's noise belongs to it.
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, index: Tensor | slice) -> Self:
        return type(self)(*(getattr(self, f.name)[index] for f in fields(self)))

    def joined(self, *more: Self) -> Self:
        """These scenarios, followed by more."""
        parts = (self, *more)
        return type(self)(*(torch.cat([getattr(s, f.name) for s in parts]) for f in fields(self)))

    def with_noise(self, copy: int) -> Self:
        """The same scenarios with other noise; copy 0 is unchanged. By default nothing is noisy."""
        return self


@dataclass(frozen=True)
class Lanes:
    """A batch of n running skills.

    Attributes:
        percept: (n, D) what the robot perceives.
        state: (n, S) what the environment stores for each lane; actions never see it.
        message: (n, M) the message on the current edge.
        has_message: (n,) bool, whether a message has been sent yet.
        memory: (n, C) the common memory of a lane's nodes; an action sees its part of it.
        scenario: (n,) long, the index of the lane's scenario.
        step: (n,) long, the number of actions that the lane has executed.
    """

    percept: Tensor
    state: Tensor
    message: Tensor
    has_message: Tensor
    memory: Tensor
    scenario: Tensor
    step: Tensor

    def __len__(self) -> int:
        return self.percept.shape[0]

    def rows(self, index: Tensor) -> Self:
        """The lanes at `index` (k,)."""
        return type(self)(*(getattr(self, f.name).index_select(0, index) for f in fields(self)))

    def with_rows(self, index: Tensor, others: Self) -> Self:
        """These lanes with `others` (k,) at `index` (k,)."""
        pairs = ((getattr(self, f.name), getattr(others, f.name)) for f in fields(self))
        return type(self)(*(mine.index_copy(0, index, other) for mine, other in pairs))

    def moved(self, state: Tensor, percept: Tensor) -> Self:
        """The same lanes with other states (n, S) and percepts (n, D)."""
        rest = self.message, self.has_message, self.memory, self.scenario, self.step
        return type(self)(percept, state, *rest)

    def part(self, which: slice) -> Self:
        """Some of the lanes, as views of the same memory."""
        return type(self)(*(getattr(self, f.name)[which] for f in fields(self)))

    def differs(self, other: "Lanes") -> Tensor:
        """(n,) bool, whether anything except the step count differs from lanes of the same rows."""
        changed = torch.zeros(len(self), dtype=torch.bool, device=self.percept.device)
        for f in fields(self):
            one, two = getattr(self, f.name), getattr(other, f.name)
            if one is not two and f.name not in ("scenario", "step"):
                changed |= (one != two).view(len(self), -1).any(1)
        return changed

    def with_memory(self, part: slice) -> Self:
        """The same lanes with only a part of their memory, as a view."""
        return replace(self, memory=self.memory[:, part])

    def write(self, which: slice, before: "Lanes", after: "Lanes") -> None:
        """Overwrite some lanes in place with the differences between two versions of them."""
        for f in fields(self):
            value = getattr(after, f.name)
            if value is not getattr(before, f.name):
                getattr(self, f.name)[which] = value


def rows_where(mask: Tensor) -> Tensor:
    """(k,) long, the rows where `mask` (n,) is true; on a GPU all rows, as counting makes it wait.

    So results for such rows are used only where the mask is true.
    """
    few = mask.is_cpu and not torch.compiler.is_compiling()  # an exported graph knows no counts
    return mask.nonzero()[:, 0] if few else torch.arange(len(mask), device=mask.device)


@dataclass(frozen=True)
class Dataset:
    """Transitions for Γ and tests of success for C.

    Attributes:
        percept: (N, D) p.
        control: (N, U) u.
        next_percept: (N, D) p′.
        tested: (L, D) percepts at which success was tested.
        succeeded: (L,) bool, the results of these tests.
    """

    percept: Tensor
    control: Tensor
    next_percept: Tensor
    tested: Tensor
    succeeded: Tensor

    def extended(self, more: "Dataset") -> "Dataset":
        """Both datasets, with the rows of `more` last."""
        return Dataset(
            *(torch.cat([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self))
        )

    def whole(self, percept_size: int | None = None) -> bool:
        """Whether untrusted tensors are finite and fit one another, and percepts have D numbers."""
        n, d = (*self.percept.shape, 0, 0)[:2]
        numbers = self.percept, self.control, self.next_percept, self.tested
        return (
            self.percept.shape == self.next_percept.shape == (n, d)
            and percept_size in (None, d)
            and self.control.shape[:-1] == (n,)
            and self.tested.shape == (*self.succeeded.shape[:1], d)
            and self.succeeded.dim() == 1
            and self.succeeded.dtype == torch.bool
            and all(x.dtype == torch.float32 and bool(x.isfinite().all()) for x in numbers)
        )


@runtime_checkable
class Environment(Protocol):
    """Where skills run: a learned model, a world, or a user's own domain.

    All methods are batched and treat rows independently: no result depends on other lanes.
    """

    @property
    def num_scenarios(self) -> int:
        """The number of scenarios, B."""
        ...

    @property
    def percept_size(self) -> int:
        """D, the length of a percept."""
        ...

    @property
    def control_size(self) -> int:
        """U, the length of a control (for a mobile base 3: dx, dy in m, dθ in rad)."""
        ...

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        """The first state (n, S) and first percept (n, D) of scenarios (n,)."""
        ...

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        """Apply controls (n, U); the lanes afterwards, and (n,) bool which were carried out."""
        ...

    def observe(self, lanes: Lanes) -> Lanes:
        """Perceive again without moving."""
        ...

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """The probability (n,) in [0, 1] that the task succeeds here and now; a world gives 0 or 1.

        The returned lanes may store the result in their states; nothing changes that actions see.
        """
        ...


@runtime_checkable
class Seeded(Protocol):
    """An environment whose scenarios, which may have several indices, have seeds of their own."""

    @property
    def seeds(self) -> Tensor:
        """(B,) long, one seed per scenario."""
        ...


@runtime_checkable
class Live(Protocol):
    """An environment that is a robot: its scenarios are met one after the other, and only once."""

    def told(self, phase: str, stage: str) -> None:
        """Hear for what its next episodes are."""
        ...

    def recall(self) -> "Episode | None":
        """The next episode of this phase and stage that was finished before an interruption."""
        ...

    def ended(self, succeeded: bool) -> tuple[Dataset, Asked]:
        """Hear how an episode has ended; the data and cost of those broken off before it."""
        ...


@runtime_checkable
class Counting(Protocol):
    """An environment whose motions consist of several low-level steps, which it counts."""

    @property
    def asked(self) -> Asked:
        """All low-level steps so far, in any environment that counts together with this one."""
        ...


@runtime_checkable
class Hurried(Protocol):
    """An environment in which a search may give up an episode before its end."""

    def hurried(self) -> Environment:
        """The same scenarios, in which episodes end early where there is little hope.

        What succeeds there succeeds here.
        """
        ...


def asked_of(environment: Environment) -> Asked:
    """The low-level steps so far; none if the environment does not count any."""
    return environment.asked if isinstance(environment, Counting) else Asked()


@runtime_checkable
class Bounded(Protocol):
    """An environment that cannot run many lanes at once, as each of them takes much memory."""

    @property
    def most_lanes(self) -> int:
        """The number of lanes that a rollout runs at once."""
        ...


@runtime_checkable
class Frugal(Protocol):
    """An environment that tells whether each step counts, however many lanes run at once."""

    frugal: bool


@runtime_checkable
class Named(Protocol):
    """An environment that messages name in its user's words, such as "environment 'Mine-v0'".

    `advice` says what to do so that it shows the same again.
    """

    advice: str

    @property
    def what(self) -> str:
        """What it is."""
        ...

    def begun_by(self, scenario: int) -> str:
        """How a scenario begins, such as "after reset(seed=7)"."""
        ...


@runtime_checkable
class Copied(Protocol):
    """An environment whose lanes are copies of something that keeps its state."""

    def anew(self) -> Environment:
        """The same scenarios in copies that have not been used yet."""
        ...


@runtime_checkable
class Episodic(Protocol):
    """An environment with episodes that end by themselves.

    A lane ends with its episode, and has succeeded if `Environment.success` says so.
    """

    def over(self, lanes: Lanes) -> Tensor:
        """(n,) bool, whether the episodes of lanes are over, judged by their states alone."""
        ...


@runtime_checkable
class Rewarded(Episodic, Protocol):
    """An environment with rewards, in episodes that end.

    A lane that ends before its episode gets no return, so that a skill gains nothing by doing
    nothing.
    """

    def returns(self, lanes: Lanes) -> Tensor:
        """(n,) float, the sums of rewards so far."""
        ...


@dataclass(frozen=True)
class Episode:
    """An episode of a robot: its first percept (1, D), world actions, and how it ended.

    The data, and the costs `asked`, are also those of episodes broken off before it.
    """

    percept: Tensor
    experience: Dataset
    actions: int
    asked: Asked
    succeeded: bool


def seeds_of(environment: Environment, scenario: Tensor) -> Tensor:
    """(n,) long, the seeds of scenarios (n,), or their indices if the environment has no seeds."""
    return environment.seeds[scenario] if isinstance(environment, Seeded) else scenario


def start_lanes(
    environment: Environment, scenario: Tensor, message_size: int, memory_size: int
) -> Lanes:
    """Fresh lanes on scenarios (n,), without a message and with an empty (zero) memory."""
    state, percept = environment.start(scenario)
    n = len(scenario)
    return Lanes(
        percept=percept,
        state=state,
        message=percept.new_zeros(n, message_size),
        has_message=torch.zeros(n, dtype=torch.bool, device=percept.device),
        memory=percept.new_zeros(n, memory_size),
        scenario=scenario,
        step=torch.zeros(n, dtype=torch.long, device=percept.device),
    )
