"""Films of arms: the low-level steps of an episode, drawn by MuJoCo."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from cgtorch.domains.film import Film, Picture, Reel, renderer
from cgtorch.domains.pictures import Pictures
from cgtorch.graphs import Skill
from cgtorch.manipulation.simulator import SEEN, Simulator
from cgtorch.manipulation.world import ArmWorld, Starts

EVERY, SLOW = 0.05, 1.6  # s of the simulation between two pictures, which are shown slowly
BARE = ("mjRND_SHADOW", "mjRND_REFLECTION")  # what takes most of the time without a GPU


class ArmPictures(Pictures[Any]):
    """Films of the arm of a `Manipulation`, and the words for its episodes."""

    solved: ClassVar[tuple[str, str]] = ("solved", "Episodes solved")

    def film(self, skill: Skill, scenarios: Starts, width: int) -> Film | None:
        """See `Pictures.film`."""
        scenarios = scenarios[:1]
        domain, seed = self.domain, int(scenarios.seed[0])
        simulator = domain.simulators[int(scenarios.task[0])]
        about = domain.simulators, domain.arm, simulator.size, domain.num_ids
        world = ArmWorld(scenarios, *about)
        with _filmed(simulator, seed, domain, width) as reel:
            return reel.play(skill, world)


@contextmanager
def _filmed(simulator: Simulator, seed: int, domain: Any, width: int) -> Iterator[Reel]:
    """A reel of what a simulator does from the start with a seed on."""
    import mujoco

    model, data = simulator.states.model, simulator.states.data
    view, mine = mujoco.MjvCamera(), renderer(model, width)
    view.lookat[:] = domain.centre
    view.azimuth, view.elevation, view.distance = domain.view

    def draw() -> Picture:
        simulator.show()
        mine.update_scene(data, view)
        for flag in BARE:
            mine.scene.flags[getattr(mujoco.mjtRndFlag, flag)] = False
        picture: Picture = mine.render().copy()
        return picture

    reel = Reel(draw, EVERY, SLOW)
    try:
        simulator.states.write(simulator.start(seed)[SEEN + simulator.seen :], seed)
        begun = data.time
        reel.take(0.0)
        simulator.watch = lambda: reel.take(data.time - begun)
        yield reel
    finally:
        simulator.watch = None
        mine.close()
