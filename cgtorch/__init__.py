"""cgtorch: evolving robot skills as computational graphs in PyTorch.

The most common names can be imported from here, as in `from cgtorch import Action, evolve`. All
other names are in their own packages.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from cgtorch.domains.data_files import read_data as read_data
    from cgtorch.domains.data_files import write_data as write_data
    from cgtorch.domains.domain import Domain as Domain
    from cgtorch.domains.files import Files as Files
    from cgtorch.domains.models import Models as Models
    from cgtorch.domains.pictures import Pictures as Pictures
    from cgtorch.domains.rewarded_models import RewardedModels as RewardedModels
    from cgtorch.domains.robot import ProtectiveStop as ProtectiveStop
    from cgtorch.domains.robot import RobotDriver as RobotDriver
    from cgtorch.domains.settings import DomainSettings as DomainSettings
    from cgtorch.domains.settings import option as option
    from cgtorch.domains.world import World as World
    from cgtorch.evolution import EvolutionSettings as EvolutionSettings
    from cgtorch.evolution import Search as Search
    from cgtorch.evolution import ask as ask
    from cgtorch.evolution import evolve as evolve
    from cgtorch.evolution import initial_state as initial_state
    from cgtorch.evolution import tell as tell
    from cgtorch.export.stepper import Request as Request
    from cgtorch.export.stepper import Stepper as Stepper
    from cgtorch.graphs import Action as Action
    from cgtorch.graphs import ActionSet as ActionSet
    from cgtorch.graphs import DelayNN as DelayNN
    from cgtorch.graphs import RecurrentNN as RecurrentNN
    from cgtorch.graphs import Skill as Skill
    from cgtorch.graphs import load_skill as load_skill
    from cgtorch.graphs import resolve_actions as resolve_actions
    from cgtorch.graphs import save_skill as save_skill
    from cgtorch.ground.environment import Environment as Environment
    from cgtorch.ground.environment import Lanes as Lanes
    from cgtorch.ground.environment import ScenarioBatch as ScenarioBatch
    from cgtorch.ground.fields import Field as Field
    from cgtorch.report import draw_skill as draw_skill
    from cgtorch.simulation.rollout import rollout as rollout
    from cgtorch.tabletop.actions import paper_actions as paper_actions
    from cgtorch.tabletop.edge_networks import edge_actions as edge_actions
    from cgtorch.tabletop.kinematics import graspable as graspable
    from cgtorch.tabletop.kinematics import load_robot as load_robot
    from cgtorch.tabletop.world import TabletopWorld as TabletopWorld
    from cgtorch.tabletop.world import random_scenarios as random_scenarios
    from cgtorch.tabletop.world import stage_scenarios as stage_scenarios
    from cgtorch.training.run import Run as Run
    from cgtorch.training.run import make as make
    from cgtorch.training.run import open_run as open_run
    from cgtorch.training.run import train as train

# Torch takes a second to import, so a name is imported on its first use.
_FOLDERS = {
    "domains.data_files": ("read_data", "write_data"),
    "domains.domain": ("Domain",),
    "domains.files": ("Files",),
    "domains.models": ("Models",),
    "domains.pictures": ("Pictures",),
    "domains.rewarded_models": ("RewardedModels",),
    "domains.robot": ("ProtectiveStop", "RobotDriver"),
    "domains.settings": ("DomainSettings", "option"),
    "domains.world": ("World",),
    "evolution": ("EvolutionSettings", "Search", "ask", "evolve", "initial_state", "tell"),
    "graphs": (
        "Action",
        "ActionSet",
        "DelayNN",
        "RecurrentNN",
        "Skill",
        "load_skill",
        "resolve_actions",
        "save_skill",
    ),
    "ground.environment": ("Environment", "Lanes", "ScenarioBatch"),
    "ground.fields": ("Field",),
    "report": ("draw_skill",),
    "simulation": ("rollout",),
    "export.stepper": ("Request", "Stepper"),
    "tabletop.actions": ("paper_actions",),
    "tabletop.edge_networks": ("edge_actions",),
    "tabletop.kinematics": ("graspable", "load_robot"),
    "tabletop.world": ("TabletopWorld", "random_scenarios", "stage_scenarios"),
    "training.run": ("Run", "make", "open_run", "train"),
}
_HOME = {name: folder for folder, names in _FOLDERS.items() for name in names}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    """One of the names above, imported from its package on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """All public names."""
    return sorted({*globals(), *_HOME})
