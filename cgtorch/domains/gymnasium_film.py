"""Films of Gymnasium environments that draw pictures."""

from typing import Any

import numpy as np

from cgtorch.domains.film import Picture, Reel, shrunk
from cgtorch.domains.registry import foreign
from cgtorch.ground.errors import DomainError

MODE = "rgb_array"
EVERY = 0.05  # s between two pictures, at least
USUAL = 30.0  # steps per second of an environment that does not tell


class Filmed:
    """An environment of which pictures are taken as it goes on."""

    def __init__(self, environment: Any, width: int) -> None:
        """Pictures of at most that width of an environment with `render_mode` rgb_array."""
        self._environment, self._width, self._steps = environment, width, 0
        self._pace = 1 / float(environment.metadata.get("render_fps") or USUAL)
        self.reel = Reel(self._drawn, max(EVERY, self._pace))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._environment, name)

    def reset(self, **how: Any) -> Any:
        """See `gymnasium.Env.reset`; a film begins."""
        found = self._environment.reset(**how)
        self._steps = 0
        self.reel.begin()
        self.reel.take(0.0)
        return found

    def step(self, action: Any) -> Any:
        """See `gymnasium.Env.step`."""
        found = self._environment.step(action)
        self._steps += 1
        self.reel.take(self._steps * self._pace)
        return found

    def _drawn(self) -> Picture:
        advice = "pip install 'cgtorch[gymnasium]' has what its own environments draw with"
        drawn = foreign(self._environment.render, "the environment cannot draw", advice)
        if not isinstance(drawn, np.ndarray) or drawn.ndim != 3 or drawn.shape[2] != 3:
            raise DomainError(
                f"the environment drew {drawn!r:.60}; in render_mode {MODE!r}, return an array of "
                "red, green and blue"
            )
        return shrunk(drawn.astype(np.uint8), self._width)
