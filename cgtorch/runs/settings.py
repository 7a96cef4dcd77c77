"""The settings that every run has, which of them may change, and the goal of rounds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from cgtorch.domains.settings import DomainSettings, check_options, option
from cgtorch.ground.errors import SettingsError

METHODS = ("compose", "paper")
CHANCE = ("auto", "yes", "no")
MODELS = ("auto", "learned", "none")
HUGE = 1e38  # as a mean return, which is beyond what single precision holds
MOST_TRIED = 1_000_000
"""The largest number of scenarios of one evaluation, as all of them are in memory."""
SCENARIOS = "The kind of scenarios, or auto for the domain's usual kind."


@dataclass(frozen=True)
class RunSettings:
    """The settings of a run, besides its domain's; SettingsError for a value that cannot work.

    They are stored in the run; those without a reason to be fixed can be changed later.
    """

    domain: str = option(
        "tabletop",
        "The domain of the run: tabletop, gymnasium:ENV_ID, gymnasium:module:ENV_ID, the name of "
        "an installed domain, or package.module:Class.",
        "everything in the run belongs to it",
        when="Change it to train for another task.",
    )
    seed: int = option(
        0,
        "Seed of all random numbers.",
        "everything in the run was drawn from it",
        least=0,
        when="Change it to repeat an experiment with other random numbers.",
    )
    method: str = option(
        "compose",
        "How a skill is improved: compose evolves specialists and a gating network, paper "
        "grows one graph as published.",
        "neither method can continue the other's skills",
        choices=METHODS,
        when="Use paper to reproduce the publication.",
    )
    models: str = option(
        "auto",
        "Where skills are evolved: learned (inside the models Γ and C), none (in the world "
        "itself), or auto (the domain's choice).",
        "the skills of the run were evolved that way",
        choices=MODELS,
        when="Use none if the world is fast and its transitions are hard to learn.",
    )
    chance: str = option(
        "auto",
        "Whether success is chance, so that skills are evolved on fresh scenarios in the world and "
        "compared by means: auto (measured by replays under other noise), yes, or no.",
        choices=CHANCE,
        when="Use yes if you know that it is, to save the measurement.",
        before="auto",
    )
    population: int = option(
        400,
        "Number of individuals in a population. Where rewards are given or success is chance, the "
        "default is 48.",
        least=2,
        when="Raise it if evolutions end without a solution; time grows in proportion.",
    )
    islands: int = option(
        1,
        "Number of populations that evolve separately and exchange their best individuals.",
        when="Raise it if one machine cannot hold the population.",
    )
    migration: int = option(
        5,
        "Number of generations between two exchanges of islands.",
        when="Raise it if islands become alike too soon.",
    )
    generations: int = option(
        150,
        "Maximum number of generations of one evolution.",
        when="Raise it if the best fitness still grows at the end of an evolution.",
    )
    attempts: int = option(
        24,
        "Maximum number of candidates in one stage.",
        when="Raise it if a stage ends without an accepted skill.",
    )
    tournament: int = option(
        5,
        "Number of individuals in a tournament; used with --method paper and with rewards.",
        when="Raise it for a search that converges sooner, lower it for more variety.",
    )
    lineages: int = option(
        4,
        "Number of graphs whose parameters CMA-ES tunes side by side in domains with rewards; 0 "
        "for mutation only.",
        least=0,
        when="Set it to 0 to compare with mutation only.",
    )
    max_transitions: int = option(
        20,
        "Number of executed actions after which a skill has failed.",
        when="Set it to three times the number of controls that an episode needs.",
    )
    practice: int = option(
        0,
        "Number of fresh scenarios that a skill solves in a row before its stage ends; 0 for 150 "
        "where the world repeats itself, else 20, or 10 in a stage.",
        least=0,
        when="Raise it for a surer skill, lower it to ask less of a robot.",
    )
    transitions: int = option(
        2000,
        "Largest number of motions to explore before the first skill, those of --data counted; 0 "
        "with --data to explore no further.",
        "the first models were learned from them",
        least=12,
        also=(0,),
        when="Lower it if motions are dear and success is easily met.",
    )
    scenarios: str = option(
        "auto",
        f"{SCENARIOS} The tabletop has perimeter (the paper's table), general (any table, from any "
        "side) and general-clutter (with boxes in the way).",
        "W and M contain such scenarios",
        when="Change it to train on another kind of scenarios.",
    )
    driver: str = option(
        "",
        "The driver of a robot in place of the simulated world, as package.module:Class.",
        "the robot has acted in the run",
        when="Give it to learn on a robot.",
        before="",
    )
    actions: tuple[str, ...] = option(
        (),
        "Additional actions: names or package.module:Class.",
        "the graphs of the run contain them",
        when="Add actions that you wrote.",
    )
    data: tuple[str, ...] = option(
        (),
        "Logged transitions and tests from which Γ and C are learned: CSV or Parquet files, or "
        "folders of Minari datasets.",
        "the first models were learned from them",
        when="Give the logs that you have, to explore less or not at all.",
        before=(),
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.transitions == 0 and not self.data:
            raise SettingsError(
                "transitions is 0, and there is nothing else to learn Γ and C from; give at least "
                "12, or files of logged transitions as data (--data)"
            )


NAMES = tuple(f.name for f in fields(RunSettings))


def defaults_of(domain_settings: type[DomainSettings]) -> dict[str, Any]:
    """The defaults of all settings of a run in a domain."""
    own: Mapping[str, Any] = domain_settings.run_defaults
    return {f.name: own.get(f.name, f.default) for f in fields(RunSettings)}


def all_fields(domain_settings: type[DomainSettings]) -> tuple[Any, ...]:
    """The fields of the settings of a run and its domain."""
    return (*fields(RunSettings), *fields(domain_settings))


def help_of(f: Any, domain: str, kinds: Sequence[str]) -> str:
    """The help of a setting in a domain with these kinds of scenarios, () if not known."""
    if f.name != "scenarios" or domain == RunSettings.domain:
        return str(f.metadata["help"])
    return f"{SCENARIOS} This domain has {', '.join(kinds)}." if kinds else SCENARIOS


def option_of(name: str) -> str:
    """The name of a setting's command-line option."""
    return f"--{name.replace('_', '-')}"


