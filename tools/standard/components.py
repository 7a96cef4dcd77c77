"""This library on the standard tasks with one part of its search changed or left out.

The value of a part is the difference to `standard.ours`, which has them all, over the same seeds.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from cgtorch.evolution import REWARDS, EvolutionSettings, lexicase
from cgtorch.evolution.population import random_graphs
from cgtorch.graphs import ActionSet
from standard.measure import Trial
from standard.ours import ACTIONS, searched

SETTINGS: Mapping[str, EvolutionSettings] = {
    "mutation alone": replace(REWARDS, lineages=0),
    "mutation of 400": replace(REWARDS, lineages=0, population=400),
    "one lineage": replace(REWARDS, lineages=1),
    "eight lineages": replace(REWARDS, lineages=8),
    "any first graphs": replace(REWARDS, first_graphs=random_graphs),
    "larger first graphs": replace(REWARDS, initial_nodes=(2, 6)),
    "lexicase": replace(REWARDS, selection=lexicase),
    "population of 24": replace(REWARDS, population=24),
    "population of 96": replace(REWARDS, population=96),
}
"""Other settings, by what differs."""

LEFT_OUT: Mapping[str, tuple[str, ...]] = {
    "no linear network": ("Linear",),
    "no delays": ("Delay",),
    "no recurrent network": ("Recur",),
    "no delays, no recurrent network": ("Delay", "Recur"),
}
"""Actions that are left out, by name."""

COMPONENTS = (*SETTINGS, *LEFT_OUT)
"""The names of these searches."""


def search(trial: Trial) -> None:
    """Search in the way of the trial's library, which is one of the `COMPONENTS`."""
    settings = SETTINGS.get(trial.library, REWARDS)
    searched(trial, settings, without(ACTIONS, LEFT_OUT.get(trial.library, ())))


def without(
    actions: Callable[[int, int], ActionSet], names: tuple[str, ...]
) -> Callable[[int, int], ActionSet]:
    """The same actions without those of these names."""

    def some(percept: int, control: int) -> ActionSet:
        every = actions(percept, control)
        pairs = zip(every.names, every.actions, strict=True)
        kept = [(name, action) for name, action in pairs if name not in names]
        return ActionSet(tuple(name for name, _ in kept), tuple(action for _, action in kept))

    return some
