"""Other libraries on the standard tasks, each with the settings of its own examples."""

from dataclasses import dataclass

from standard.components import COMPONENTS

NEEDS_MEMORY = frozenset(
    {
        "cartpole_no_velocities",
        "narrow_cartpole_no_velocities",
        "acrobot_no_velocities",
        "pendulum_no_velocity",
        "double_pole_no_velocities",
        "repeat_first",
        "repeat_previous",
    }
)
"""Tasks for which the networks are recurrent, in libraries that have such."""


class UnsuitableError(Exception):
    """A library cannot be tried on a task, for the reason that it says."""


@dataclass(frozen=True)
class Library:
    """A library that is measured.

    Attributes:
        package: what has to be there to be imported.
        distribution: as which it is installed.
        module: with the function `search(trial)`.
        others: distributions whose versions matter, too.
    """

    package: str
    distribution: str
    module: str
    others: tuple[str, ...] = ()


LIBRARIES: dict[str, Library] = {
    "cgtorch": Library("cgtorch", "cgtorch", "standard.ours", ("torch",)),
    "cgtorch-models": Library("cgtorch", "cgtorch", "standard.models", ("torch",)),
    "evosax": Library("evosax", "evosax", "standard.peers.evosax_cma", ("jax",)),
    "neat-python": Library("neat", "neat-python", "standard.peers.neat_python"),
    "EvoTorch": Library("evotorch", "evotorch", "standard.peers.evotorch_pgpe", ("torch",)),
    "TensorNEAT": Library("tensorneat", "tensorneat", "standard.peers.tensorneat_neat", ("jax",)),
    "pytpg": Library("pytpg", "pytpg", "standard.peers.pytpg_graphs"),
}
"""By the names that they go by, in the order of the table."""

VARIANTS: dict[str, Library] = {
    name: Library("cgtorch", "cgtorch", "standard.components", ("torch",)) for name in COMPONENTS
}
"""This library with one part of its search changed, measured only if asked for."""
