"""The ways to search that one can choose between."""

from collections.abc import Iterator
from functools import partial

from torch import Generator

from cgtorch.evolution import EvolutionSettings, Generation, evolve, lexicase, tournament
from cgtorch.graphs import ActionSet
from cgtorch.ground.environment import Environment
from searches.trial import Search


def search(
    settings: EvolutionSettings,
    environment: Environment,
    actions: ActionSet,
    generator: Generator,
) -> Iterator[Generation]:
    """Algorithm 2 with these settings."""
    return evolve(environment, actions, settings, generator)


SETTINGS = {
    "tournament": EvolutionSettings(selection=tournament()),
    "lexicase": EvolutionSettings(selection=lexicase),
    "islands": EvolutionSettings(population=100, islands=4),
}
VARIANTS: dict[str, Search] = {name: partial(search, each) for name, each in SETTINGS.items()}
"""By name; the others are compared with the first."""
