"""The domain interface: what a run is about.

A domain says what a percept and a control are, draws scenarios, and makes their world; all else has
a default. The paper's tabletop (`cgtorch.tabletop`) is one domain, any Gymnasium environment
(`cgtorch.domains.gymnasium`) another, and docs/own-domain.md makes a third in sixty lines.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import torch
from torch import Generator, Tensor, nn

from cgtorch.actions import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    Grasp,
    MoveBase,
    reward_actions,
)
from cgtorch.domains import knowledge as learned
from cgtorch.domains.exploration import explore
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.settings import DomainSettings
from cgtorch.domains.success import SuccessClassifier, fit_success_classifier
from cgtorch.domains.summary import summary_of
from cgtorch.domains.transition import KernelTransitionModel, TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.environment import Dataset, Environment, Rewarded, ScenarioBatch
from cgtorch.environment.fields import Field
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.events import ModelSummary
from cgtorch.improvement.grouping import local_group
from cgtorch.improvement.interfaces import Grouping
from cgtorch.simulation.model import anything

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cgtorch.graphs import Skill

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a domain."""


@dataclass(frozen=True)
class Published:
    """What others report of a stage, or of all scenarios: how many succeeded of those tried.

    They have a remark on the result, and headings and texts about it.
    """

    succeeded: int
    tried: int
    remark: str = ""
    details: tuple[tuple[str, str], ...] = ()

    @property
    def text(self) -> str:
        """Solved of tried, in short."""
        return f"{self.succeeded}/{self.tried}"


@dataclass(frozen=True)
class Specialists:
    """How missed scenarios are given to specialists (`cgtorch.improvement`).

    Attributes:
        group_of: chooses the scenarios that a specialist is evolved on.
        group: how many these are.
        stall: generations without a better fitness after which its search gives up.
    """

    group_of: Grouping = local_group
    group: int = 12
    stall: int = 40


