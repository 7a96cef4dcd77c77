"""What a driving body sweeps over, against shapely."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from planar import polygon
from shapely import Polygon, affinity, box, distance, union_all
from support import FOOTPRINT
from torch import Tensor

from cgtorch.native import function
from cgtorch.tabletop.world import clear_motion
from cgtorch.tabletop.world.clear_motion import (
    MAX_TRANSLATION,
    TURN_STEP,
    motion_possible,
    motion_possible_in_torch,
    sweep_blocked,
)

metres = st.floats(-2, 2)
angles = st.floats(-2 * math.pi, 2 * math.pi)
BODY = torch.tensor(FOOTPRINT, dtype=torch.float64)

# How far a corner of the body is off between two sampled angles.
BETWEEN = BODY.abs().max().item() * 2**0.5 * (1 - math.cos(TURN_STEP / 2))


def tensor(*rows: tuple[float, ...]) -> Tensor:
    return torch.tensor(rows, dtype=torch.float64)


def swept(motion: tuple[float, ...], grown: float) -> Polygon:
    """All that the grown body covers: the hull of the drive, then finely sampled turns."""
    dx, dy, turn = motion
    x0, x1, y0, y1 = FOOTPRINT
    body = box(x0 - grown, y0 - grown, x1 + grown, y1 + grown)
    there = affinity.translate(body, dx, dy)
    drive = union_all([body, there]).convex_hull
    short = math.remainder(turn, 2 * math.pi)  # the turn is made the short way
    samples = np.linspace(0, short, 1 + math.ceil(abs(short) / math.radians(1)))
    turns = [affinity.rotate(there, a, origin=(dx, dy), use_radians=True) for a in samples]
    return union_all([drive, *turns])


@given(
    st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), angles),
    st.tuples(metres, metres, angles, st.floats(0.4, 1.3), st.floats(0.4, 1.3)),
    st.sampled_from([0.0, 0.02]),
)
@settings(max_examples=100)
def test_a_sweep_is_blocked_where_it_touches(
    motion: tuple[float, ...], rectangle: tuple[float, ...], clearance: float
) -> None:
    """Except within a thin band: corners between sampled angles, and turns of half a circle."""
    found = sweep_blocked(tensor(motion), tensor(rectangle), BODY, clearance).item()
    table, cover = polygon(rectangle), swept(motion, clearance)
    if distance(table, cover) > 1e-6:
        assert not found
    elif table.intersects(swept(motion, clearance - 2 * BETWEEN)) and not half_turn(motion):
        assert found


def half_turn(motion: tuple[float, ...]) -> bool:
    """Where the short way round is a matter of rounding."""
    return abs(abs(math.remainder(motion[2], 2 * math.pi)) - math.pi) < 1e-6


def test_the_band_between_sampled_angles_is_thin() -> None:
    assert BETWEEN < 0.005


@pytest.mark.parametrize(("x", "wanted"), [(1.0, False), (0.83, False), (0.70, True)])
def test_the_comparison_sees_both_sides(x: float, wanted: bool) -> None:
    table = tensor((x + 0.4, 0.0, 0.0, 0.8, 1.2))
    drive = tensor((0.0, 0.0, math.pi / 4))  # a corner of the body comes round at 0.467 m
    assert sweep_blocked(drive, table, BODY).item() is (x < 0.467)
    assert sweep_blocked(tensor((0.4, 0.0, 0.0)), table, BODY).item() is wanted


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_motion_that_is_not_finite_is_blocked(bad: float, which: int) -> None:
    motion = torch.zeros(2, 3, dtype=torch.float64)
    motion[0, which] = bad
    far = tensor((50.0, 0.0, 0.0, 1.0, 1.0), (50.0, 0.0, 0.0, 1.0, 1.0))
    assert sweep_blocked(motion, far, BODY).tolist() == [True, False]


def test_no_motions_at_all() -> None:
    empty = torch.zeros(0, 3, dtype=torch.float64)
    assert sweep_blocked(empty, torch.zeros(0, 5, dtype=torch.float64), BODY).shape == (0,)


def test_rows_are_independent() -> None:
    generator = torch.Generator().manual_seed(0)
    motion = torch.randn(300, 3, generator=generator)
    table = torch.cat(
        [torch.randn(300, 3, generator=generator), 0.3 + torch.rand(300, 2, generator=generator)], 1
    )
    whole = sweep_blocked(motion, table, BODY.float())
    assert 0.2 < whole.float().mean() < 0.9
    for n in (1, 2, 7):
        parts = [
            sweep_blocked(m, t, BODY.float())
            for m, t in zip(motion.split(n), table.split(n), strict=True)
        ]
        assert torch.equal(torch.cat(parts), whole)


def test_a_turn_is_made_the_short_way() -> None:
    """350° is 10° backwards, which does not bring a corner into the table; 45° does."""
    table = tensor((0.40 + 0.4, 0.0, 0.0, 0.8, 1.2))
    for degrees, wanted in ((350, False), (-10, False), (370, False), (45, True), (405, True)):
        motion = tensor((0.0, 0.0, math.radians(degrees)))
        assert sweep_blocked(motion, table, BODY).item() is wanted


def test_a_motion_may_be_as_long_as_the_longest_and_has_to_be_finite() -> None:
    nothing, nan = torch.zeros(1, 5).double(), math.nan
    far = MAX_TRANSLATION
    motion = tensor((far, 0, 0), (far + 1e-6, 0, 0), (0, -far, 9), (nan, 0, 0), (0, 0, nan))
    things = nothing.expand(5, 5)
    for found in (
        motion_possible(motion, things, BODY),
        motion_possible_in_torch(motion, things[:, None], BODY),
    ):
        assert found.tolist() == [True, False, True, False, False]
    further = motion_possible_in_torch(motion, things[:, None], BODY, math.inf)
    assert further.tolist() == [True, True, True, False, False]


def test_torch_and_compiled_code_agree() -> None:
    draw = torch.rand(3000, 2, 8, generator=torch.Generator().manual_seed(0)).double()
    things = torch.cat([4 * draw[..., :2] - 2, 7 * draw[..., 2:3] - 3.5, draw[..., 3:5]], 2)
    things[::7, 1] = 0.0  # which is absent
    motion = 2 * draw[:, 0, 5:] - 1
    motion[:, 2] *= 6.5
    motion[::3, 2] = 0.0
    found = motion_possible_in_torch(motion, things, BODY)
    assert torch.equal(found, motion_possible(motion, things, BODY))
    assert 500 < int(found.sum()) < 2500


def test_compiled_code_answers_where_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[str]()

    def noted(name: str, dtype: torch.dtype) -> object:
        asked.append(name)
        return function(name, dtype)

    monkeypatch.setattr(clear_motion, "function", noted)
    motion, things = tensor((1.0, 0, 0)), tensor((1.0, 0, 0, 0.2, 0.2))
    assert motion_possible(motion, things, BODY).tolist() == [False]
    assert asked == ["motions_possible"]
    assert motion_possible(motion.requires_grad_(), things, BODY).tolist() == [False]
    assert len(asked) == 1
