"""Runs of a nested skill and of the flat one, in the plain interpreter and in the engine."""

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
from cgtorch.simulation import rollout

STEPS = 40


def test_runs_are_the_same_up_to_where_a_skill_runs_out_of_transitions() -> None:
    met: Count[str] = Count()
    for seed in range(60):
        limits = [(2, 4), (5, 5), (20, 20), (STEPS, STEPS)][seed % 4]
        actions = as_double_actions(nested_actions(seed, endless_actions(), limits))
        nested = random_skill(seed + 2, "top", actions, max(20, *limits))
        nested = replace(nested, graph=as_double(nested.graph))
        flat = flattened(nested)
        for place in (world(seed, 5, dtype=torch.float64), model(seed, 5, dtype=torch.float64)):
            runs = [
                rollout(
                    s.graph, s.actions, place, max_transitions=s.max_transitions, max_steps=STEPS
                )
                for s in (nested, flat)
            ]
            for i in range(5):
                (end, was), (flat_end, now) = (
                    reference.live(s.graph, s.actions, place, i, s.max_transitions, STEPS)
                    for s in (nested, flat)
                )
                common = was.steps if was.ran_out is None else was.ran_out
                assert now.seen[:common] == was.seen[:common]
                if was.ran_out is None:
                    assert (flat_end, now.steps) == (end, was.steps)
                    for value in ("succeeded", "timed_out", "percept", "state", "transitions"):
                        once, again = (getattr(r, value)[0, i] for r in runs)
                        assert torch.equal(once, again), value
                met[f"{end}, {'same' if was.ran_out is None else 'ran out'}"] += 1
    assert all(met[f"{end}, same"] >= 10 for end in ("success", "timeout")), met
    assert all(met[f"{end}, ran out"] >= 10 for end in ("success", "timeout")), met