class Domain(ABC, Generic[S]):
    """What a run is about; a subclass gives `percept`, `control`, `draw` and `world`.

    Attributes:
        percept: the D numbers of a percept.
        control: the U numbers of a control.
        kinds: of scenarios, by name.
        trained_kinds: those that a run can be about, the usual one first; all if empty.
        stages: a run's stages in their order, each with the kind of its scenarios. Without any, a
            run goes on in rounds until its goal is met.
        settings_type: the domain's own settings, which become options of `cgtorch-train`.
        target_return: where the world gives rewards, the return from which an episode is solved.
        models: "learned" if skills are evolved in Γ and C, "none" if in the world itself.
        published: what others report of a stage or, under "", of all scenarios together.
        publisher: who reports that.
        fresh_tests: what the tests of the first models in `summary` are about, by the beginning of
            their tags: such as "gamma/fresh_x", followed by _error and _floor, or "classifier/x",
            followed by _accuracy and _possible.
        solved: the word for a scenario that was solved, and for many of them.
        specialists: how missed scenarios are given to specialists.
    """

    percept: Sequence[Field]
    control: Sequence[Field]
    stages: Mapping[str, str] = MappingProxyType({})
    kinds: tuple[str, ...] = ("any",)
    trained_kinds: tuple[str, ...] = ()
    settings_type: ClassVar[type[DomainSettings]] = DomainSettings
    target_return: float = 0.0
    models: str = "learned"
    published: ClassVar[Mapping[str, Published]] = {}
    publisher: ClassVar[str] = "published"
    fresh_tests: ClassVar[Mapping[str, str]] = {}
    solved: ClassVar[tuple[str, str]] = ("solved", "Scenarios solved")
    specialists: Specialists = Specialists()

    def __init__(self, settings: DomainSettings | None = None) -> None:
        """A domain with these settings, its own if there are any, or their defaults."""
        self.settings = self.settings_type() if settings is None else settings

    # What has to be given

    @abstractmethod
    def draw(self, kind: str, count: int, generator: Generator) -> S:
        """So many random scenarios, also 0, of one of `kinds`; all numbers from the generator."""

    @abstractmethod
    def world(self, scenarios: S) -> Environment:
        """The world of these scenarios; one that is `Rewarded` gives returns."""

    # What can be given: skills

    def actions(self) -> ActionSet:
        """What nodes of graphs can do.

        A network sends a control, a step carries it out, a network branches, and a test of success
        ends the skill. Where the world gives rewards, and so ends by itself, there is no test, and
        there are more networks (`cgtorch.actions.reward_actions`).
        """
        d, u = len(self.percept), len(self.control)
        if self.rewarded:
            return reward_actions(d, u)
        aim, branch = ContinuousNN(d, outputs=u), BranchingNN(d)
        return ActionSet(("Aim", "Step", "Branch", "Test"), (aim, MoveBase(u), branch, Grasp()))

    def tests(self, kind: str) -> S:
        """The fixed scenarios that a stage of this kind is tested on first; none by default."""
        return self.draw(kind, 0, Generator().manual_seed(0))

    # What can be given: models

    def explore(self, kind: str, transitions: int, tests: int, generator: Generator) -> Dataset:
        """Experience of acting at random: transitions (p, u, p′), and tests of success.

        DataError if success, or its absence, is hardly ever met.
        """
        return explore(
            lambda count: self.world(self.draw(kind, count, generator)),
            self.control, transitions, tests, generator,
        )  # fmt: skip

    def transition_features(self, percept: Tensor, control: Tensor) -> Tensor:
        """Further features (..., F) that Γ learns from; with any, the domain must be picklable."""
        return percept[..., :0]

    def success_features(self, percept: Tensor) -> Tensor:
        """Further features (..., F) that C learns from; with any, the domain must be picklable."""
        return percept[..., :0]

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        """(n,) bool, whether controls (n, U) can be carried out as percepts (n, D) show it."""
        return torch.ones(len(percept), dtype=torch.bool, device=percept.device)

    def noisy(self, percept: Tensor) -> Tensor:
        """(n, D) 1 for numbers of a percept that Γ can get wrong, 0 for those it cannot."""
        return torch.ones_like(percept)

    def unfitted(self) -> Mapping[str, Callable[[], nn.Module]]:
        """What makes unfitted models of this domain, by the name of their class."""
        return {
            "KernelTransitionModel": self._transition_model,
            "SuccessClassifier": self._success_classifier,
        }

    def fit_transition(self, data: Dataset, seed: int) -> tuple[TransitionModel, TransitionReport]:
        """Γ of the transitions in the data, hyper-parameters by cross-validation."""
        rows = data.percept, data.control, data.next_percept
        return fit_transition_model(self._transition_model(), *rows, seed=seed)

    def fit_success(self, data: Dataset, seed: int) -> tuple[SuccessClassifier, SuccessReport]:
        """C of the tests in the data, hyper-parameters by cross-validation."""
        model = self._success_classifier()
        return fit_success_classifier(model, data.tested, data.succeeded, seed=seed)

    def try_transition(
        self, kind: str, gamma: TransitionModel, tests: int, generator: Generator
    ) -> Any:
        """What the first Γ of a run does on fresh experience, for `summary`; nothing by default.

        It may be asked for in a process of its own, so it must not change anything. At most so many
        fresh tests of success are made, which C is to be judged by.
        """
        return None

    def summary(
        self, kind: str, knowledge: Knowledge, fresh: Any, generator: Generator
    ) -> ModelSummary:
        """What is told of the first models of a run; `fresh` is what `try_transition` gave."""
        return summary_of(knowledge)

    def imagine(
        self,
        knowledge: Knowledge,
        percepts: Tensor,
        replicas: int,
        generator: Generator,
        device: torch.device | str = "cpu",
    ) -> Environment:
        """The models as an environment; see `cgtorch.domains.knowledge.imagine`."""
        return learned.imagine(
            knowledge, percepts, replicas, generator, device,
            possible=self._own("possible") or anything, noisy=self.noisy,
        )  # fmt: skip

    # What can be given: files and pictures

    def write(self, folder: Path) -> None:
        """Keep in a run's folder what the domain was made of besides its settings."""

    @classmethod
    def read(cls, settings: DomainSettings, folder: Path) -> Self:
        """The domain of a run, from its settings and what `write` has kept, or a CgtorchError."""
        return cls(settings)

    def made_with(self) -> Mapping[str, str]:
        """Versions of what the domain's numbers depend on, by name."""
        return {}

    def stored_options(self, folder: Path) -> Mapping[str, str]:
        """Settings by name that make the domain again from what `write` has kept in a run."""
        return {}

    def draw_scenarios(
        self, scenarios: S, succeeded: Tensor, targets: Tensor, title: str = ""
    ) -> "Figure | None":
        """A picture of which of B scenarios succeeded (B,) bool; None if the domain has none.

        The targets (B,) bool are those that a stage is tested on. A label of the figure
        (`Figure.set_label`) is told below it in a report.
        """
        return None

    def film(self, skill: "Skill", scenarios: S) -> bytes | None:
        """An animated WebP picture of a skill on the first scenario; None if the domain has none.

        A report shows it. CgtorchError if it cannot be drawn on this machine.
        """
        return None

    def draw_stage(self, stage: str) -> str:
        """A small SVG of what a stage is about, for reports; "" if the domain has none."""
        return ""

    def about(self) -> list[tuple[str, str]]:
        """Names and values that a report tells of the domain, such as which robot it is about."""
        return []

    # What a run makes of it

    def for_run(self, kind: str, method: str) -> Self:
        """The domain for a run about a kind of scenarios and with a method; itself by default."""
        return self

    def in_world(self, name: str) -> Self:
        """The domain with another world of that name; SettingsError if it has none."""
        raise SettingsError(f"{type(self).__name__} has one world only; leave --world out")

    def other_measures(self) -> Mapping[str, "Domain[S]"]:
        """The same world where success is measured otherwise, by what that success is called."""
        return {}

    def variants(self, kind: str) -> Iterable["Domain[S]"]:
        """Domains, the usual one first, whose skills a file that tells no domain may hold."""
        return (self,)

    # What follows from the above

    @property
    def usual_kind(self) -> str:
        """What runs are about if nothing else is said."""
        return (self.trained_kinds or self.kinds)[0]

    @property
    def rewarded(self) -> bool:
        """Whether the domain's world gives returns."""
        return isinstance(self.world(self.draw(self.usual_kind, 1, Generator())), Rewarded)

    @property
    def noisy_world(self) -> bool:
        """Whether scenarios can be met again by other noise."""
        scenarios = self.draw(self.usual_kind, 0, Generator())
        return type(scenarios).with_noise is not ScenarioBatch.with_noise

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """The domain itself: it never changes, and models that are copied may point to it."""
        return self

    def _transition_model(self) -> KernelTransitionModel:
        further = self._own("transition_features")
        return KernelTransitionModel(self.percept, self.control, further)

    def _success_classifier(self) -> SuccessClassifier:
        return SuccessClassifier(self.percept, self._own("success_features"))

    def _own(self, method: str) -> Any:
        """A method that a subclass has overridden, or None: models need not know of others."""
        same = getattr(type(self), method) is getattr(Domain, method)
        return None if same else getattr(self, method)
