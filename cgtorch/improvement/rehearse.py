"""Rehearsing a kind of scenarios that an earlier stage has learned.

Where the world repeats itself, no later skill has lost anything that the earlier stage solved. So a
few fresh scenarios tell whether the skill is as good as it was, and it is improved only if not.
"""

import time
from dataclasses import replace

import torch

from cgtorch.graphs import Skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.statistics import wilson
from cgtorch.improvement.events import Practised, S, SkillAccepted
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.trial import attempt

FEWER = 5  # fresh scenarios are a fifth of those that are practised in a new kind
CONFIDENCE = 0.95


def rehearse(
    setup: Setup[S], progress: Progress[S], skill: Skill, tests: S, draw: Draw[S], share: float
) -> Progress[S]:
    """Try a skill on fresh scenarios, and improve it if it is significantly worse than before.

    Args:
        setup: The inputs of the stage.
        progress: The result of earlier stages.
        skill: Its skill.
        tests: The stage's own test scenarios, which are tried, too.
        draw: Draws fresh scenarios.
        share: Of fresh scenarios that the earlier stage's skill has solved.

    Returns:
        The same skill under the stage's name, with more that it solves and misses, or the result of
        `improve`.
    """
    began, count = time.perf_counter(), -(-setup.practice // FEWER)
    scenarios = draw(count, setup.generator).joined(tests)
    try:
        trial = attempt(setup, skill, scenarios, "practice")
    except BudgetSpentError:
        return progress
    good, old, missed = trial.succeeded, len(progress.solved), progress.missed
    seen = trial.percepts[:0] if progress.seen is None else progress.seen
    after = replace(
        progress,
        solved=scenarios[good].joined(progress.solved),
        missed=scenarios[~good].joined(missed),
        seen=torch.cat([trial.percepts[good], seen[:old], trial.percepts[~good], seen[old:]]),
    )
    fresh = good[:count]
    setup.watch(Practised(setup.name, skill, int(fresh.flip(0).cumprod(0).sum()), count))
    now = int(fresh.sum())
    worse = now < share * count and wilson(now, count, CONFIDENCE)[1] < share
    if worse or not good.any():
        return improve(setup, after, tests, draw)
    named = Skill(setup.name, skill.graph, skill.actions, skill.max_transitions)
    every = scenarios.joined(missed, progress.solved)
    sizes = torch.tensor([count, len(tests), len(missed), old])
    part = torch.repeat_interleave(torch.arange(4), sizes)
    succeeded = torch.cat([good, part[len(good) :] == 3])  # the rest is known
    about = every, succeeded, part == 3, (part == 1) | (part == 2)
    seconds = time.perf_counter() - began
    setup.watch(SkillAccepted(setup.name, named, *about, seconds, None, skill.name))
    return replace(after, skill=named)
