"""A candidate acts in the world: on what it should solve, and on fresh scenarios."""

from dataclasses import replace

import torch

from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import Dataset
from cgtorch.ground.statistics import wilson
from cgtorch.improvement.events import ChanceFound, Practised, WorldTested, solved_of
from cgtorch.improvement.interfaces import Draw, S
from cgtorch.improvement.proposing import REFLECT, proposed
from cgtorch.improvement.setup import Stage
from cgtorch.improvement.team import (
    Candidate,
    StageState,
    learned,
)
from cgtorch.improvement.trial import attempt

DECISIVE = 30  # solved scenarios that tell whether success is chance
MOST_JUDGED = 100  # scenarios, evenly spread, that are met under other noise
SAME, CONFIDENCE = 0.8, 0.95
OTHER = 1000  # the number of the other noise
FIRST = 1.5  # episodes before a stage ends, as a multiple of those to solve in a row
LONG = 2.5  # successes, as the same multiple, after which half as many in a row are enough
BATCH = 3  # fresh scenarios of the first batch; later batches double


def acted(
    stage: Stage[S], state: StageState[S], candidate: Candidate, draw: Draw[S]
) -> tuple[StageState[S], bool]:
    """The state after a candidate acted in the world, and whether the stage is finished.

    In a world that repeats itself, the candidate does not replace the current skill if it loses
    some of W. Fresh scenarios follow until it fails or has solved enough of them in a row. Where
    trials take a robot's time, the models learn from successes, too, and may know a better skill
    before the next failure.
    """
    experience, done = list[Dataset](), False
    if state.repeats and candidate is not state.current:
        state = replace(state, in_a_row=0)
    try:
        state, lost = _on_known(stage, state, candidate, experience)
        size = BATCH if state.repeats else 1
        while not lost and (wanted := _wanted(stage, state) - state.in_a_row) > 0:
            if not state.repeats and len(experience) == REFLECT:
                break
            tests, fresh = len(state.waiting) > 0, state.waiting[:size]
            if not tests:
                fresh = draw(min(size, wanted), stage.generator)
            state = replace(state, waiting=state.waiting[size:])
            most = None if state.repeats else state.most
            trial = attempt(stage, candidate.skill, fresh, "practice", most)
            experience.append(trial.experience)
            rows = torch.arange(len(fresh)) + len(state.keep)
            state = state.extended(fresh, trial.percepts, targets=tests)
            state = state.after(candidate, rows, trial)
            if not trial.succeeded.all():
                state = replace(state, in_a_row=0)
                break
            size = 2 * size if state.repeats else 1
            state = replace(state, in_a_row=state.in_a_row + len(fresh))
        missed = state.repeats and bool((state.targets & ~state.keep).any())
        done = not lost and state.in_a_row >= _wanted(stage, state) and not missed
    except BudgetSpentError:
        done = True
        if not state.tried.any():  # the models have the last word, as the world has none
            thought = replace(state, current=candidate, repeats=False)
            state = replace(proposed(stage, thought)[1], repeats=state.repeats)
    stage.watch(Practised(stage.name, candidate.skill, state.in_a_row, _wanted(stage, state)))
    if experience and not (state.repeats and done):
        more = experience[0]
        for each in experience[1:]:
            more = more.extended(each)
        state = replace(state, knowledge=learned(stage, state.knowledge, more))
    return state, done


def _wanted(stage: Stage[S], state: StageState[S]) -> int:
    """The number of fresh scenarios to solve in a row, and the tests that still wait.

    Where nothing can be tried twice, a skill that nothing has corrected yet has to solve more, and
    after many successes half as many are enough.
    """
    share, practice = 1.0, stage.setup.practice
    if not state.repeats and int(state.tried.sum()) < FIRST * practice:
        share = FIRST
    elif not state.repeats and len(state.actions) >= LONG * practice:
        share = 0.5
    return max(int(share * practice), state.in_a_row + len(state.waiting))


def without_chance(stage: Stage[S], state: StageState[S]) -> StageState[S]:
    """The state, which does not count on repetition any more if what was solved is chance.

    Noise is part of a scenario, so a skill can be chosen for lucky numbers that nobody foresees.
    If under other noise it solves significantly less than `SAME` of what it has solved, a scenario
    that was solved is no fact.
    """
    setup, rows = stage.setup, state.keep.nonzero()[:, 0]
    if not (state.repeats and setup.noisy) or state.current is None or not len(rows):
        return state
    if len(rows) > MOST_JUDGED:
        rows = rows[torch.linspace(0, len(rows) - 1, MOST_JUDGED).long()]
    others = state.scenarios[rows].with_noise(OTHER)
    try:
        trial = attempt(stage, state.current.skill, others, "other noise")
    except BudgetSpentError:
        return state
    share = int(trial.succeeded.sum()), len(rows)
    state = replace(state, judged=state.current, other_noise=share)
    _, most = wilson(*share, CONFIDENCE)
    if most >= SAME or len(rows) < DECISIVE:
        return state
    stage.watch(ChanceFound(stage.name, *share))
    return replace(state, repeats=False)


def _on_known(
    stage: Stage[S], state: StageState[S], candidate: Candidate, experience: list[Dataset]
) -> tuple[StageState[S], bool]:
    """The state after a candidate met what has to be tried, and whether it lost some of W."""
    again = state.repeats and candidate is not state.current
    wanted = state.targets & ~state.tried
    rows = (wanted | state.tried if again else wanted).nonzero()[:, 0]
    if again and len(state.rest[0]):
        state, held = _on_rest(stage, state, candidate)
        if not held:
            return state, True
    if not len(rows):
        return replace(state, current=candidate), False
    most = None if state.repeats else state.most
    trial = attempt(stage, candidate.skill, state.scenarios[rows], "trials", most)
    experience.append(trial.experience)
    counts = solved_of(trial.succeeded, state.keep[rows])
    stage.watch(WorldTested(stage.name, candidate.skill.name, *counts))
    after = state.after(candidate, rows, trial)
    if again and bool((state.keep[rows] & ~trial.succeeded).any()):
        return _with_current(replace(state, trust=after.trust)), True
    return replace(after, current=candidate), False


def _on_rest(
    stage: Stage[S], state: StageState[S], candidate: Candidate
) -> tuple[StageState[S], bool]:
    """The state, and whether a candidate loses nothing of the rest of W; what it loses joins."""
    scenarios, percepts = state.rest
    held = attempt(stage, candidate.skill, scenarios, "trials").succeeded
    if not held.all():
        lost = percepts[~held]
        state = state.extended(scenarios[~held], lost, kept=True)
        state = _with_current(replace(state, rest=(scenarios[held], percepts[held])))
    return state, bool(held.all())


def _with_current(state: StageState[S]) -> StageState[S]:
    """The state with the skill that acts as a member, which solves all of W.

    Where gating networks over specialists lose some of W, they need to learn only what goes to
    somebody else.
    """
    skill = None if state.current is None else state.current.skill
    if skill is None or any(member is skill for member in state.members):
        return state
    trust = torch.cat([state.trust, torch.ones(len(state.trust), 1)], 1)
    return replace(state, members=(*state.members, skill), trust=trust)
