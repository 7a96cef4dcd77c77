"""Inverse kinematics in closed form for arms with a spherical wrist.

It fits every arm whose seven joints turn about z, y, x, y, x, y, x (pan, lift, roll, elbow flex,
forearm roll, wrist flex, wrist roll), with the upper arm and the forearm along x: the PR2, the
Fetch and similar ones. The arm has one joint more than a pose needs. Given the pan angle, the other
six follow exactly, in a few branches (elbow up or down, shoulder rolled or not, wrist flipped or
not), of which the joint limits leave two on the PR2. So the pan angle is searched on a grid, and
everything else is algebra.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cgtorch.tabletop.kinematics.collision import Tensors

PAN_SAMPLES = 48
_AXES = (2, 1, 0, 1, 0, 1, 0)
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class SphericalArm(Tensors):
    """The lengths and limits of an arm with a closed form; angles about positive axes.

    Attributes:
        base: (4, 4) pose of the pan joint in the arm's base link.
        shoulder: (3,) the lift axis in the turned pan frame, m.
        upper_arm: From the lift axis to the elbow axis, m.
        forearm: From the elbow axis to the wrist's centre, m.
        tool: (4, 4) pose of the tool frame in the wrist's last frame, whose origin is the wrist's
            centre.
        signs: (7,) 1 or -1, the direction in which each joint turns.
        lower, upper: (7,) limits, rad.
        branches: (S, 3) signs of the sine of the elbow, the cosine of the shoulder roll and the
            sine of the wrist flex that the limits allow.
        elbow_cosines: The least and the greatest cosine of the elbow that the limits allow.
    """

    base: Tensor
    shoulder: Tensor
    upper_arm: float
    forearm: float
    tool: Tensor
    signs: Tensor
    lower: Tensor
    upper: Tensor
    branches: Tensor
    elbow_cosines: tuple[float, float]


def spherical_arm(joints: tuple[Any, ...], limits: Tensor) -> SphericalArm | None:
    """The parameters of the closed form for a chain of URDF joints, or None for other chains.

    The `yourdfpy` joints lead from the arm's base link to its tool frame. Moving joints have limits
    (n, 2), rad; those of a continuous joint are at least a full turn apart.
    """
    unmoved = torch.eye(4, dtype=torch.float64)
    offsets = [unmoved]
    signs: list[float] = []
    for joint in joints:
        if joint.origin is not None:
            offsets[-1] = offsets[-1] @ torch.as_tensor(joint.origin, dtype=torch.float64)
        if joint.type == "fixed":
            continue
        axis = torch.as_tensor(joint.axis, dtype=torch.float64)
        if joint.type == "prismatic" or len(signs) == len(_AXES):
            return None
        sign = float(axis[_AXES[len(signs)]])
        if abs(abs(sign) - 1) > _TOLERANCE:
            return None
        signs.append(math.copysign(1.0, sign))
        offsets.append(unmoved)
    if len(signs) != len(_AXES):
        return None
    base, shoulder, *middle, tool = offsets
    straight = [pose[:3, 3] for pose in middle]
    turned = any(
        (pose[:3, :3] - torch.eye(3)).abs().max() > _TOLERANCE for pose in [shoulder, *middle]
    )
    if turned or any(shift[1:].abs().max() > _TOLERANCE for shift in straight):
        return None
    upper_arm, forearm = (float(straight[i][0] + straight[i + 1][0]) for i in (0, 2))
    if upper_arm <= 0 or forearm <= 0:
        return None
    to_wrist = unmoved.clone()
    to_wrist[:3, 3] = straight[4]
    turns = torch.tensor(signs, dtype=torch.float64)
    ends = (limits.double() * turns[:, None]).sort(dim=1).values
    least, most = _cosines(*ends[3].tolist())
    return SphericalArm(
        base=base,
        shoulder=shoulder[:3, 3],
        upper_arm=upper_arm,
        forearm=forearm,
        tool=to_wrist @ tool,
        signs=turns,
        lower=ends[:, 0],
        upper=ends[:, 1],
        branches=_branches([(float(a), float(b)) for a, b in ends]),
        elbow_cosines=(least - _TOLERANCE, most + _TOLERANCE),
    )


def _cosines(lower: float, upper: float) -> tuple[float, float]:
    """The least and the greatest cosine of an angle within limits."""
    ends = math.cos(lower), math.cos(upper)
    peak = math.floor(upper / math.tau) * math.tau >= lower
    trough = math.floor(upper / math.tau - 0.5) * math.tau + math.pi >= lower
    return -1.0 if trough else min(ends), 1.0 if peak else max(ends)


def _branches(limits: list[tuple[float, float]]) -> Tensor:
    """The combinations of signs that some angle within the limits has."""

    def signs(lower: float, upper: float) -> list[float]:
        least, most = _cosines(lower, upper)
        return [sign for sign, size in ((1.0, most), (-1.0, -least)) if size > 1e-9]

    elbow, wrist = (signs(*(end - math.pi / 2 for end in limits[i])) for i in (3, 5))  # of sines
    return torch.tensor(
        list(itertools.product(elbow, signs(*limits[2]), wrist)), dtype=torch.float64
    )


def pan_grid(arm: SphericalArm, samples: int) -> Tensor:
    """(samples,) pan angles over the joint's range, at most one turn of it, rad."""
    lower, upper = float(arm.lower[0]), float(arm.upper[0])
    if upper - lower > math.tau:
        middle = (lower + upper) / 2
        lower, upper = middle - math.pi, middle + math.pi - math.tau / samples
    return torch.linspace(lower, upper, samples, dtype=arm.lower.dtype, device=arm.lower.device)


