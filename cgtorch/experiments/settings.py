"""The settings of a run: one dataclass that the command line, the API and the files share."""

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from cgtorch.errors import SettingsError

METHODS = ("compose", "paper")
SCENARIOS = ("perimeter", "general", "general-clutter")
PERCEPTS = ("auto", "box", "yaw")
NETWORKS = ("auto", "percept", "edge")
CHOICES = {
    "method": METHODS,
    "scenarios": SCENARIOS,
    "percept": PERCEPTS,
    "networks": NETWORKS,
}
LATER = {
    "scenarios": "perimeter",
    "percept": "box",
    "networks": "percept",
    "islands": 1,
    "migration": 5,
}
"""Settings that a run may lack, because it was begun before they were, and what they then are."""


def option(default: Any, text: str, fixed: str = "") -> Any:
    """A field with its default and the help text of its command line option.

    Args:
        default: of the option.
        text: its help.
        fixed: why it cannot change once a run has begun; nothing if it can.
    """
    return field(default=default, metadata={"help": text, "fixed": fixed})


@dataclass(frozen=True)
class RunSettings:
    """What decides the result of a run, and is stored in it.

    Once a run has begun, some can be taken over by name (`cgtorch.experiments.takeover`).

    Raises:
        SettingsError: a value that cannot work.
    """

    seed: int = option(0, "Seed of everything random.", "all that is there was drawn from it")
    method: str = option(
        "compose",
        "How a skill is improved: compose, or paper as published.",
        "neither method goes on with what the other has made",
    )
    population: int = option(400, "Individuals in a population.")
    islands: int = option(1, "Populations that evolve apart and exchange their best.")
    migration: int = option(5, "Generations between two such exchanges.")
    generations: int = option(150, "Most generations of one evolution.")
    attempts: int = option(24, "Most evolutions in one stage.")
    tournament: int = option(5, "Individuals in a tournament, by which --method paper selects.")
    max_transitions: int = option(20, "Transitions after which a skill has failed.")
    practice: int = option(150, "Random placements practised in each stage beside the five tests.")
    transitions: int = option(
        2000,
        "Random transitions collected for the transition model.",
        "the first models were learned from them",
    )
    labels: int = option(
        5500,
        "Grasp labels collected for the success classifier.",
        "the first models were learned from them",
    )
    position_noise: float = option(
        0.005, "Noise of odometry and detection, m.", "W was solved under it"
    )
    heading_noise: float = option(
        math.pi / 360, "Noise of the heading after a motion, rad.", "W was solved under it"
    )
    scenarios: str = option(
        "perimeter",
        "With --stage auto: perimeter of the paper's table, general for any table from any side, "
        "general-clutter with boxes in the way.",
        "W and M are such scenarios",
    )
    percept: str = option(
        "auto",
        "What is seen: box as in the paper, yaw for the table's yaw too, auto for yaw with general "
        "scenarios only.",
        "the data and models that are there have it",
    )
    networks: str = option(
        "auto",
        "What networks read: percept as in the paper, edge for the scene as seen from the edge "
        "nearest to the object, auto for edge unless the method is paper.",
        "the graphs that are there are made of them",
    )
    actions: tuple[str, ...] = option(
        (),
        "Further actions: names or package.module:Class.",
        "the graphs that are there are made of them",
    )

    def __post_init__(self) -> None:
        """Check every value."""
        least = {"seed": 0, "population": 2, "practice": 0, "transitions": 50, "labels": 60}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(f.default, int) and (
                type(value) is not int or not least.get(f.name, 1) <= value < 2**31
            ):
                raise SettingsError(
                    f"{f.name} is {value!r}; give a whole number of at least {least.get(f.name, 1)}"
                )
            if isinstance(f.default, float) and (
                type(value) not in (int, float) or not 0 <= value <= 10
            ):
                raise SettingsError(f"{f.name} is {value!r:.40}; give a number from 0 to 10")
        for name, choices in CHOICES.items():
            if (value := getattr(self, name)) not in choices:
                raise SettingsError(f"{name} is {value!r}; use one of {', '.join(choices)}")
        if not isinstance(self.actions, tuple) or not all(isinstance(a, str) for a in self.actions):
            raise SettingsError(f"actions are {self.actions!r}; give names in a tuple")

    def to_dict(self) -> dict[str, Any]:
        """As plain data for a file."""
        return {**asdict(self), "actions": list(self.actions)}


def settings_from_dict(data: Any) -> RunSettings:
    """Settings from what `RunSettings.to_dict` gave.

    Raises:
        SettingsError: a setting is unknown, missing or impossible.
    """
    names = {f.name for f in fields(RunSettings)}
    if isinstance(data, dict):
        data = LATER | data
    if not isinstance(data, dict) or set(data) != names:
        odd = sorted(names ^ set(data))[0] if isinstance(data, dict) else repr(data)[:40]
        raise SettingsError(f"setting {odd!r} is unknown or missing; is this run of this version?")
    if not isinstance(data["actions"], list):
        raise SettingsError(f"actions are {data['actions']!r:.40}; give a list of names")
    return RunSettings(**{**data, "actions": tuple(data["actions"])})
