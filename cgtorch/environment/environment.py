"""What a running skill starts from, sees, and acts in: scenarios, lanes, environments.

A *lane* is one skill on one scenario. Everything that runs skills works on a batch of lanes, and
every place a skill can run in, models or worlds, is an `Environment`: a step returns new lanes.
"""

from dataclasses import dataclass, fields, replace
from typing import Protocol, Self, runtime_checkable

import torch
from torch import Tensor


@dataclass(frozen=True)
class ScenarioBatch:
    """B states of a world that a skill starts from.

    A subclass is a frozen dataclass of tensors of B rows, of whatever a world needs to know, such
    as where things stand or a seed; it needs nothing more than its fields. A skill that is run
    again on a scenario must do the same again, so noise is part of a scenario, too.
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, index: Tensor | slice) -> Self:
        return type(self)(*(getattr(self, f.name)[index] for f in fields(self)))

    def joined(self, *more: Self) -> Self:
        """These scenarios, and more of them after these."""
        parts = (self, *more)
        return type(self)(*(torch.cat([getattr(s, f.name) for s in parts]) for f in fields(self)))

    def with_noise(self, copy: int) -> Self:
        """The same under other noise; copy 0 is the scenarios themselves. Here nothing is noisy."""
        return self


@dataclass(frozen=True)
class Lanes:
    """A batch of n running skills.

    Attributes:
        percept: (n, D) what the robot perceives.
        state: (n, S) what the environment keeps of each lane; never seen by actions.
        message: (n, M) the message travelling along the edges.
        has_message: (n,) bool, whether a message has been sent yet.
        memory: (n, C) the common memory of a lane's nodes; an action sees its part of it.
        scenario: (n,) long, which scenario the lane runs on.
        step: (n,) long, how many actions the lane has executed.
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

    def moved(self, state: Tensor, percept: Tensor) -> Self:
        """The same lanes with other states (n, S) and percepts (n, D); faster than `replace`."""
        rest = self.message, self.has_message, self.memory, self.scenario, self.step
        return type(self)(percept, state, *rest)

    def part(self, which: slice) -> Self:
        """Some of the lanes, which lie where these do."""
        return type(self)(*(getattr(self, f.name)[which] for f in fields(self)))

    def differs(self, other: "Lanes") -> Tensor:
        """(n,) bool, whether anything but the step count differs from lanes of the same rows."""
        changed = torch.zeros(len(self), dtype=torch.bool, device=self.percept.device)
        for f in fields(self):
            one, two = getattr(self, f.name), getattr(other, f.name)
            if one is not two and f.name not in ("scenario", "step"):
                changed |= (one != two).view(len(self), -1).any(1)
        return changed

    def with_memory(self, part: slice) -> Self:
        """The same lanes, of whose memory only a part is seen; what is written there is theirs."""
        return replace(self, memory=self.memory[:, part])

    def write(self, which: slice, before: "Lanes", after: "Lanes") -> None:
        """Overwrite in place some lanes with what differs between two versions of them."""
        for f in fields(self):
            value = getattr(after, f.name)
            if value is not getattr(before, f.name):
                getattr(self, f.name)[which] = value


def rows_where(mask: Tensor) -> Tensor:
    """Rows (k,) long that hold all for which `mask` (n,) is true: these alone, or on a GPU all.

    To count them there would make the host wait for it in the middle of a step. What is found out
    about such rows counts only where the mask is true.
    """
    few = mask.is_cpu and not torch.compiler.is_compiling()  # an exported graph knows no counts
    return mask.nonzero()[:, 0] if few else torch.arange(len(mask), device=mask.device)


@runtime_checkable
class Environment(Protocol):
    """Where skills run: a transition model, a world, or a user's own domain.

    All methods are batched and must treat rows independently, so that a result never depends on
    which other lanes happen to be in the batch.
    """

    @property
    def num_scenarios(self) -> int:
        """How many scenarios the environment holds."""
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
        """Apply controls (n, U): the lanes after it and (n,) bool whether it could be done."""
        ...

    def observe(self, lanes: Lanes) -> Lanes:
        """Perceive again without moving."""
        ...

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        """Lanes that may remember it, and the probability in [0, 1] (n,) that the task succeeds.

        That is here and now; a world says 0 or 1. Nothing about the lanes changes that an action
        could notice.
        """
        ...


@runtime_checkable
class Seeded(Protocol):
    """An environment whose scenarios have seeds of their own, for actions that are stochastic.

    It is for environments that can hold the same scenario under another index.
    """

    @property
    def seeds(self) -> Tensor:
        """(B,) long, one of each scenario."""
        ...


@runtime_checkable
class Rewarded(Protocol):
    """An environment that gives rewards, in episodes that come to an end.

    A lane whose episode is over ends, wherever it is in its graph, and has succeeded if
    `Environment.success` says so. One that ends before has not finished its episode: it gets no
    return at all, so that a skill which does nothing gains nothing by it.
    """

    def over(self, lanes: Lanes) -> Tensor:
        """(n,) bool, whether the episodes of lanes are over, by their states alone."""
        ...

    def returns(self, lanes: Lanes) -> Tensor:
        """(n,) float, the sums of the rewards so far."""
        ...


def seeds_of(environment: Environment, scenario: Tensor) -> Tensor:
    """(n,) long, the seeds of scenarios (n,): their indices where the environment has none."""
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
