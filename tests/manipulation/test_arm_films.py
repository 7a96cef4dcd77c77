"""A film of an arm asks nothing of the memory of segments, and leaves everything as it was."""

from typing import Any

import numpy as np
from arms import chain, meta_world, starts

from cgtorch.graphs import Skill
from cgtorch.manipulation import film as films
from cgtorch.manipulation.film import ArmPictures


class Drawn:
    """In place of a renderer, whose pictures are how far a simulation has come."""

    def __init__(self, model: Any, width: int) -> None:
        self.scene, self.closed = self, False
        self.flags = dict[Any, bool]()
        self.width = width

    def update_scene(self, data: Any, view: Any) -> None:
        self.time = data.time

    def render(self) -> Any:
        return np.full((3, self.width, 3), self.time)

    def close(self) -> None:
        self.closed = True


def test_low_level_steps_are_filmed_once_and_not_counted(monkeypatch: Any) -> None:
    made = list[Drawn]()

    def renderer(model: Any, width: int) -> Drawn:
        made.append(Drawn(model, width))
        return made[-1]

    monkeypatch.setattr(films, "renderer", renderer)
    domain = meta_world("reach-v3")
    skill = Skill("reach", chain(domain, ("ReachGoal", (0.0,) * 3)), domain.actions())
    scenarios, simulator = starts(domain, 5), domain.simulators[0]
    before = simulator.requested, simulator.simulated
    one, again = (ArmPictures(domain).film(skill, scenarios, 7) for _ in range(2))
    assert one is not None
    assert again is not None
    assert one.end == again.end == "success"
    times = [float(frame.mean()) for frame in one.frames]
    assert times == [float(frame.mean()) for frame in again.frames]
    assert np.allclose(np.diff(times[:-1]), 0.05, atol=0.013)
    assert one.frames[0].shape == (3, 7, 3)
    assert one.lasts == 80
    assert (simulator.requested, simulator.simulated) == before
    assert simulator.watch is None
    assert all(each.closed for each in made)
