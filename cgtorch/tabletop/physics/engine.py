"""MuJoCo, an optional package that is imported only where it is needed."""

from importlib.util import find_spec
from typing import Any

from cgtorch.ground.errors import SettingsError


def mujoco() -> Any:
    """The module; SettingsError, with the way to install it, if it is missing."""
    if find_spec("mujoco") is None:
        raise SettingsError(
            "the world mujoco needs package 'mujoco'; pip install 'cgtorch[physics]', or use "
            "--world kinematic"
        )
    import mujoco as module

    return module
