"""What a run perceives, what its networks make of that, and how specialists are then evolved."""

from collections.abc import Callable
from dataclasses import dataclass

from cgtorch.actions import ActionSet, edge_actions, paper_actions
from cgtorch.experiments.settings import RunSettings
from cgtorch.improvement.specialists import Grouping, broad_group, local_group


@dataclass(frozen=True)
class Networks:
    """Networks by what they read, and what a search for such specialists takes.

    Attributes:
        actions: the basic actions for percepts of a length.
        group_of: the missed scenarios that a specialist is evolved on.
        group: how many these are.
        stall: generations without a better fitness after which a search gives up.
    """

    actions: Callable[[int], ActionSet]
    group_of: Grouping
    group: int
    stall: int


NETWORKS = {
    "percept": Networks(paper_actions, local_group, group=12, stall=40),
    "edge": Networks(edge_actions, broad_group, group=16, stall=15),
}
"""Networks that read the percept itself can hold for scenarios near to one another only; those in
the edge's frame for many, if they are evolved on many kinds."""


def usual_percept(scenarios: str) -> str:
    """What runs about such scenarios perceive, in `cgtorch.world.PERCEPTS`, if not told else."""
    return "yaw" if scenarios.startswith("general") else "box"


def percept_of(settings: RunSettings) -> str:
    """What a run perceives, in `cgtorch.world.PERCEPTS`."""
    return usual_percept(settings.scenarios) if settings.percept == "auto" else settings.percept


def networks_of(settings: RunSettings) -> Networks:
    """The networks of a run."""
    if settings.networks != "auto":
        return NETWORKS[settings.networks]
    return NETWORKS["percept" if settings.method == "paper" else "edge"]
