"""Noise that begins late in an episode, and what one episode leaves to the next, are found."""

from copy import copy
from dataclasses import replace
from typing import Any, Self

import pytest
import torch
from torch import Tensor

from cgtorch.ground import whole_episode
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import DomainError
from cgtorch.ground.whole_episode import what_differs_late

CONTROLS = torch.linspace(-1, 1, 20)[:, None]


class Course:
    """Episodes of 12 motions, whose only scenario is at 0, and what it has of earlier ones."""

    num_scenarios, percept_size, control_size = 1, 1, 1
    noise, kept, left = 0.0, 0.0, 0.0
    copies, motions = 0, 0

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        self.motions = 0
        return torch.zeros(len(scenario), 1), torch.full((len(scenario), 1), self.left)

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        self.motions += 1
        late = torch.arange(len(lanes))[:, None] * self.noise * (self.motions > 8)
        self.left = self.kept * float(control.abs().max())
        done = torch.ones(len(lanes), dtype=torch.bool)
        return replace(lanes, percept=lanes.percept + control + late, state=lanes.state + 1), done

    def observe(self, lanes: Lanes) -> Lanes:
        return lanes

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        return lanes, torch.zeros(len(lanes))

    def over(self, lanes: Lanes) -> Tensor:
        return lanes.state[:, 0] >= 12

    def anew(self) -> Self:
        self.copies += 1
        made = copy(self)
        made.left = 0.0
        return made


def course(**own: Any) -> Course:
    return type("Own", (Course,), own)()


def test_noise_that_begins_late_is_seen() -> None:
    late = "number 1 of the percept after motion 9: "
    assert what_differs_late(course(), CONTROLS, slow=False) == ("", "")
    assert what_differs_late(course(noise=0.1), CONTROLS, slow=False)[0].startswith(late)
    assert what_differs_late(course(noise=1e-6), CONTROLS, slow=False) == ("", "")


@pytest.mark.parametrize("slow", [False, True])
def test_what_an_episode_leaves_to_the_next_is_seen(slow: bool) -> None:
    differs, left = what_differs_late(course(kept=1.0), CONTROLS, slow)
    assert (differs, left[:32]) == ("", "number 1 of the first percept: 0")
    # As contacts of Box2D do, which depend a little on what came before.
    assert what_differs_late(course(kept=0.01), CONTROLS, slow) == ("", "")


def test_a_slow_environment_is_not_copied_and_an_episode_does_not_take_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(whole_episode, "SECONDS", 0.0)
    one = course(noise=0.1)
    assert what_differs_late(one, CONTROLS, slow=True) == ("", "")
    assert one.copies == 0


def test_one_that_exists_only_once_is_tried_alone() -> None:
    def none(self: Course) -> Course:
        raise DomainError("the licence is in use")

    for own in ({"anew": none}, {"most_lanes": 1}):
        assert what_differs_late(course(noise=0.1, **own), CONTROLS, slow=False) == ("", "")
        assert what_differs_late(course(kept=1.0, **own), CONTROLS, slow=False)[1]


def test_an_end_that_comes_otherwise_is_seen() -> None:
    def over(self: Course, lanes: Lanes) -> Tensor:
        return (lanes.state[:, 0] >= 3) & (torch.arange(len(lanes)) > 0)

    ends = course(over=over)
    said = "whether it is over after motion 3: 0.0 and 1.0"
    assert what_differs_late(ends, CONTROLS, slow=False)[0] == said
