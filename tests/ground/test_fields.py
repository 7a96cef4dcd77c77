"""Fields: what the numbers of a percept or a control are."""

import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import seeded

from cgtorch.ground.errors import DomainError
from cgtorch.ground.fields import (
    KINDS,
    Field,
    as_features,
    bounds_of,
    columns_of,
    named,
    within_bounds,
    wrapped,
)

KIND = st.sampled_from(KINDS)


@given(st.lists(KIND, max_size=8))
def test_every_field_is_in_the_columns_of_its_kind_and_of_no_other(kinds: list[str]) -> None:
    fields = [Field(str(i), kind=kind) for i, kind in enumerate(kinds)]
    columns = {kind: columns_of(fields, kind) for kind in KINDS}
    assert sorted(itertools.chain(*columns.values())) == list(range(len(kinds)))
    assert all(fields[i].kind == kind for kind, found in columns.items() for i in found)


@given(st.floats(-1e4, 1e4) | st.sampled_from([math.pi, -math.pi, 0.0]))
def test_a_wrapped_angle_points_the_same_way_within_one_turn(angle: float) -> None:
    exact = torch.tensor(angle, dtype=torch.float64)
    found = wrapped(exact)
    assert -math.pi <= float(found) < math.pi
    assert float(found.cos()) == pytest.approx(math.cos(angle), abs=1e-9)
    assert float(found.sin()) == pytest.approx(math.sin(angle), abs=1e-9)


@given(st.lists(KIND, min_size=1, max_size=6), st.integers(0, 4), st.integers(0, 2**31))
def test_angles_are_seen_by_sine_and_cosine_and_all_else_as_it_is(
    kinds: list[str], rows: int, seed: int
) -> None:
    fields = [Field(str(i), kind=kind) for i, kind in enumerate(kinds)]
    values = 9 * torch.randn(rows, len(kinds), generator=seeded(seed), dtype=torch.float64)
    found = as_features(values, fields)
    angles = columns_of(fields, "angle")
    others = [i for i in range(len(kinds)) if i not in angles]
    assert found.shape == (rows, len(others) + 2 * len(angles))
    assert torch.equal(found[:, : len(others)], values[:, others])
    sines, cosines = found[:, len(others) :].chunk(2, 1)
    assert torch.equal(sines, values[:, angles].sin())
    assert torch.equal(cosines, values[:, angles].cos())
    turned = values.clone()
    turned[:, angles] += 2 * math.pi
    assert torch.allclose(as_features(turned, fields), found, atol=1e-9)
    assert torch.equal(as_features(values.expand(2, -1, -1), fields)[1], found)


def test_named_fields_differ_in_their_names_and_have_bounds_if_given() -> None:
    given = named("x", "y", unit="m", low=-1, high=2)
    assert given == (Field("x", "m", -1, 2), Field("y", "m", -1, 2))
    assert named() == ()
    bounds = torch.stack(bounds_of([*given, Field("z")]))
    assert bounds.tolist() == [[-1, -1, -math.inf], [2, 2, math.inf]]


@pytest.mark.parametrize("bounds", [(1.0, 1.0), (2.0, -2.0), (0.0, math.nan), (math.nan, 1.0)])
def test_bounds_and_kinds_that_are_none_are_refused(bounds: tuple[float, float]) -> None:
    with pytest.raises(DomainError, match=r"field 'wind' lies between .*; give a range"):
        Field("wind", "m", *bounds)
    with pytest.raises(DomainError, match="of kind 'color'; use one of number, angle, discrete"):
        Field("hue", kind="color")


BOUNDS = [(-math.pi, math.pi), (0.0, 2 * math.pi), (-0.3, 0.3), (-math.inf, math.inf), (1, 9)]


@given(st.floats(-50, 50), st.sampled_from(BOUNDS))
def test_an_angle_comes_within_its_bounds_by_whole_turns(
    angle: float, bounds: tuple[float, float]
) -> None:
    low, high = bounds
    exact = torch.tensor([angle], dtype=torch.float64)
    found = within_bounds(exact, [Field("heading", "rad", low, high, "angle")])
    assert low - 1e-6 <= found.item() <= high + 1e-6
    turns = torch.arange(-20, 21, dtype=torch.float64) * 2 * math.pi
    reached = exact + turns
    reached = reached[(low <= reached) & (reached <= high)]
    if len(reached):  # else it is the nearer bound
        assert float((reached - found).abs().amin()) < 1e-6
    else:
        assert float((found - torch.tensor([low, high])).abs().amin()) < 1e-6


@given(st.floats(-50, 50), st.sampled_from(["number", "discrete"]))
def test_all_else_is_cut_off_at_its_bounds(value: float, kind: str) -> None:
    field = Field("gear", low=-1, high=2, kind=kind)
    values = torch.tensor([[value]], dtype=torch.float64)
    assert within_bounds(values, [field]).item() == min(max(value, -1), 2)
    assert torch.equal(within_bounds(values, [Field("gear", kind=kind)]), values)


@given(st.lists(KIND, min_size=1, max_size=5), st.integers(0, 4), st.integers(0, 2**31))
def test_a_field_comes_within_its_bounds_whatever_is_beside_it(
    kinds: list[str], rows: int, seed: int
) -> None:
    fields = [Field(str(i), "", -1.0 - i, 2.0, kind) for i, kind in enumerate(kinds)]
    values = 9 * torch.randn(2, rows, len(kinds), generator=seeded(seed), dtype=torch.float64)
    found = within_bounds(values, fields)
    alone = [within_bounds(values[..., [i]], [field]) for i, field in enumerate(fields)]
    assert torch.equal(found, torch.cat(alone, -1))
