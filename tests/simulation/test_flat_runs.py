"""Runs of a nested skill and of the flat one, both in the plain interpreter."""

from collections import Counter as Count
from dataclasses import replace

import reference
import torch
from support import (
    as_double,
    as_double_actions,
    endless_actions,
    model,
    nested_actions,
    random_skill,
    world,
)

from cgtorch.graphs import flattened

STEPS = 40
LIMITS = [(2, 4, 9), (5, 5, 20), (20, 20, 20), (STEPS, STEPS, STEPS)]


def test_every_action_sees_the_same() -> None:
    """Up to where the outermost level runs out; there the flat skill idles."""
    met: Count[str] = Count()
    for seed in range(32):
        limits = LIMITS[seed % len(LIMITS)]
        actions = as_double_actions(nested_actions(seed, endless_actions(), limits[:2]))
        nested = random_skill(seed + 2, "top", actions, limits[2])
        nested = replace(nested, graph=as_double(nested.graph))
        flat = flattened(nested, STEPS)
        for place in (world(seed, 5, dtype=torch.float64), model(seed, 5, dtype=torch.float64)):
            for i in range(5):
                (end, was), (flat_end, now) = (
                    reference.run(s.graph, s.actions, place, i, s.max_transitions, STEPS)
                    for s in (nested, flat)
                )
                assert flat_end == end
                assert now.seen[: was.steps] == was.seen
                assert all(percept == now.seen[-1] for percept in now.seen[was.steps :])
                assert now.steps == (STEPS if end == "timeout" else was.steps)
                met[f"{end}, {'handed back' if was.ran_out else 'did not'}"] += 1
    for end in ("success", "timeout"):
        for way in ("handed back", "did not"):
            assert met[f"{end}, {way}"] >= 10, met
