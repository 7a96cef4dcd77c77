"""Which models a run learns, and what a Γ with rewards does not go together with."""

from typing import Any

from cgtorch.domains.domain import Domain
from cgtorch.domains.models import Models
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.ground.errors import SettingsError
from cgtorch.runs.settings import RunSettings


def models_of(domain: Domain[Any]) -> Models[Any]:
    """The domain's inputs and fits of Γ and C, the default ones if it has no others."""
    kind: Any = domain.models or Models
    made: Models[Any] = kind(domain) if issubclass(kind, Models) else Models(domain)
    return made


def reward_models_of(domain: Domain[Any]) -> RewardedModels[Any]:
    """The domain's inputs and fits of a Γ with rewards, the default ones if it has no others."""
    kind: Any = domain.models or Models
    own = issubclass(kind, RewardedModels)
    made: RewardedModels[Any] = kind(domain) if own else RewardedModels(domain)
    return made


def check_imagined(settings: RunSettings, domain: Domain[Any], repeats: bool) -> None:
    """SettingsError if a Γ with rewards cannot be learned in a run."""
    about = f"domain {settings.domain!r} gives rewards"
    usual = domain.models is None or not issubclass(domain.models, RewardedModels)
    if settings.models == "auto" and usual:
        raise SettingsError(
            f"{about}, which Γ and C do not know; evolve skills in a Γ with rewards, with few "
            "steps in the world: models 'learned' (--models learned), or in the world itself: "
            "models 'none' (--models none)"
        )
    refused = {
        "method 'paper'": settings.method != "compose",
        "logged data (--data)": bool(settings.data),
        "a world that does not repeat itself": not repeats,
    }
    if given := [name for name, there in refused.items() if there]:
        raise SettingsError(
            f"{about}, and a Γ with rewards is not learned with {given[0]}; leave that out, or "
            "evolve in the world itself: models 'none' (--models none)"
        )
    reward_models_of(domain)  # whose limits are checked


def check_played(settings: RunSettings, domain: Domain[Any], repeats: bool) -> None:
    """SettingsError if a run without a Γ with rewards was given what only that would use."""
    if reward := getattr(domain.settings, "reward", ""):
        raise SettingsError(
            f"reward is {reward!r:.60}, which only learned models use, and this run learns none; "
            "add models 'learned' (--models learned), or leave reward out"
        )
