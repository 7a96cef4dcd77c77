"""The interface of a domain, which is the task of a run.

A domain defines percepts and controls, draws scenarios, and makes their world. Everything else has
a default. The paper's tabletop (`cgtorch.tabletop`) is one domain, any Gymnasium environment
(`cgtorch.domains.gymnasium`) another, and docs/own-domain.md defines a third in sixty lines.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import torch
from torch import Generator, Tensor, nn

from cgtorch.domains import knowledge as learned
from cgtorch.domains.exploration import Exploration, explore, random_controls
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.settings import DomainSettings
from cgtorch.domains.success import SuccessClassifier, fit_success_classifier
from cgtorch.domains.transition import KernelTransitionModel, TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.graphs import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    Step,
    Test,
    reward_actions,
)
from cgtorch.ground.environment import Dataset, Environment, Rewarded, ScenarioBatch
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.fields import Field
from cgtorch.improvement.compose import local_group
from cgtorch.improvement.setup import Grouping
from cgtorch.simulation.model import anything

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cgtorch.graphs import Skill

S = TypeVar("S", bound=ScenarioBatch)
"""The scenarios of a domain."""


@dataclass(frozen=True)
class Published:
    """A published result of a stage, or of all scenarios: how many of those tried succeeded.

    It has a remark on the result, and details as headings and texts.
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
    """How missed scenarios are assigned to specialists (`cgtorch.improvement`).

    Attributes:
        group_of: Chooses the scenarios on which a specialist is evolved.
        group: Number of these scenarios.
        stall: Generations without a better fitness after which its search gives up.
    """

    group_of: Grouping = local_group
    group: int = 12
    stall: int = 40


