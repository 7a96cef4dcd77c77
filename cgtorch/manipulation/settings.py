"""Settings of tasks for arms; they import no torch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cgtorch.domains.settings import LAST, DomainSettings, option

WITH_ID, WITHOUT_ID = "given", "hidden"


@dataclass(frozen=True)
class ManipulationSettings(DomainSettings):
    """The tasks, and the length of an episode."""

    run_defaults: ClassVar[Mapping[str, Any]] = {
        "models": "none",
        "population": 24,
        "generations": 40,
        "practice": 75,
        "max_transitions": 16,
        "attempts": 24,
    }

    usual_stage: ClassVar[str] = LAST
    domain: ClassVar[str] = "metaworld"

    environment: str = option(
        "push-v3",
        "The task, or a set of tasks, as in the domain's name.",
        "the run was made for it",
        when="It follows from --domain metaworld:TASK.",
    )
    horizon: int = option(
        200,
        "Low-level steps of an episode, at most.",
        "W was selected with episodes of that length",
        when="Continual World has 200, the other sets of Meta-World 500.",
    )
    task_id: str = option(
        WITH_ID,
        "Whether percepts tell the task, where there are several.",
        "it is part of all percepts",
        choices=(WITH_ID, WITHOUT_ID),
        when="Hide it to see whether skills recognise a task by what they perceive.",
    )

    @property
    def name(self) -> str:
        """The name of the domain."""
        return f"{self.domain}:{self.environment}"


@dataclass(frozen=True)
class FetchSettings(ManipulationSettings):
    """The tasks of Gymnasium-Robotics, whose episodes have 50 steps."""

    run_defaults: ClassVar[Mapping[str, Any]] = {
        **ManipulationSettings.run_defaults,
        "max_transitions": 10,
    }
    domain: ClassVar[str] = "gymnasium-robotics"

    environment: str = option(
        "FetchPush-v4",
        "The task, as in the domain's name.",
        "the run was made for it",
        when="It follows from --domain gymnasium-robotics:TASK.",
    )
    horizon: int = option(
        50,
        "Low-level steps of an episode.",
        "W was selected with episodes of that length",
        when="All published results have 50.",
    )
