"""MuJoCo, which is imported where it is needed only: an extra of the package."""

from importlib.util import find_spec
from typing import Any

from cgtorch.ground.errors import SettingsError


def mujoco() -> Any:
    """The module; SettingsError, which says how to install it, if it is missing."""
    if find_spec("mujoco") is None:
        raise SettingsError(
            "the world mujoco needs package 'mujoco'; pip install 'cgtorch[physics]', or use "
            "--world kinematic"
        )
    import mujoco as module

    return module