class Domain(ABC, Generic[S]):
    """The task of a run; a subclass defines `percept`, `control`, `draw` and `world`.

    Attributes:
        percept: The D fields of a percept.
        control: The U fields of a control.
        kinds: The names of all kinds of scenarios.
        trained_kinds: The kinds on which a run can train, the usual one first; all if empty.
        stages: A run's stages in order, each with the kind of its scenarios. Without stages, a run
            continues in rounds until its goal is reached.
        settings_type: The domain's own settings, which become options of `cgtorch-train`.
        target_return: With rewards, the return from which an episode counts as solved.
        repeats: Whether a world that is asked the same gives the same answer, so that a trial can
            be made again. If not, each trial is one sample of what may happen.
        live: Whether the world is a robot: one instance, which cannot be put back. Nothing is asked
            of it only for a report.
        models: "learned" if skills are evolved in Γ and C, "none" if in the world itself.
        published: Published results by stage, or under "" for all scenarios together.
        publisher: The authors of these results.
        solved: The word for a solved scenario, and for several of them.
        specialists: How missed scenarios are assigned to specialists.
    """

    percept: Sequence[Field]
    control: Sequence[Field]
    stages: Mapping[str, str] = MappingProxyType({})
    kinds: tuple[str, ...] = ("any",)
    trained_kinds: tuple[str, ...] = ()
    settings_type: ClassVar[type[DomainSettings]] = DomainSettings
    target_return: float = 0.0
    repeats: bool = True
    live: bool = False
    models: str = "learned"
    published: ClassVar[Mapping[str, Published]] = {}
    publisher: ClassVar[str] = "published"
    solved: ClassVar[tuple[str, str]] = ("solved", "Scenarios solved")
    specialists: Specialists = Specialists()

    def __init__(self, settings: DomainSettings | None = None) -> None:
        """A domain with these settings, or with the defaults."""
        self.settings = self.settings_type() if settings is None else settings

    # What has to be given

    @abstractmethod
    def draw(self, kind: str, count: int, generator: Generator) -> S:
        """`count` random scenarios (or 0) of one of `kinds`; all numbers are from the generator."""

    @abstractmethod
    def world(self, scenarios: S) -> Environment:
        """The world of these scenarios; one that is `Rewarded` gives returns."""

    # What can be given: skills

    def actions(self) -> ActionSet:
        """The actions of graphs.

        By default there are a network that sends a control, a step that carries it out, a network
        that branches, and a test of success that ends the skill. With rewards, episodes end by
        themselves, so there is no test, but there are more networks
        (`cgtorch.graphs.reward_actions`).
        """
        d, u = len(self.percept), len(self.control)
        if self.rewarded:
            return reward_actions(d, u)
        aim, branch = ContinuousNN(d, outputs=u), BranchingNN(d)
        return ActionSet(("Aim", "Step", "Branch", "Test"), (aim, Step(u), branch, Test()))

    def tests(self, kind: str) -> S:
        """The fixed test scenarios of a stage of this kind; none by default."""
        return self.draw(kind, 0, Generator().manual_seed(0))

    # What can be given: models

    def explore(self, about: Exploration) -> Dataset:
        """The first data for Γ and C: transitions (p, u, p′), and tests of success.

        DataError if almost all tests succeed, or almost none.
        """
        return explore(self, about)

    def worth_trying(self, percept: Tensor, count: int, generator: Generator) -> Tensor:
        """(n, U) random controls that an exploration may try at a percept (D,).

        By default they are uniform within the bounds of their fields. Controls that often end near
        success teach C more. DomainError if a control has no bounds.
        """
        return random_controls(self.control, count, generator)

    def worth_testing(self, percept: Tensor) -> Tensor:
        """(n,) bool, whether an exploration tests success at percepts (n, D); by default it does.

        Without tests where success is out of the question, a robot saves time.
        """
        return torch.ones(len(percept), dtype=torch.bool)

    def transition_features(self, percept: Tensor, control: Tensor) -> Tensor:
        """Additional features (..., F) for Γ; a domain that has any must be picklable."""
        return percept[..., :0]

    def success_features(self, percept: Tensor) -> Tensor:
        """Additional features (..., F) for C; a domain that has any must be picklable."""
        return percept[..., :0]

    def possible(self, percept: Tensor, control: Tensor) -> Tensor:
        """(n,) bool, whether controls (n, U) can be carried out, judged by percepts (n, D)."""
        return torch.ones(len(percept), dtype=torch.bool, device=percept.device)

    def noisy(self, percept: Tensor) -> Tensor:
        """(n, D), 1 for numbers of a percept that Γ can get wrong, 0 for those it cannot."""
        return torch.ones_like(percept)

    def unfitted(self) -> Mapping[str, Callable[[], nn.Module]]:
        """Functions that make unfitted models of this domain, by class name."""
        return {
            "KernelTransitionModel": self._transition_model,
            "SuccessClassifier": self._success_classifier,
        }

    def fit_transition(self, data: Dataset, seed: int) -> tuple[TransitionModel, TransitionReport]:
        """Γ fitted to the transitions, with hyper-parameters from cross-validation."""
        rows = data.percept, data.control, data.next_percept
        return fit_transition_model(self._transition_model(), *rows, seed=seed)

    def fit_success(self, data: Dataset, seed: int) -> tuple[SuccessClassifier, SuccessReport]:
        """C fitted to the tests of success, with hyper-parameters from cross-validation."""
        model = self._success_classifier()
        return fit_success_classifier(model, data.tested, data.succeeded, seed=seed)

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
        """Store in a run's folder what the domain needs besides its settings."""

    @classmethod
    def read(cls, settings: DomainSettings, folder: Path) -> Self:
        """The domain of a run, from its settings and the files of `write`, or a CgtorchError."""
        return cls(settings)

    def made_with(self) -> Mapping[str, str]:
        """Versions of everything on which the domain's numbers depend, by name."""
        return {}

    def stored_options(self, folder: Path) -> Mapping[str, str]:
        """Settings by name that make the domain again from the files of `write`."""
        return {}

    def draw_scenarios(
        self, scenarios: S, succeeded: Tensor, targets: Tensor, title: str = ""
    ) -> "Figure | None":
        """A picture of which of B scenarios succeeded (B,) bool; None if the domain has none.

        `targets` (B,) bool marks the test scenarios of a stage. A report shows the figure's label
        (`Figure.set_label`) below it.
        """
        return None

    def film(self, skill: "Skill", scenarios: S) -> bytes | None:
        """An animated WebP picture of a skill on the first scenario; None if the domain has none.

        A report shows it. CgtorchError if it cannot be drawn on this machine.
        """
        return None

    def draw_stage(self, stage: str) -> str:
        """A small SVG drawing of a stage for reports; "" if the domain has none."""
        return ""

    def about(self) -> list[tuple[str, str]]:
        """Names and values for a report, such as the robot."""
        return []

    # What a run makes of it

    def for_run(self, kind: str, method: str) -> Self:
        """The domain for a run with a kind of scenarios and a method; itself by default."""
        return self

    def in_world(self, name: str) -> Self:
        """The domain with another world; SettingsError if it has none of that name."""
        raise SettingsError(f"{type(self).__name__} has one world only; leave --world out")

    def other_measures(self) -> Mapping[str, "Domain[S]"]:
        """Domains with the same world and another measure of success, by its name."""
        return {}

    def variants(self, kind: str) -> Iterable["Domain[S]"]:
        """Domains for which a skill file that names no domain may be meant, the usual one first."""
        return (self,)

    # What follows from the above

    @property
    def usual_kind(self) -> str:
        """The default kind of scenarios of a run."""
        return (self.trained_kinds or self.kinds)[0]

    @property
    def rewarded(self) -> bool:
        """Whether the domain's world gives returns."""
        return isinstance(self.world(self.draw(self.usual_kind, 1, Generator())), Rewarded)

    @property
    def noisy_world(self) -> bool:
        """Whether scenarios can be tried again with other noise."""
        scenarios = self.draw(self.usual_kind, 0, Generator())
        return type(scenarios).with_noise is not ScenarioBatch.with_noise

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """The domain itself: it is immutable, and copied models may refer to it."""
        return self

    def _transition_model(self) -> KernelTransitionModel:
        further = self._own("transition_features")
        return KernelTransitionModel(self.percept, self.control, further)

    def _success_classifier(self) -> SuccessClassifier:
        return SuccessClassifier(self.percept, self._own("success_features"))

    def _own(self, method: str) -> Any:
        """The method if a subclass has overridden it, else None, so that models can skip it."""
        same = getattr(type(self), method) is getattr(Domain, method)
        return None if same else getattr(self, method)