def closed_form_candidates(arm: SphericalArm, pose: Tensor, samples: int) -> tuple[Tensor, Tensor]:
    """Like `ArmModel.candidates`, for poses (B, 4, 4) of the tool frame in the arm's base link."""
    wrist, rotation = _wrist(arm, pose)
    pan = pan_grid(arm, samples)
    elbow = _cos_elbow(arm, *_from_shoulder(arm, wrist[:, None], pan))
    least, most = arm.elbow_cosines
    row, sample = ((elbow >= least) & (elbow <= most)).nonzero(as_tuple=True)
    q, sound = _solve(arm, arm.branches, wrist[row], rotation[row], pan[sample])
    which, branch = sound.nonzero(as_tuple=True)
    return row[which], q[which, branch]


def closed_form_follow(arm: SphericalArm, q: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
    """Like `ArmModel.follow`, in the branch and at the pan angle of q, in the arm's base link."""
    angle = q * arm.signs
    signs = torch.stack([angle[:, 3].sin(), angle[:, 2].cos(), angle[:, 5].sin()], dim=-1)
    branch = (signs[:, None] * arm.branches > 0).sum(-1).argmax(dim=1)
    wrist, rotation = _wrist(arm, pose)
    pan = angle[:, :1].expand(pose.shape[:2])
    path, sound = _solve(arm, arm.branches[branch][:, None, None], wrist, rotation, pan)
    return path.squeeze(2), sound.squeeze(2)


def _wrist(arm: SphericalArm, pose: Tensor) -> tuple[Tensor, Tensor]:
    """Position (..., 3) and rotation (..., 3, 3) of the wrist's last frame in the pan frame."""
    last = torch.linalg.inv(arm.base) @ pose @ torch.linalg.inv(arm.tool)
    return last[..., :3, 3], last[..., :3, :3]


def _from_shoulder(arm: SphericalArm, wrist: Tensor, pan: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The wrist's centre seen from the lift axis, in the turned pan frame."""
    cos, sin = pan.cos(), pan.sin()
    x = cos * wrist[..., 0] + sin * wrist[..., 1] - arm.shoulder[0]
    y = cos * wrist[..., 1] - sin * wrist[..., 0] - arm.shoulder[1]
    return x, y, (wrist[..., 2] - arm.shoulder[2]).expand_as(x)


def _cos_elbow(arm: SphericalArm, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """The law of cosines in the triangle of shoulder, elbow and wrist."""
    a, b = arm.upper_arm, arm.forearm
    return (x * x + y * y + z * z - (a * a + b * b)) / (2 * a * b)


def _solve(
    arm: SphericalArm, branches: Tensor, wrist: Tensor, rotation: Tensor, pan: Tensor
) -> tuple[Tensor, Tensor]:
    """Joint angles (..., S, 7) at pan angles (...) in branches (..., S, 3), and which are valid.

    The wrist's centre (..., 3) and the rotation (..., 3, 3) of its last frame are in the pan frame.
    """
    elbow_sign, roll_sign, wrist_sign = branches.unbind(-1)
    x, y, z = (value[..., None] for value in _from_shoulder(arm, wrist, pan))
    cos1, sin1 = pan.cos()[..., None], pan.sin()[..., None]

    # Elbow: the triangle's third side. With the elbow bent the forearm leaves the upper arm's
    # line by (along, drop); the shoulder's roll and lift then turn that onto the wrist.
    cos4 = _cos_elbow(arm, x, y, z)
    sound = cos4.abs() <= 1
    cos4 = cos4.clamp(-1, 1)
    sin4 = elbow_sign * (1 - cos4 * cos4).sqrt()
    along = arm.upper_arm + arm.forearm * cos4
    drop = -arm.forearm * sin4

    # Roll: it alone gives the sideways part y. Lift: the turn left over in the x-z plane.
    sin3 = -y / drop
    sound = sound & (sin3.abs() <= 1)
    sin3 = sin3.clamp(-1, 1)
    cos3 = roll_sign * (1 - sin3 * sin3).sqrt()
    down = cos3 * drop
    cos2, sin2 = along * x + down * z, down * x - along * z
    length = (cos2 * cos2 + sin2 * sin2).sqrt()
    sound = sound & (length > 0)
    cos2, sin2 = cos2 / length, sin2 / length

    # Wrist: what rotation is left, as forearm roll (x), flex (y) and wrist roll (x). Its first
    # column is the tool's direction seen from the forearm and gives the first two. Undone, they
    # leave a second column that gives the last. So the three fit one another even where the wrist
    # is straight, and only the sum of the rolls is determined.
    turns = (cos1, sin1), (cos2, sin2), (cos3, sin3), (cos4, sin4)
    dx, dy, dz = _seen_from_forearm(rotation[..., :, 0], *turns)
    ex, ey, ez = _seen_from_forearm(rotation[..., :, 1], *turns)
    away = (dy * dy + dz * dz).sqrt()
    straight = away < 1e-9
    cos5 = torch.where(straight, 1.0, -wrist_sign * dz / away)
    sin5 = torch.where(straight, 0.0, wrist_sign * dy / away)
    sin6 = wrist_sign * away
    ey, ez = _turned(cos5, -sin5, ey, ez)
    sin7 = sin6 * ex + dx * ez

    angles = [
        pan[..., None].expand_as(sin6),
        torch.atan2(sin2, cos2),
        torch.atan2(sin3, cos3),
        torch.atan2(sin4, cos4),
        torch.atan2(sin5, cos5),
        torch.atan2(sin6, dx),
        torch.atan2(sin7, ey),
    ]
    q = torch.stack([angle.expand_as(sin6) for angle in angles], dim=-1)
    middle = (arm.lower + arm.upper) / 2
    q = q + math.tau * ((middle - q) / math.tau).round()
    within = (q >= arm.lower - _TOLERANCE) & (q <= arm.upper + _TOLERANCE)
    return q * arm.signs, sound & within.all(dim=-1)


def _seen_from_forearm(column: Tensor, *turns: tuple[Tensor, Tensor]) -> tuple[Tensor, ...]:
    """The parts of a direction (..., 3) in the pan frame, in the forearm's.

    The turns are cosine and sine of the pan, the lift, the shoulder's roll and the elbow.
    """
    (cos1, sin1), (cos2, sin2), (cos3, sin3), (cos4, sin4) = turns
    x, y, z = (column[..., i, None] for i in range(3))
    x, y = _turned(cos1, -sin1, x, y)
    x, z = _turned(cos2, sin2, x, z)
    y, z = _turned(cos3, -sin3, y, z)
    x, z = _turned(cos4, sin4, x, z)
    return x, y, z


def _turned(cos: Tensor, sin: Tensor, a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Two coordinates after a turn from the first to the second."""
    return cos * a - sin * b, sin * a + cos * b
