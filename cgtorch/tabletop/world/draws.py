"""Every kind of random scenarios by its name, as on the command line."""

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from torch import Generator

from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.world.general import cluttered_scenarios, general_scenarios
from cgtorch.tabletop.world.scenarios import PLACEMENTS, Scenarios, random_scenarios

Draw: TypeAlias = Callable[[int, Generator], Scenarios]
"""How many, and the generator of all random choices, to scenarios."""

DRAWS: dict[str, Draw] = {
    **{placement: partial(random_scenarios, placement) for placement in PLACEMENTS},
    "general": general_scenarios,
    "general-clutter": cluttered_scenarios,
}


def draw_of(name: str) -> Draw:
    """What draws the scenarios called `name`; SettingsError if nothing is called so."""
    if name not in DRAWS:
        raise SettingsError(f"unknown placement {name!r}; use one of {', '.join(DRAWS)}")
    return DRAWS[name]
