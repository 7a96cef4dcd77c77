"""Algorithm 1 as a loop of improving, acting and learning.

A candidate is evolved and judged in Γ and C, where that costs nothing. Then it acts in the world:
on the stage's tests, on W and M if the world repeats itself, and on fresh scenarios until it has
solved `Setup.practice` of them in a row. Every trial becomes data for Γ and C, and what failed is
where the next member is evolved. `cgtorch.improvement.grow` is the paper's method.
"""

import time
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.improvement.acting import DECISIVE, acted, without_chance
from cgtorch.improvement.compose import specialists_of
from cgtorch.improvement.events import SkillAccepted
from cgtorch.improvement.grouping import cover
from cgtorch.improvement.interfaces import Draw, S
from cgtorch.improvement.proposing import REFLECT, proposed
from cgtorch.improvement.setup import Progress, Stage
from cgtorch.improvement.team import (
    Candidate,
    StageState,
)
from cgtorch.improvement.trial import looked

IDLE = 6  # candidates in a row that solve nothing more, after which a stage ends


def improve(stage: Stage[S], progress: Progress[S], tests: S, draw: Draw[S]) -> Progress[S]:
    """Act, learn and improve until fresh scenarios are solved in a row, or the budget is spent.

    Args:
        stage: What the stage works with.
        progress: The result of earlier stages.
        tests: The stage's own test scenarios, which are tried first.
        draw: Draws fresh scenarios.

    Returns:
        The new skill with what it solves and misses; the old one if eq. 1 could not be met.
    """
    began = time.perf_counter()
    try:
        state = _begun(stage, progress, tests, draw)
    except BudgetSpentError:
        return progress
    if not len(state.scenarios):  # for which nobody could be evolved
        return progress
    first, accepted, best, idle, done = state, False, (0, 0), 0, False
    for _ in range(stage.setup.attempts):
        before = state.current
        candidate, state = proposed(stage, state)
        if done and candidate is before:
            break
        if done:  # the new one has to show some of it, too
            in_a_row = min(state.in_a_row, stage.setup.practice) - REFLECT
            state = replace(state, in_a_row=max(0, in_a_row))
        state, done = acted(stage, state, candidate, draw)
        if state.judged is None and int(state.keep.sum()) >= DECISIVE:
            state = without_chance(stage, state)
        accepted |= bool((state.keep & ~state.known).any())
        solved = int(state.keep[: len(first.keep)].sum()) if state.repeats else 0
        idle = 0 if solved > best[0] or state.in_a_row > best[1] else idle + 1
        best = max(best[0], solved), max(best[1], state.in_a_row)
        if stage.setup.purse.exhausted or (state.repeats and (done or idle == IDLE)):
            break
    if accepted and state.judged is not state.current:
        state = without_chance(stage, state)
    chance = progress.chance or state.repeats != stage.setup.repeats
    about = state.knowledge, state.population
    progress = replace(progress, knowledge=about[0], specialists=about[1], chance=chance)
    if state.current is None:
        return progress
    old = state.current.skill
    skill = Skill(stage.name, old.graph, old.actions, old.max_transitions)
    if progress.skill is None and stage.setup.purse.exhausted and not state.tried.any():
        return replace(progress, skill=skill)
    if not accepted:
        return progress
    _report_accepted(stage, state, skill, time.perf_counter() - began)
    good, bad = state.tried & state.keep, state.tried & ~state.keep
    return replace(
        progress,
        skill=skill,
        solved=state.scenarios[good].joined(state.rest[0]),
        missed=state.scenarios[bad],
        seen=torch.cat([state.percepts[good], state.rest[1], state.percepts[bad]]),
    )


def _begun(stage: Stage[S], progress: Progress[S], tests: S, draw: Draw[S]) -> StageState[S]:
    """A coreset of W, the tests, M, and first percepts to practise on in the models."""
    setup, solved, missed = stage.setup, progress.solved, progress.missed
    repeats = setup.repeats and not progress.chance
    waiting, tests = (tests[:0], tests) if repeats else (tests, tests[:0])
    looks, seen = _looks(stage, progress, tests, draw)
    known = seen[:0] if progress.seen is None else progress.seen
    of_w, of_m = known[: len(solved)], known[len(solved) :]
    core, _ = cover(of_w, setup.core)
    rest = torch.ones(len(solved), dtype=torch.bool).index_fill_(0, core, False)
    sizes = len(core), len(tests), len(missed), len(looks)
    number = torch.repeat_interleave(torch.arange(4), torch.tensor(sizes))
    skill = progress.skill
    members = () if skill is None else specialists_of(skill) or (skill,)
    return StageState(
        scenarios=solved[core].joined(tests, missed, looks),
        percepts=torch.cat([of_w[core], seen[: len(tests)], of_m, seen[len(tests) :]]),
        keep=number == 0,
        known=number == 0,
        tried=(number == 0) | (number == 2),
        shown=repeats * (number == 0).long() - (number == 2).long(),
        targets=(number == 1) | (number == 2),
        rest=(solved[rest], of_w[rest]),
        waiting=waiting,
        knowledge=progress.knowledge,
        members=members,
        trust=torch.ones(sum(sizes), len(members)),
        population=progress.specialists,
        current=None if skill is None else Candidate(skill),
        repeats=repeats,
    )


def _looks(stage: Stage[S], progress: Progress[S], tests: S, draw: Draw[S]) -> tuple[S, Tensor]:
    """Fresh scenarios to practise on in the models, and first percepts of the tests and of these.

    A robot would need somebody to arrange a scene for each look, so percepts of the data stand for
    them. So they do if the budget has no looks left. BudgetSpentError if the tests need some.
    """
    setup = stage.setup
    if not setup.live:
        looks = draw(setup.looks, stage.generator)
        try:
            return looks, looked(stage, tests.joined(looks))
        except BudgetSpentError:
            if len(tests) or setup.learn is None:
                raise
    seen = progress.knowledge.dataset.percept[: setup.looks]
    return draw(len(seen), stage.generator), seen


def _report_accepted(stage: Stage[S], state: StageState[S], skill: Skill, seconds: float) -> None:
    """Report the new skill with its result on all scenarios that were tried, and on the rest."""
    rows, rest = state.tried, state.rest[0]
    yes = torch.ones(len(rest), dtype=torch.bool)
    stage.watch(
        SkillAccepted(
            stage.name,
            skill,
            state.scenarios[rows].joined(rest),
            torch.cat([state.keep[rows], yes]),
            torch.cat([state.known[rows], yes]),
            torch.cat([state.targets[rows], ~yes]),
            seconds,
            state.other_noise if state.judged is state.current else None,
        )
    )