DECISIVE, SCREENING = 40, 10
"""Expected failures of a skill at the target, in the decisive test and in the screening test."""
COARSE = 0.2  # share of failures from which tests are as long as for this one
MOST_SHARE = 0.999
"""The largest share of scenarios that can be asked for."""


@dataclass(frozen=True)
class Goal:
    """Target and limits of a training, which can change later; SettingsError for bad values."""

    target: float = option(
        0.99,
        "With --stage auto: the share of fresh scenarios to solve, above 0. In a domain with "
        "rewards: the mean return to reach, by default the return from which an episode counts as "
        "solved (target_return).",
        least=-HUGE,
        most=HUGE,
        when="Raise it for a surer skill; the tests become longer.",
    )
    minutes: float = option(
        10.0,
        "With --stage auto: end after this time, min. The best skill so far is kept, and --resume "
        "continues it. An exploration before the first round is finished.",
        least=0,
        most=1e6,
        when="Raise it for hard tasks.",
    )
    rounds: int = option(
        30,
        "With --stage auto: maximum number of rounds of a run.",
        when="Lower it to bound the work in place of the time.",
    )

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def screening(self) -> int:
        """Maximum number of scenarios of the screening test, before the decisive test: 1000."""
        return round(SCREENING / self.fine)

    @property
    def decisive(self) -> int:
        """Number of scenarios of the decisive test: 4000 for 99 %."""
        return round(DECISIVE / self.fine)

    @property
    def fine(self) -> float:
        """The share of failures for which tests are made, at most `COARSE`.

        Where more may fail, a few successes more or less decide nothing otherwise.
        """
        return min(1 - self.target, COARSE)
