"""Numbers of a URDF that are in another unit, or that an exporter has left out."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.fitted import MeshFit
from cgtorch.tabletop.kinematics.urdf import Urdf
from cgtorch.tabletop.robot_folder.chains import FEW_JOINTS
from cgtorch.tabletop.robot_folder.structure import Structure

FAR = 50.0  # m: no robot reaches as far, but one in millimetres does
TURNS, ENDLESS = 4 * math.pi, 3600.0
"""Between these, rad, no joint has its limits, but one in degrees does; beyond, none is meant."""
SEVERAL = 2  # joints with such limits
LISTED = 4  # names that a message tells


def check_units(urdf: Urdf) -> tuple[str, ...]:
    """A note on limits that look like degrees.

    RobotError for links so far from the base that they are in millimetres, or if most joints have
    both limits at 0, as the exporter of SolidWorks writes them.
    """
    where = f"URDF {str(urdf.path)!r}"
    structure = Structure(urdf, urdf.model.base_link)
    away = {name: float(np.linalg.norm(structure.pose(name)[:3, 3])) for name in structure.below}
    farthest = max(away, key=lambda name: away[name])
    if away[farthest] > FAR:
        raise RobotError(
            f"{where}: link {farthest!r} is {away[farthest]:.0f} m away from "
            f"{structure.base!r}, which looks like millimetres: give all lengths in m, and meshes "
            'scale="0.001 0.001 0.001"'
        )
    limited = [each for each in urdf.model.robot.joints if _limited(each)]
    still = [each.name for each in limited if not (each.limit.lower or each.limit.upper)]
    if len(still) >= FEW_JOINTS and 2 * len(still) > len(limited):
        raise RobotError(
            f"{where}: {listed(still)} have both limits at 0, as the exporter of SolidWorks writes "
            "them, so that they cannot move: give each its lower and upper limit, in rad or m"
        )
    return _degrees(limited)


def far_meshes(meshes: Sequence[MeshFit]) -> tuple[str, ...]:
    """A note on meshes so large that they are in millimetres."""
    sizes = {each.link: _size(each) for each in meshes}
    large = [link for link, size in sizes.items() if size > FAR]
    if not large:
        return ()
    return (
        f"the meshes of {listed(large)} are up to {max(sizes.values()):.0f} m large, which looks "
        'like millimetres: if so, give them scale="0.001 0.001 0.001"',
    )


def listed(names: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(map(repr, names[:LISTED])) + more


def _limited(joint: Any) -> bool:
    return joint.type in ("revolute", "prismatic") and joint.mimic is None


def _degrees(limited: Sequence[Any]) -> tuple[str, ...]:
    ends = {each.name: _farther(each) for each in limited if each.type == "revolute"}
    wide = [name for name, end in ends.items() if TURNS < end <= ENDLESS]
    if len(wide) < SEVERAL:
        return ()
    most = max(ends[name] for name in wide)
    return (
        f"{listed(wide)} have limits of up to {most:g} rad, which look like degrees: if so, give "
        f"them in rad ({most:g} degrees are {math.radians(most):.4f} rad)",
    )


def _farther(joint: Any) -> float:
    return max(abs(float(joint.limit.lower)), abs(float(joint.limit.upper)))


def _size(mesh: MeshFit) -> float:
    """How long a mesh is at most along its axes, m."""
    if mesh.fit is None:
        return 0.0
    return float(np.ptp(mesh.fit.corners, axis=0).max())
