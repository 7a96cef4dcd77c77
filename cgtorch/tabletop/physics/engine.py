"""MuJoCo, an optional package that is imported only where it is needed."""

import os
from ctypes.util import find_library
from importlib.util import find_spec
from typing import Any

from cgtorch.ground.errors import SettingsError


def draw_without_display() -> None:
    """Have MuJoCo draw by EGL where there is no display; it heeds this when it is imported."""
    if "DISPLAY" not in os.environ and find_library("EGL"):
        os.environ.setdefault("MUJOCO_GL", "egl")


def mujoco() -> Any:
    """The module; SettingsError, with the way to install it, if it is missing."""
    if find_spec("mujoco") is None:
        raise SettingsError(
            "the world mujoco needs package 'mujoco'; pip install 'cgtorch[physics]', or use "
            "--world kinematic"
        )
    import mujoco as module

    return module
