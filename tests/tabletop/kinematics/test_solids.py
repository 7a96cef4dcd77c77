"""Solids: what shapes become, where they are, and what is around them."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.solids import (
    Solids,
    fixed_solids,
    solid_of,
    solid_of_capsule,
    solids_of,
    with_boxed_hand,
)

QUARTER = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # about z


def pose(*at: float, turn: list[list[float]] | None = None) -> Tensor:
    """(4, 4)."""
    made = torch.eye(4, dtype=torch.float64)
    made[:3, 3] = torch.tensor(at)
    if turn is not None:
        made[:3, :3] = torch.tensor(turn)
    return made


def size(*numbers: float) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def shape(origin: object = None, **kinds: object) -> Any:
    every = {"sphere": None, "cylinder": None, "box": None, **kinds}
    return SimpleNamespace(origin=origin, geometry=SimpleNamespace(**every))


@pytest.mark.parametrize(
    ("collision", "wanted"),
    [
        (shape(sphere=SimpleNamespace(radius=0.3)), [0, 0, 0, 0, 0.3]),
        (shape(cylinder=SimpleNamespace(radius=0.1, length=0.6)), [0, 0, 0.3, 0.1, 0]),
        (shape(cylinder=SimpleNamespace(radius=0.0, length=0.6)), [0, 0, 0.3, 0, 0]),
        (shape(box=SimpleNamespace(size=(0.2, 0.4, 0.6))), [0.1, 0.2, 0.3, 0, 0]),
    ],
)
def test_a_shape_is_a_sum_of_a_box_a_disc_and_a_ball(collision: Any, wanted: list[float]) -> None:
    at, found = solid_of(collision, "it")
    assert found.tolist() == pytest.approx(wanted)
    assert torch.equal(at, pose(0, 0, 0))
    collision.origin = pose(1, 2, 3, turn=QUARTER).numpy()
    assert torch.equal(solid_of(collision, "it")[0], pose(1, 2, 3, turn=QUARTER))


@pytest.mark.parametrize(
    "collision",
    [
        shape(sphere=SimpleNamespace(radius=-0.1)),
        shape(cylinder=SimpleNamespace(radius=0.1, length=-0.1)),
        shape(box=SimpleNamespace(size=(0.2, 0.0, 0.6))),
        shape(),
    ],
)
def test_what_has_no_size_is_named(collision: Any) -> None:
    with pytest.raises(RobotError, match=r"^link 'it' collides as a"):
        solid_of(collision, "link 'it'")


@pytest.mark.parametrize("end", [(0.4, 0.2, 0.3), (0.1, 0.2, -0.5), (0.4, -0.2, 0.8)])
def test_a_capsule_leads_from_one_end_to_the_other(end: tuple[float, ...]) -> None:
    ends = size(0.1, 0.2, 0.3), size(*end)
    at, found = solid_of_capsule(*ends, 0.05)
    assert found.tolist() == pytest.approx([0, 0, float((ends[1] - ends[0]).norm()) / 2, 0, 0.05])
    turn = at[:3, :3]
    torch.testing.assert_close(turn @ turn.T, torch.eye(3).double())
    assert float(turn.det()) == pytest.approx(1)
    points, radius = fixed_solids(at[None, :3], found[None]).capsules()
    torch.testing.assert_close(points, torch.stack(ends))
    assert radius.tolist() == pytest.approx([0.05] * 2)


def test_a_capsule_without_length_is_a_ball() -> None:
    at, found = solid_of_capsule(size(1, 2, 3), size(1, 2, 3), 0.05)
    assert torch.equal(at, pose(1, 2, 3))
    assert found.tolist() == [0, 0, 0, 0, 0.05]


def test_capsules_lie_along_the_longest_sides_and_hold_the_others() -> None:
    solids = fixed_solids(
        torch.stack([pose(1, 0, 0), pose(0, 1, 0, turn=QUARTER), pose(0, 0, 1)])[:, :3],
        torch.stack([size(0.1, 0.2, 0.3, 0, 0), size(0.5, 0.3, 0.4, 0, 0.1), size(0, 0, 1, 2, 0)]),
    )
    ends, radius = solids.capsules()
    wanted = [[1, 0, -0.3], [0, 0.5, 0], [0, 0, 0], [1, 0, 0.3], [0, 1.5, 0], [0, 0, 2]]
    torch.testing.assert_close(ends, torch.tensor(wanted).double())
    radii = [math.hypot(0.1, 0.2), math.hypot(0.3, 0.4) + 0.1, 2.0]
    assert radius.tolist() == pytest.approx(radii * 2)


def hand() -> Solids:
    """A cylinder and a ball that two joints move, and a box that one does."""
    rows = [
        (pose(0, 0, 0), size(1, 1, 1, 0, 0), 1, 1),
        (pose(1, 0, 0, turn=QUARTER), size(0.1, 0.2, 0.3, 0.05, 0), 2, 2),
        (pose(2, 1, 1), size(0, 0, 0, 0, 0.5), 3, 2),
    ]
    return solids_of(rows)


def test_a_hand_is_one_box_around_all_of_it() -> None:
    found = with_boxed_hand(hand(), 2)
    assert torch.equal(found.pose[0], hand().pose[0])
    assert found.frame.tolist() == [1, 3]
    assert found.joints.tolist() == [1, 2]
    # From 1 - 0.25 to 2.5, from -0.15 to 1.5, and from -0.3 to 1.5.
    assert torch.equal(found.pose[1, :, :3], torch.eye(3).double())
    assert found.pose[1, :, 3].tolist() == pytest.approx([1.625, 0.675, 0.6])
    assert found.size[1].tolist() == pytest.approx([0.875, 0.825, 0.9, 0, 0])
    one = hand()
    assert with_boxed_hand(one, 1) is one
    assert len(with_boxed_hand(one, 7)) == 3


def test_solids_are_placed_in_the_frames_that_carry_them() -> None:
    frames = torch.stack([pose(9, 9, 9), pose(0, 0, 0), pose(0, 0, 5, turn=QUARTER), pose(0, 1, 0)])
    placed = hand().placed(frames)
    turned = torch.tensor(QUARTER).double()
    torch.testing.assert_close(placed.pose[1, :, :3], turned @ turned)
    assert placed.pose[:, :, 3].tolist() == [[0, 0, 0], [0, 1, 5], [2, 2, 1]]
    assert torch.equal(placed.size, hand().size)
    assert (placed.frame.tolist(), placed.joints.tolist()) == ([-1] * 3, [0] * 3)


def test_solids_follow_one_another_and_may_be_none() -> None:
    both = hand().joined(hand()[torch.tensor([2])], solids_of([]))
    assert both.frame.tolist() == [1, 2, 3, 3]
    assert len(both) == len(both.radius) == 4
    rounded = both.to(torch.zeros(1))
    assert (rounded.pose.dtype, rounded.frame.dtype) == (torch.float32, torch.int64)
