"""Domains: the task of a run, and Γ and C learned for any domain.

Your own domain is a subclass of `Domain` with a `World` and scenarios (`ScenarioBatch`); see
docs/own-domain.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cgtorch.domains.data_files import read_data as read_data
    from cgtorch.domains.data_files import write_data as write_data
    from cgtorch.domains.domain import Domain as Domain
    from cgtorch.domains.domain import Specialists as Specialists
    from cgtorch.domains.files import Files as Files
    from cgtorch.domains.knowledge import Knowledge as Knowledge
    from cgtorch.domains.models import Models as Models
    from cgtorch.domains.pictures import Pictures as Pictures
    from cgtorch.domains.robot import ProtectiveStop as ProtectiveStop
    from cgtorch.domains.robot import RobotDriver as RobotDriver
    from cgtorch.domains.settings import DomainSettings as DomainSettings
    from cgtorch.domains.settings import option as option
    from cgtorch.domains.world import World as World
    from cgtorch.ground.environment import ScenarioBatch as ScenarioBatch
    from cgtorch.ground.fields import Field as Field
    from cgtorch.ground.fields import named as named

# Settings are asked for by commands that do not wait for torch, so all else is looked up late.
_HOME = {
    "Domain": "cgtorch.domains.domain",
    "DomainSettings": "cgtorch.domains.settings",
    "Field": "cgtorch.ground.fields",
    "Files": "cgtorch.domains.files",
    "Knowledge": "cgtorch.domains.knowledge",
    "Models": "cgtorch.domains.models",
    "Pictures": "cgtorch.domains.pictures",
    "ProtectiveStop": "cgtorch.domains.robot",
    "RobotDriver": "cgtorch.domains.robot",
    "ScenarioBatch": "cgtorch.ground.environment",
    "Specialists": "cgtorch.domains.domain",
    "World": "cgtorch.domains.world",
    "named": "cgtorch.ground.fields",
    "option": "cgtorch.domains.settings",
    "read_data": "cgtorch.domains.data_files",
    "write_data": "cgtorch.domains.data_files",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    """One of the names above, from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
