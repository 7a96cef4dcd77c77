"""Percepts are scaled by what was seen, or by bounds where these tell something."""

from typing import Any

import numpy as np
import pytest
import torch
from line_environment import Line, domain_of

from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_scaling import outside, scaled_by_bounds, scaling_of
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_spaces import Percepts, percepts_of

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.spaces import Box  # noqa: E402

from cgtorch.domains.gymnasium_models import GymnasiumModels  # noqa: E402


def boxed(low: Any, high: Any) -> Percepts:
    space = Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
    return percepts_of(space, (), "Mine-v0")


def line(least: float, most: float) -> np.ndarray[Any, Any]:
    return np.linspace(least, most, 11, dtype=np.float32)[:, None]


@pytest.mark.parametrize(
    ("least", "most", "by_bounds"),
    [
        (-2.0, 3.0, True),
        (-10.0, 10.0, True),  # all of it
        (4.0, 4.0, True),  # it does not vary, so it tells nothing about its bounds
        (0.0, 0.21, True),  # a little more than a hundredth of the range
        (0.0, 0.19, False),
        (4.0, 14.0, False),  # outside
        (12.0, 12.0, False),
    ],
)
def test_bounds_scale_where_a_fair_part_of_them_was_seen(
    least: float, most: float, by_bounds: bool
) -> None:
    seen = line(least, most)
    found, usual = scaled_by_bounds(boxed([-10], [10]), seen), scaling_of(seen)
    wanted = (0.0, 10.0) if by_bounds else (float(usual.centre), float(usual.scale))
    assert (float(found.centre), float(found.scale)) == wanted


def test_without_both_bounds_the_spread_scales() -> None:
    seen = line(-1, 1)
    for high in (np.inf, 1e35):
        found = scaled_by_bounds(boxed([-10], [high]), seen)
        assert torch.equal(found.scale, scaling_of(seen).scale)


def test_numbers_outside_their_bounds_are_told() -> None:
    percepts = boxed([0, 0, -np.inf], [1, 1, 1])
    seen = np.array([[0.5, 0.5, -1e9], [1.0005, 0.5, 0.5]], np.float32)
    assert outside(percepts, seen) == ""  # but for rounding
    told = "Random episodes showed observation 1 as {}, outside its bounds 0 to 1{}; correct the "
    far = seen + np.array([[0, 0, 0], [127, 0, 0]])
    assert outside(percepts, far).startswith(told.format("128", ""))
    seen = seen - np.array([[2, 0, 0], [0, 3, 0]])
    assert outside(percepts, seen).startswith(told.format("-1.5", ", and 1 more numbers"))


def test_what_random_episodes_show_outside_their_space_is_remarked_upon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    domain = domain_of(monkeypatch, {"seen": lambda line: np.array([128 + line.place, 0.5])})
    assert "observation 1 as 13" in domain.known.remark
    assert domain.sparing().known.remark == domain.known.remark, "which is kept"
    fresh: Any = Gymnasium(GymnasiumSettings("Tiny/Line-v0", target_return=5.0)).sparing()
    assert ("outside its bounds -9 to 9; correct" in fresh.known.remark) is True
    scaling, seen = fresh.known.scaling, torch.tensor([[128.0, 0.5]])
    percept = (seen - scaling.centre) / scaling.scale
    assert percept.abs().max() < 3
    limits = GymnasiumModels(fresh).limits(percept.float())
    assert torch.equal(limits.valid(percept.clone()), percept)
    assert limits.high[0] == torch.inf
    assert limits.low[0] > -torch.inf, "no bound that nothing was beyond is lost"


def test_bounds_that_nobody_thought_about_do_not_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    def init(self: Line) -> None:
        own(self)
        self.observation_space = Box(-1e5, 1e5, (2,), np.float64)

    own = Line.__init__
    monkeypatch.setattr(Line, "__init__", init)
    monkeypatch.setattr(Line, "changes", {})
    domain = Gymnasium(GymnasiumSettings("Tiny/Line-v0", target_return=5.0)).sparing()
    scale = domain.known.scaling.scale.tolist()
    assert 0.1 < scale[0] < 5
    assert scale[1] == 1e5  # as 0.5 does not vary
    assert not domain.known.remark
