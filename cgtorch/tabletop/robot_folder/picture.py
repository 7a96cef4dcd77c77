"""A robot drawn from three sides with the shapes that it collides with, to be looked at."""

import io
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from cgtorch.tabletop.kinematics import Robot
from cgtorch.tabletop.robot_folder.structure import Structure

VIEWS = (("from the right", 0, 2), ("from the front", 1, 2), ("from above", 0, 1))
"""The views, and which of x, y and z go to the right and up."""
REST, BODY, ARMS = "#b0b7bf", "#4a5a6a", ("#d95f02", "#1b9e77", "#7570b3", "#e7298a")
AXIS = 0.12  # m: how long the axes of a tool frame are drawn


def robot_picture(robot: Robot, title: str = "") -> bytes:
    """A PNG of a robot at home, from three sides.

    Grey is what nothing is asked of, dark what an arm must not touch, coloured the arms; the dashed
    rectangle is the footprint, and arrows are the tool frames: x red, y green, z blue.
    """
    words, structure = robot.description, Structure(robot.urdf, robot.description.base_frame)
    at_home = {
        name: float(position)
        for arm, q in zip(robot.arms, robot.home, strict=True)
        for name, position in zip(arm.joint_names, q, strict=True)
    }
    robot.urdf.model.update_cfg(at_home)
    colours = dict.fromkeys(structure.hanging(structure.base), REST)
    colours.update(dict.fromkeys(words.body, BODY))
    for i, arm in enumerate(robot.arms):
        first = robot.urdf.joint(arm.joint_names[0]).child
        colours.update(dict.fromkeys(structure.hanging(first), ARMS[i % len(ARMS)]))
    figure = Figure(figsize=(15, 6), layout="constrained")
    for axes, (view, right, up) in zip(figure.subplots(1, 3), VIEWS, strict=True):
        for name, colour in colours.items():
            for points in structure.shapes(name):
                _fill(axes, points[:, [right, up]], colour)
        x0, x1, y0, y1 = words.footprint
        corners = np.array(
            [[x, y, 0] for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))]
        )
        axes.plot(corners[:, right], corners[:, up], "k--", linewidth=1)
        for tool in (arm.tool_frame for arm in words.arms):
            pose = structure.pose(tool)
            for axis, colour in enumerate(("red", "green", "blue")):
                line = np.stack([pose[:3, 3], pose[:3, 3] + AXIS * pose[:3, axis]])
                axes.plot(line[:, right], line[:, up], color=colour, linewidth=2)
        axes.set_aspect("equal")
        axes.grid(alpha=0.3)
        axes.set_title(view)
        axes.set_xlabel(f"{'xyz'[right]} [m]")
        axes.set_ylabel(f"{'xyz'[up]} [m]")
    figure.suptitle(title or words.name)
    robot.urdf.model.update_cfg(words.held)
    file = io.BytesIO()
    FigureCanvasAgg(figure).print_png(file)
    return file.getvalue()


def _fill(axes: Any, points: np.ndarray, colour: str) -> None:
    try:
        outline = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return
    axes.fill(*outline.T, facecolor=colour, edgecolor=colour, alpha=0.35, linewidth=1)
