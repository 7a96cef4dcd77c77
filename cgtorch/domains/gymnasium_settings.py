"""The settings of a Gymnasium environment as a domain."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cgtorch.domains.settings import DomainSettings, option


@dataclass(frozen=True)
class GymnasiumSettings(DomainSettings):
    """The environment, and the return from which an episode is solved."""

    run_defaults: ClassVar[Mapping[str, Any]] = {
        "population": 48,
        "generations": 400,
        # The goal is a mean over fresh episodes, so short rounds test it soon.
        "attempts": 4,
        # Episodes end by themselves; this ends only graphs that never act.
        "max_transitions": 100_000,
    }

    environment: str = option(
        "CartPole-v1",
        "Id of the environment, as in the domain's name.",
        "the run was made for it",
        when="It follows from --domain gymnasium:ENV_ID.",
    )
    target_return: float = option(
        math.inf,
        "Return from which an episode counts as solved; by default the environment's threshold.",
        "W was selected by that return",
        least=-math.inf,
        most=math.inf,
        when="Give --target if the environment has no threshold.",
    )
