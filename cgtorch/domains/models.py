"""Γ and C of a domain: the first data, their inputs, and how they are fitted."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Generator, Tensor, nn

from cgtorch.domains import knowledge as learned
from cgtorch.domains.exploration import Exploration, explore, random_controls
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.reports import SuccessReport, TransitionReport
from cgtorch.domains.success import SuccessClassifier, fit_success_classifier
from cgtorch.domains.transition import KernelTransitionModel, TransitionModel
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.ground.environment import Dataset, Environment
from cgtorch.ground.fields import Field
from cgtorch.simulation.model import anything


class HasFields(Protocol):
    """A domain, as far as models need it: the fields of percepts and controls."""

    percept: Sequence[Field]
    control: Sequence[Field]


D = TypeVar("D", bound=HasFields)
"""The domain of models."""


class Models(Generic[D]):
    """Γ and C of a domain, which names a subclass as `Domain.models` to say more about them.

    Attributes:
        domain: The domain.
    """

    def __init__(self, domain: D) -> None:
        """The models of a domain."""
        self.domain = domain

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
        return random_controls(self.domain.control, count, generator)

    def worth_testing(self, percept: Tensor) -> Tensor:
        """(n,) bool, whether an exploration tests success at percepts (n, D); by default it does.

        Without tests where success is out of the question, a robot saves time.
        """
        return torch.ones(len(percept), dtype=torch.bool)

    def transition_features(self, percept: Tensor, control: Tensor) -> Tensor:
        """Additional features (..., F) for Γ; models that have any must be picklable."""
        return percept[..., :0]

    def success_features(self, percept: Tensor) -> Tensor:
        """Additional features (..., F) for C; models that have any must be picklable."""
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

    def fit(self, data: Dataset, seed: int) -> Knowledge:
        """Γ and C of the data (`cgtorch.domains.knowledge.fit_models`)."""
        return learned.fit_models(self.fit_success, self.fit_transition, data, seed)

    def learn(self, knowledge: Knowledge, more: Dataset, generator: Generator) -> Knowledge:
        """Γ and C trained on additional experience (`cgtorch.domains.knowledge.learn`)."""
        return learned.learn(self.fit, knowledge, more, generator)

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

    def _transition_model(self) -> KernelTransitionModel:
        fields = self.domain.percept, self.domain.control
        return KernelTransitionModel(*fields, self._own("transition_features"))

    def _success_classifier(self) -> SuccessClassifier:
        return SuccessClassifier(self.domain.percept, self._own("success_features"))

    def _own(self, method: str) -> Any:
        """The method if a subclass has overridden it, else None, so that models can skip it."""
        same = getattr(type(self), method) is getattr(Models, method)
        return None if same else getattr(self, method)
