"""A film of an arm asks nothing of the memory of segments, and leaves everything as it was."""

from typing import Any

import mujoco
import numpy as np
import pytest
from arms import chain, fetch, meta_world, starts

from cgtorch.graphs import Skill
from cgtorch.manipulation import film as films
from cgtorch.manipulation.film import ArmPictures
from cgtorch.manipulation.simulator import SEEN


class Drawn:
    """In place of a renderer, whose pictures are how far a simulation has come."""

    def __init__(self, model: Any, width: int) -> None:
        self.scene, self.closed = self, False
        self.flags = np.ones(16, dtype=bool)
        self.width, self.sites = width, list[Any]()

    def update_scene(self, data: Any, view: Any) -> None:
        self.time, self.view = data.time, view
        self.sites.append(data.site_xpos.copy())
        self.flags[:] = True

    def render(self) -> Any:
        bare = mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION
        assert not any(self.flags[flag] for flag in bare)
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
    scenarios, simulator = starts(domain, 5, 6), domain.simulators[0]  # the first is filmed
    before = simulator.requested, simulator.simulated
    alone = starts(domain, 5)
    one, again = (ArmPictures(domain).film(skill, each, 7) for each in (scenarios, alone))
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
    for each in made:
        assert each.view.lookat.tolist() == pytest.approx(domain.centre)
        assert (each.view.azimuth, each.view.elevation, each.view.distance) == domain.view


def test_a_film_shows_the_goal_and_looks_down_at_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made = list[Drawn]()

    def renderer(model: Any, width: int) -> Drawn:
        made.append(Drawn(model, width))
        return made[-1]

    monkeypatch.setattr(films, "renderer", renderer)
    domain = fetch("FetchReach-v4")
    skill = Skill("wait", chain(domain, ("Wait", ())), domain.actions())
    assert ArmPictures(domain).film(skill, starts(domain, 5), 7) is not None
    simulator = domain.simulators[0]
    simulator.states.write(simulator.start(5)[SEEN + simulator.seen :], 5)
    goal = simulator.environment.goal.tolist()
    shown = [sites[simulator.states.model.site("target0").id].tolist() for sites in made[0].sites]
    assert len(shown) > 3
    assert all(site == goal for site in shown)
    for each in (domain, meta_world()):
        azimuth, elevation, distance = each.view
        assert 90 < azimuth < 180  # from the front and aside
        assert -90 < elevation < 0
        assert 1 < distance < 2
