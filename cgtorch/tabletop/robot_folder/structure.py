"""A robot's rigid bodies, connected by joints, and points on their shapes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cgtorch.tabletop.kinematics.urdf import MOVING, Urdf

Array = NDArray[np.float64]

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
        return np.concatenate([np.empty((0, 3)), *self.shapes(link, pose)])

    def shapes(self, link: str, pose: Array | None = None) -> list[Array]:
        """Points (K, 3) on each collision shape of a link, in the base frame or a pose's."""
        pose = self.pose(link) if pose is None else pose
        if link in self.corners:
            return [each @ pose[:3, :3].T + pose[:3, 3] for each in self.corners[link]]
        return _placed(self.urdf.link(link).collisions, pose)

    def seen(self, links: Sequence[str], frame: str | None = None) -> Array:
        """(K, 3) points on links, or on what is seen of those without shapes.

        They are in the base frame or another one, in m.
        """
        every = list[Array]()
        for name in links:
            pose = np.asarray(self.urdf.model.get_transform(name, frame or self.base))
            every += self.shapes(name, pose) or _placed(self.urdf.link(name).visuals, pose)
        return np.concatenate([np.empty((0, 3)), *every])


def _placed(parts: Sequence[Any], pose: Array) -> list[Array]:
    """Points (K, 3) on collision or visual shapes of a link at a pose."""
    places = [pose if part.origin is None else pose @ part.origin for part in parts]
    return [
        _outline(part.geometry) @ at[:3, :3].T + at[:3, 3]
        for part, at in zip(parts, places, strict=True)
        if part.geometry.mesh is None
    ]


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
