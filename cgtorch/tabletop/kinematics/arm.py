"""One arm, ready for batched forward and inverse kinematics on any device."""

import math
from dataclasses import dataclass, field
from typing import Any

import pytorch_kinematics
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.collision import Capsules
from cgtorch.tabletop.kinematics.inverse_kinematics import (
    PAN_SAMPLES,
    SphericalArm,
    closed_form_candidates,
    closed_form_follow,
)
from cgtorch.tabletop.kinematics.numerical_ik import numerical_candidates, numerical_follow
from cgtorch.tabletop.kinematics.solids import Solids

_CHUNK = 16_384  # rows of forward kinematics at a time: more fall out of the processor's cache


@dataclass(frozen=True)
class ChainTable:
    """The frames of a chain in order, each in the one before, as compiled code reads them.

    Attributes:
        offset: (F, 3, 4) upper rows of poses before a joint moves; the first in the base frame.
        axis: (F, 3) of each frame's joint.
        kind: (F,) long, 0 where a frame's joint is fixed, 1 where it turns, 2 where it slides.
        joint: (F,) long, which of the joints that move it is, or -1.
    """

    offset: Tensor
    axis: Tensor
    kind: Tensor
    joint: Tensor


@dataclass(frozen=True)
class ArmModel:
    """One arm, ready for batched forward and inverse kinematics.

    Attributes:
        joint_names: The n joints that move, from base to tool.
        lower, upper: (n,) limits, the soft ones where the URDF has them; rad or m.
        continuous: (n,) whether a joint turns without end.
        mount: (4, 4) pose of the arm's base link in the robot's base frame.
        reach: How far from its base link's origin the tool frame's can be at most, m.
        capsules: What collides, roughly: those of `solids` that are cylinders end as balls.
        solids: What collides, as the URDF has it.
        closed_form: What the closed form of inverse kinematics needs, or None for arms without.
    """

    name: str
    joint_names: tuple[str, ...]
    lower: Tensor
    upper: Tensor
    continuous: Tensor
    mount: Tensor
    reach: float
    capsules: Capsules
    solids: Solids
    closed_form: SphericalArm | None
    _xml: bytes
    _links: tuple[str, str]
    _chains: dict[tuple[torch.dtype, torch.device], tuple[Any, ChainTable]] = field(
        default_factory=dict, repr=False
    )

    def chain(self, like: Tensor) -> tuple[Any, ChainTable]:
        """The chain in `pytorch_kinematics` and its table, made once for each device and dtype."""
        key = (like.dtype, like.device)
        if key not in self._chains:
            base, tip = self._links
            chain = pytorch_kinematics.build_serial_chain_from_urdf(self._xml, tip, base)
            chain = chain.to(dtype=like.dtype, device=like.device)
            self._chains[key] = chain, _chain_table(chain, self.mount.to(like))
        return self._chains[key]

    def frames(self, q: Tensor) -> Tensor:
        """Poses (F, B, 4, 4) in the base frame at q (B, n), rad or m; the tool frame is last."""
        chain, _ = self.chain(q)
        parts = [chain.forward_kinematics_tensor(part) for part in q.split(_CHUNK)]
        frames = parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
        return self.mount.to(q) @ frames

    def candidates(self, pose: Tensor, samples: int = PAN_SAMPLES) -> tuple[Tensor, Tensor]:
        """Rows (M,), ascending, and for each joint positions (M, n) within limits that solve it.

        They bring the tool frame to the row's pose (B, 4, 4) in the robot's base frame. The closed
        form tries so many `samples` of the pan angle.
        """
        local = torch.linalg.inv(self.mount.to(pose)) @ pose
        if self.closed_form is not None:
            return closed_form_candidates(self.closed_form.to(pose), local, samples)
        return numerical_candidates(*self._search(pose), local)

    def follow(self, q: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Joint positions (M, W, n) at waypoints, in the posture of a solution q (M, n).

        And whether each waypoint was reached (M, W); where not, its positions mean nothing. The
        waypoints (M, W, 4, 4) are poses of the tool frame in the robot's base frame.
        """
        local = torch.linalg.inv(self.mount.to(pose)) @ pose
        if self.closed_form is not None:
            return closed_form_follow(self.closed_form.to(pose), q, local)
        return numerical_follow(*self._search(pose), q, local)

    def difference(self, a: Tensor, b: Tensor) -> Tensor:
        """(..., n): how far each joint is from b to a, the short way round if it is continuous."""
        away = a - b
        short = away - math.tau * (away / math.tau).round()
        return torch.where(self.continuous.to(away.device), short, away)

    def _search(self, like: Tensor) -> tuple[Any, Tensor, Tensor]:
        """The chain and limits (n,) to search in, of continuous joints one turn about zero."""
        lower = torch.where(self.continuous, -math.pi, self.lower)
        upper = torch.where(self.continuous, math.pi, self.upper)
        return self.chain(like)[0], lower.to(like), upper.to(like)


def _chain_table(chain: Any, mount: Tensor) -> ChainTable:
    """The table of a `pytorch_kinematics.SerialChain` whose base is mounted at a pose (4, 4)."""
    link, joint = (
        torch.stack([torch.eye(4).to(mount) if pose is None else pose.view(4, 4) for pose in poses])
        for poses in (chain.link_offsets, chain.joint_offsets)
    )
    offset = link @ joint
    offset[0] = mount @ offset[0]
    kind, joint = chain.joint_type_indices, chain.joint_indices
    axis = chain.axes[joint.clamp_min(0)] * (kind > 0)[:, None]
    return ChainTable(offset[:, :3].contiguous(), axis, kind, joint)
