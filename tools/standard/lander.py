"""LunarLander-v3 of Gymnasium, whose physics is Box2D's.

What Box2D knows of a lander cannot be read off, so a state here is no state of physics: each lane
has an environment of its own, as in the library's Gymnasium domain, and a lane has to be run from
its start. Lanes of another batch that begin in the same world end those before.
"""

from functools import cache

import torch

from cgtorch.domains.gymnasium_episodes import Episodes
from cgtorch.domains.gymnasium_scaling import Scaling
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_world import PlayedWorld
from standard.task import Starts, Task

NAME = "LunarLander-v3"
INPUTS, ACTIONS, MOST_STEPS, SOLVED = 8, 4, 1000, 200.0
SCALE = (0.5, 1.0, 0.7, 0.7, 0.6, 0.6, 1.0, 1.0)
"""Divisors of what is observed: two positions, two velocities, angle and its velocity, two legs.

They are about what is reached in episodes of random actions, as in the Gymnasium domain; the legs
say 0 or 1.
"""


@cache
def landers() -> Episodes:
    """Environments that are used again for each batch of lanes."""
    return Episodes(GymnasiumSettings(NAME))


def world(scenarios: Starts) -> PlayedWorld:
    """The world of starts, whose seeds are given to `reset`."""
    scale = torch.tensor(SCALE, dtype=torch.float64)
    scaling = Scaling(torch.zeros_like(scale), scale)
    return PlayedWorld(landers(), scenarios.seed, scaling, target=SOLVED)


def lunar_lander() -> Task:
    """The task; the threshold is Gymnasium's own."""
    return Task(
        name="lunar_lander",
        title="LunarLander",
        world=world,
        inputs=INPUTS,
        outputs=ACTIONS,
        discrete=True,
        solved=SOLVED,
        most_steps=MOST_STEPS,
    )
