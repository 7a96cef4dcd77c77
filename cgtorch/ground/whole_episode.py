"""Dry run of a whole episode: noise that begins late, and what is left for the next episode."""

import time

import torch
from torch import Tensor

from cgtorch.ground.dry_run import LITTLE, ROWS, first_difference, returned
from cgtorch.ground.environment import Copied, Environment, Episodic, Lanes, Rewarded, start_lanes
from cgtorch.ground.errors import DomainError, WorldError

STEPS, SECONDS = 300, 1.0  # of an episode at most
ROUNDED = 1e-3  # difference between two unused copies, as a share


def what_differs_late(environment: Environment, controls: Tensor, slow: bool) -> tuple[str, str]:
    """What differs in a second copy of a checked environment, and in a second episode, or "".

    A whole episode has `controls` (N, U) one after the other, as long as `SECONDS` allow. Two
    copies that nobody has used yet play it, as what came before may make a difference that grows.
    After it, the same beginning has to show about the same. A `slow` one is not copied.
    """
    name = type(environment).__name__
    copies = None if slow else _anew(environment)
    rows = torch.zeros(1 if copies is None else ROWS, dtype=torch.long)
    played = environment if copies is None else copies
    once = returned(WorldError, name, episode_shown, played, rows, controls)
    again = returned(WorldError, name, episode_shown, played, rows, controls[:1])
    one, other = ({what: seen[[row]] for what, seen in once.items()} for row in (0, -1))
    differs = first_difference(environment, one, other, ROUNDED)
    return differs, first_difference(
        environment, {what: once[what] for what in again}, again, LITTLE
    )


def _anew(environment: Environment) -> Environment | None:
    """The environment with unused copies, or itself if it has none; None if it cannot have two."""
    if not isinstance(environment, Copied):
        return environment
    try:
        copies = environment.anew()
        copies.start(torch.zeros(ROWS, dtype=torch.long))
    except DomainError:  # there may be only one at once
        return None
    return copies if getattr(copies, "most_lanes", ROWS) >= ROWS else None


def episode_shown(environment: Environment, rows: Tensor, controls: Tensor) -> dict[str, Tensor]:
    """Percepts, returns and ends of the same scenario (n,) with the same controls (N, U)."""
    lanes: Lanes = start_lanes(environment, rows, environment.control_size, 0)
    seen, until = {"number {} of the first percept": lanes.percept}, time.monotonic() + SECONDS
    for motion, control in enumerate(controls, 1):
        lanes, _ = environment.step(lanes, control.expand(len(rows), -1).to(lanes.percept))
        seen[f"number {{}} of the percept after motion {motion}"] = lanes.percept
        if isinstance(environment, Rewarded):
            seen[f"the return after motion {motion}"] = environment.returns(lanes)
        over = torch.zeros(len(rows))
        if isinstance(environment, Episodic):
            over = environment.over(lanes).float()
            seen[f"whether it is over after motion {motion}"] = over
        if over.any() or time.monotonic() > until:
            break
    return seen
