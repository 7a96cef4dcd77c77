"""How MuJoCo draws where there is no display."""

import os
from ctypes.util import find_library


def draw_without_display() -> None:
    """Have MuJoCo draw by EGL, else by OSMesa, where there is no display and one is installed.

    Call it before anything of the tabletop is imported. MuJoCo heeds the variable when it is
    imported, and pytorch-kinematics imports it wherever it is installed.
    """
    if "DISPLAY" not in os.environ:
        for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
            if find_library(library):
                os.environ.setdefault("MUJOCO_GL", name)
