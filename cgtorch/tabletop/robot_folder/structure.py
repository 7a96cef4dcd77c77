"""The structure of a robot: rigid bodies connected by joints, and the chains that end in hands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf

Array = NDArray[np.float64]

LEAST_JOINTS = 5  # of a chain from the base to a hand
ON_FLOOR = 0.05  # m: links within this distance of the lowest point stand on the floor
_AROUND = 16  # points on a circle


@dataclass(frozen=True)
class Structure:
    """The tree of a URDF's joints, at fixed positions.

    Attributes:
        urdf: The URDF, without meshes.
        base: The base link.
        corners: The corners (K, 3) of the meshes of links that only have collision meshes, in m and
            their frames; these are more exact than the shapes around them.
    """

    urdf: Urdf
    base: str
    corners: Mapping[str, Sequence[Array]] = field(default_factory=dict)

    @cached_property
    def above(self) -> dict[str, Any]:
        """The joint that carries each link except the root."""
        return {joint.child: joint for joint in self.urdf.model.robot.joints}

    @cached_property
    def below(self) -> dict[str, list[Any]]:
        """The joints that each link carries."""
        found: dict[str, list[Any]] = {link.name: [] for link in self.urdf.model.robot.links}
        for joint in self.urdf.model.robot.joints:
            found[joint.parent].append(joint)
        return found

    def rigid(self, link: str) -> list[str]:
        """A link and all links that are fixed to it below."""
        fixed = (j.child for j in self.below[link] if j.type not in MOVING)
        return [link, *(name for child in fixed for name in self.rigid(child))]

    def moved(self, link: str) -> list[Any]:
        """The moving joints of the rigid body that begins at a link."""
        return [j for name in self.rigid(link) for j in self.below[name] if j.type in MOVING]

    def hanging(self, link: str) -> list[str]:
        """A link and all links below it."""
        return [link, *(n for joint in self.below[link] for n in self.hanging(joint.child))]

    def path(self, link: str) -> list[Any]:
        """The independent joints that move a link, from the base on."""
        joints = self.urdf.joints_above(link, self.base)[::-1]
        return [joint for joint in joints if joint.type in MOVING and joint.mimic is None]

    def pose(self, link: str) -> Array:
        """(4, 4) in the base frame."""
        return np.asarray(self.urdf.model.get_transform(link, self.base), dtype=np.float64)

    def points(self, link: str, frame: str | None = None) -> Array:
        """(K, 3) points on the shapes of a link, m, in the base frame or another."""
        pose = np.asarray(self.urdf.model.get_transform(link, frame or self.base))
        return np.concatenate([np.zeros((0, 3)), *self.shapes(link, pose)])

    def shapes(self, link: str, pose: Array | None = None) -> list[Array]:
        """Points (K, 3) on each collision shape of a link, in the base frame or a pose's."""
        pose = self.pose(link) if pose is None else pose
        if link in self.corners:
            return [each @ pose[:3, :3].T + pose[:3, 3] for each in self.corners[link]]
        placed = []
        for collision in self.urdf.link(link).collisions:
            at = pose if collision.origin is None else pose @ collision.origin
            placed.append(_outline(collision.geometry) @ at[:3, :3].T + at[:3, 3])
        return placed

    def hands(self) -> list[str]:
        """The links that begin the rigid bodies at the ends of arms.

        Such a body carries several fingers or nothing, hangs from the base by a chain of five
        joints or more, and not from another such body. Legs are excluded: they reach the floor
        where the base does not.
        """
        found: list[str] = []
        floor = ON_FLOOR + self._lowest(self.hanging(self.base))
        walks = self._lowest(self.rigid(self.base)) > floor

        def look(link: str) -> None:
            moved = self.moved(link)
            if len(self.path(link)) >= LEAST_JOINTS and len(moved) != 1:
                if not (walks and self._lowest(self.hanging(link)) <= floor):
                    found.append(link)
                return
            for joint in moved:
                look(joint.child)

        look(self.base)
        return found

    def _lowest(self, links: list[str]) -> float:
        """The height of the lowest point of links, m."""
        return min((self.points(n)[:, 2].min(initial=math.inf) for n in links), default=math.inf)


def _outline(geometry: Any) -> Array:
    """Points whose convex hull is (nearly) a URDF's box, cylinder or sphere."""
    if geometry.box is not None:
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
        return signs * np.asarray(geometry.box.size, dtype=np.float64)
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(_AROUND)], axis=1)
    if geometry.cylinder is not None:
        end = np.array([0, 0, geometry.cylinder.length / 2])
        ring = circle * geometry.cylinder.radius
        return np.concatenate([ring - end, ring + end])
    rings = [circle[:, order] for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0])]
    return geometry.sphere.radius * np.concatenate(rings)
