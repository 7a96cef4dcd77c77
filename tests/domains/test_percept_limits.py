"""Which percepts are possible, as data show it."""

import math

import torch
from support import seeded

from cgtorch.domains.percept_limits import Limits, circles_in
from cgtorch.ground.fields import Field, named


def angles(count: int = 50) -> torch.Tensor:
    return 2 * math.pi * torch.rand(count, generator=seeded(0))


def test_pairs_on_a_circle_are_found_and_stay_there() -> None:
    one = angles()
    percepts = torch.stack([one.cos(), torch.rand(50, generator=seeded(1)), one.sin()], 1)
    ((i, j, radius),) = circles_in(percepts.double())
    assert (i, j) == (0, 2)
    assert abs(radius - 1) < 1e-6
    limits = Limits.found(named("cosine", "other", "sine"), percepts)
    valid = limits.valid(torch.tensor([[3.0, 7.0, 4.0]]))
    torch.testing.assert_close(valid, torch.tensor([[0.6, 7.0, 0.8]]))
    tiny = 1e-9 * torch.stack([one.cos(), one.sin()], 1)
    valid = Limits.found(named("cosine", "sine"), tiny).valid(torch.tensor([[3e-9, 4e-9]]))
    torch.testing.assert_close(valid, torch.tensor([[0.6e-9, 0.8e-9]]), atol=1e-13, rtol=0)


def test_constants_and_single_percepts_are_on_no_circle() -> None:
    still = torch.tensor([[0.6, 0.8]]).repeat(20, 1)
    assert circles_in(still) == ()
    assert circles_in(torch.tensor([[0.6, 0.8]])) == ()
    assert circles_in(torch.rand(40, 3, generator=seeded(2))) == ()


def test_numbers_stay_within_their_bounds() -> None:
    limits = Limits.found((Field("place", low=-1, high=2), Field("speed")), torch.rand(9, 2))
    valid = limits.valid(torch.tensor([[-5.0, -5.0], [5.0, 5.0], [0.5, 0.5]]))
    assert valid.tolist() == [[-1.0, -5.0], [2.0, 5.0], [0.5, 0.5]]


def test_what_came_to_a_bound_does_not_tell_how_far_it_would_go() -> None:
    fields = named("place", "contact", low=0, high=1)
    percepts = torch.tensor([[0.2, 0.0], [1.0, 0.0], [0.4, 1.0], [0.6, 0.0]])
    # A contact always is at a bound, so it was not cut off there.
    assert Limits.found(fields, percepts).inside(percepts).tolist() == [True, False, True, True]
