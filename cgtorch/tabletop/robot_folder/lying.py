"""Whether an arm lies on its side, as another axis than z is up in its URDF."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cgtorch.tabletop.robot_folder.structure import Structure

ALONG = 0.95  # cosine of the way to a joint to the axis along which an arm stands
LEAST = 0.02  # m of this way
TURNS = {"x": "0 -1.5708 0", "-x": "0 1.5708 0", "y": "1.5708 0 0", "-y": "-1.5708 0 0"}
"""How a link is turned, rpy in rad, so that an axis of it is up."""


def lying(structure: Structure, chains: Sequence[Sequence[Any]]) -> list[str]:
    """A note on a single arm that stands on its base along x or y, about which it turns."""
    if len(chains) != 1:
        return []
    first, second = (structure.pose(joint.child) for joint in chains[0][:2])
    axis = first[:3, :3] @ np.asarray(chains[0][0].axis, dtype=np.float64)
    for name, rpy in TURNS.items():
        up = np.array([name[-1] == each for each in "xyz"]) * (-1.0 if name[0] == "-" else 1.0)
        ways = first[:3, 3], second[:3, 3]
        stands = all(way @ up > max(LEAST, ALONG * float(np.linalg.norm(way))) for way in ways)
        if stands and abs(float(axis @ up)) > ALONG:
            return [
                f"{chains[0][0].name!r} turns about the {name} of {structure.base!r}, along which "
                f"the arm stands: if {name} is up in the URDF, add a root link above it by a fixed "
                f'joint with rpy="{rpy}"'
            ]
    return []
