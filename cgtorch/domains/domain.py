"""The interface of a domain, which is the task of a run.

A domain defines percepts and controls, draws scenarios, and makes their world. Everything else has
a default. The paper's tabletop (`cgtorch.tabletop`) is one domain, any Gymnasium environment
(`cgtorch.domains.gymnasium`) another, and docs/own-domain.md defines a third in sixty lines.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar, runtime_checkable

from torch import Generator, Tensor

from cgtorch.domains.files import Files
from cgtorch.domains.models import Models
from cgtorch.domains.pictures import Pictures
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.domains.settings import DomainSettings
from cgtorch.graphs import ActionSet, BranchingNN, ContinuousNN, Step, Test, reward_actions
from cgtorch.ground.environment import (
    Bounded,
    Counting,
    Environment,
    Episodic,
    Rewarded,
    ScenarioBatch,
)
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.fields import Field
from cgtorch.improvement.compose import local_group
from cgtorch.improvement.setup import Grouping

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a domain."""


@dataclass(frozen=True)
class Specialists:
    """How missed scenarios are assigned to specialists (`cgtorch.improvement`).

    Attributes:
        group_of: Chooses the scenarios on which a specialist is evolved.
        group: Number of these scenarios at first.
        widest: Number to which the group grows, by doubling, as long as all of it is solved, or
            with rewards the fitness is good enough; it does not grow by default.
        team: The largest number of members of a team; eight need 15 nodes with their branches.
        stall: Generations without a better fitness after which its search gives up.
    """

    group_of: Grouping = local_group
    group: int = 12
    widest: int = 0
    team: int = 8
    stall: int = 40


class Domain(ABC, Generic[S]):
    """The task of a run; a subclass defines `percept`, `control`, `draw` and `world`.

    Attributes:
        percept: The D fields of a percept.
        control: The U fields of a control.
        kinds: The names of all kinds of scenarios, the usual one first.
        stages: A run's stages in order, each with the kind of its scenarios. Without stages, a run
            continues in rounds until its goal is reached.
        settings_type: The domain's own settings, which become options of `cgtorch-train`.
        settings: Those of this domain.
        target_return: With rewards, the return from which an episode counts as solved.
        repeats: Whether a world that is asked the same gives the same answer, so that a trial can
            be made again. If not, each trial is one sample of what may happen.
        specialists: How missed scenarios are assigned to specialists.
        models: Inputs and fits of Γ and C, or with rewards of a Γ with rewards; None if skills are
            evolved in the world itself.
        pictures: The contents of its reports.
        files: The files that it stores in a run.
    """

    percept: Sequence[Field]
    control: Sequence[Field]
    kinds: tuple[str, ...] = ("any",)
    stages: Mapping[str, str] = MappingProxyType({})
    settings_type: ClassVar[type[DomainSettings]] = DomainSettings
    target_return: float = 0.0
    repeats: bool = True
    specialists: Specialists = Specialists()
    models: ClassVar[type[Models[Any]] | type[RewardedModels[Any]] | None] = Models
    pictures: ClassVar[type[Pictures[Any]]] = Pictures
    files: ClassVar[type[Files[Any]]] = Files

    def __init__(self, settings: DomainSettings | None = None) -> None:
        """A domain with these settings, or with the defaults."""
        self.settings = self.settings_type() if settings is None else settings

    @abstractmethod
    def draw(self, kind: str, count: int, generator: Generator) -> S:
        """`count` random scenarios (or 0) of one of `kinds`; all numbers are from the generator."""

    @abstractmethod
    def world(self, scenarios: S) -> Environment:
        """The world of these scenarios; one that is `Rewarded` gives returns."""

    def actions(self) -> ActionSet:
        """The actions of graphs.

        By default there are a network that sends a control, a step that carries it out, a network
        that branches, and a test of success that ends the skill. With rewards, episodes end by
        themselves, so there is no test, but there are more networks
        (`cgtorch.graphs.reward_actions`).
        """
        d, u = len(self.percept), len(self.control)
        if rewarded(self):
            return reward_actions(d, u)
        aim, branch = ContinuousNN(d, outputs=u), BranchingNN(d)
        return ActionSet(("Aim", "Step", "Branch", "Test"), (aim, Step(u), branch, Test()))

    def tests(self, kind: str) -> S:
        """The fixed test scenarios of a stage of this kind; none by default."""
        return self.draw(kind, 0, Generator().manual_seed(0))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """The domain itself: it is immutable, and copied models may refer to it."""
        return self


@runtime_checkable
class Adaptable(Protocol):
    """A domain that has several worlds, percepts and measures of success, as the tabletop has."""

    def for_run(self, kind: str, method: str) -> Domain[Any]:
        """The domain for a run with a kind of scenarios and a method."""

    def variants(self, kind: str) -> Iterable[Domain[Any]]:
        """Domains for which a skill file that names no domain may be meant, the usual one first."""

    def in_world(self, name: str) -> Domain[Any]:
        """The domain with another world; SettingsError if it has none of that name."""

    def other_measures(self) -> Mapping[str, Domain[Any]]:
        """Domains with the same world and another measure of success, by its name."""


@runtime_checkable
class Surveyed(Protocol):
    """A domain that knows scenarios that nothing can solve."""

    def solvable(self, scenarios: Any) -> Tensor:
        """(B,) bool, False for scenarios of which the domain knows that nothing solves them."""


@runtime_checkable
class Timed(Protocol):
    """A domain that tells how long its world takes."""

    def pace(self) -> str:
        """How long, such as "a step took 0.2 s in the mean"; "" if nothing is known yet."""


@runtime_checkable
class Sparing(Protocol):
    """A domain that can do without steps in its world which it would take to know it better."""

    def sparing(self) -> Domain[Any]:
        """The domain for a run in which each step in the world counts (--models learned)."""


def in_world(domain: Domain[Any], name: str) -> Domain[Any]:
    """A domain with another world; SettingsError if it has none of that name."""
    if not isinstance(domain, Adaptable):
        raise SettingsError(f"{type(domain).__name__} has one world only; leave world out")
    return domain.in_world(name)


def other_measures(domain: Domain[Any]) -> Mapping[str, Domain[Any]]:
    """Domains with the same world and another measure of success, by its name."""
    return domain.other_measures() if isinstance(domain, Adaptable) else {}


def rewarded(domain: Domain[Any]) -> bool:
    """Whether a domain's world gives returns."""
    return isinstance(domain.world(domain.draw(domain.kinds[0], 1, Generator())), Rewarded)


def counting(domain: Domain[Any]) -> bool:
    """Whether motions in a domain's world consist of low-level steps, which it counts."""
    return isinstance(domain.world(domain.draw(domain.kinds[0], 1, Generator())), Counting)


def episodic(domain: Domain[Any]) -> bool:
    """Whether a domain's world has episodes that end by themselves."""
    return isinstance(domain.world(domain.draw(domain.kinds[0], 1, Generator())), Episodic)


def most_lanes(domain: Domain[Any]) -> int | None:
    """How many lanes a domain's world can run at once; None if these are many."""
    world = domain.world(domain.draw(domain.kinds[0], 1, Generator()))
    return world.most_lanes if isinstance(world, Bounded) else None


def noisy(domain: Domain[Any]) -> bool:
    """Whether scenarios of a domain can be tried again with other noise."""
    scenarios = domain.draw(domain.kinds[0], 0, Generator())
    return type(scenarios).with_noise is not ScenarioBatch.with_noise
