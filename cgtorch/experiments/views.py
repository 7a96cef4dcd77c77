"""What a run perceives, and what its networks make of that, by the name that settings use."""

from collections.abc import Callable
from dataclasses import dataclass

from cgtorch.actions import ActionSet, edge_actions, paper_actions


@dataclass(frozen=True)
class View:
    """A percept of the tabletop and the actions that read it.

    Attributes:
        percept: a name in `cgtorch.world.PERCEPTS`.
        actions: the basic actions for percepts of a length.
    """

    percept: str
    actions: Callable[[int], ActionSet]


VIEWS = {
    "box": View("box", paper_actions),
    "yaw": View("yaw", paper_actions),
    "edge": View("yaw", edge_actions),
}
"""The paper's percept; the same with the table's yaw; this with networks in the edge's frame."""
