"""The settings that every run has, whatever its domain; `cgtorch.domains.settings` has the rest."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from cgtorch.domains.settings import DomainSettings, check_options, option

METHODS = ("compose", "paper")
MODELS = ("auto", "learned", "none")


@dataclass(frozen=True)
class RunSettings:
    """What decides a run's result besides its domain; SettingsError if a value cannot work.

    It is stored in the run; some can be taken over by name later (`cgtorch.runs.resume_settings`).
    """

    domain: str = option(
        "tabletop",
        "What the run is about: tabletop, gymnasium:ENV_ID, the name of an installed domain, or "
        "package.module:Class.",
        "all that is there is about it",
    )
    seed: int = option(
        0, "Seed of everything random.", "all that is there was drawn from it", least=0
    )
    method: str = option(
        "compose",
        "How a skill is improved: compose, or paper as published.",
        "neither method goes on with what the other has made",
        choices=METHODS,
    )
    models: str = option(
        "auto",
        "Where skills are evolved: learned for models Γ and C, none for the world itself, auto for "
        "what the domain says.",
        "all that is there was found that way",
        choices=MODELS,
    )
    population: int = option(400, "Individuals in a population.", least=2)
    islands: int = option(1, "Populations that evolve apart and exchange their best.")
    migration: int = option(5, "Generations between two such exchanges.")
    generations: int = option(150, "Most generations of one evolution.")
    attempts: int = option(24, "Most evolutions in one stage.")
    tournament: int = option(
        5, "Individuals in a tournament, by which --method paper and rewards select."
    )
    lineages: int = option(
        4,
        "Structures whose parameters are tuned at once, where there are rewards; 0 for mutation "
        "alone.",
        least=0,
    )
    max_transitions: int = option(20, "Transitions after which a skill has failed.")
    practice: int = option(
        150, "Random scenarios practised in each stage beside its tests.", least=0
    )
    transitions: int = option(
        2000,
        "Random transitions collected for the transition model.",
        "the first models were learned from them",
        least=50,
    )
    labels: int = option(
        2000,
        "Tests of success collected for the success classifier.",
        "the first models were learned from them",
        least=60,
    )
    scenarios: str = option(
        "auto",
        "What the run is about, of the kinds that the domain has, auto for the usual one; of the "
        "tabletop perimeter of the paper's table, general for any table from any side, "
        "general-clutter with boxes in the way.",
        "W and M are such scenarios",
    )
    actions: tuple[str, ...] = option(
        (),
        "Further actions: names or package.module:Class.",
        "the graphs that are there are made of them",
    )

    def __post_init__(self) -> None:
        check_options(self)


NAMES = tuple(f.name for f in fields(RunSettings))


def defaults_of(domain_settings: type[DomainSettings]) -> dict[str, Any]:
    """The defaults of all settings of a run about a domain."""
    own: Mapping[str, Any] = domain_settings.run_defaults
    return {f.name: own.get(f.name, f.default) for f in fields(RunSettings)}


def all_fields(domain_settings: type[DomainSettings]) -> tuple[Any, ...]:
    """The fields of a run's settings and of its domain's."""
    return (*fields(RunSettings), *fields(domain_settings))


def option_of(name: str) -> str:
    """A setting as the command line calls it."""
    return f"--{name.replace('_', '-')}"
