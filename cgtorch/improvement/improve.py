"""Algorithm 1 as a loop of improving, acting and learning.

A candidate is evolved and judged in Γ and C, where that costs nothing. Then it acts in the world:
on the stage's tests, on W and M if the world repeats itself, and on fresh scenarios until it has
solved `Setup.practice` of them in a row. Every trial becomes data for Γ and C, and what failed is
where the next member is evolved. `cgtorch.improvement.grow` is the paper's method.
"""

import time
from dataclasses import replace
from functools import reduce

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.graphs import Skill
from cgtorch.ground.asked import BudgetSpentError
from cgtorch.ground.environment import Dataset
from cgtorch.ground.statistics import wilson
from cgtorch.improvement.compose import cover, specialists_of
from cgtorch.improvement.events import (
    ChanceFound,
    Practised,
    S,
    SkillAccepted,
    WorldTested,
    solved_of,
)
from cgtorch.improvement.outcomes import begun, surely
from cgtorch.improvement.setup import Draw, Progress, Setup
from cgtorch.improvement.state import Candidate, StageState
from cgtorch.improvement.team import REFLECT, learned, proposed
from cgtorch.improvement.trial import Trial, attempt, looked

IDLE = 6  # candidates in a row that solve nothing more, after which a stage ends
DECISIVE = 30  # solved scenarios that tell whether success is chance
MOST_JUDGED = 100  # scenarios, evenly spread, that are met under other noise
SAME, CONFIDENCE = 0.8, 0.95
OTHER = 1000  # the number of the other noise
FIRST = 1.5  # episodes before a stage ends, as a multiple of those to solve in a row
LONG = 2.5  # successes, as the same multiple, after which half as many in a row are enough
BATCH = 3  # fresh scenarios of the first batch; later batches double
LARGEST = 12  # batch where rollouts take time, since a whole one is met at a failure


def improve(setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]) -> Progress[S]:
    """Act, learn and improve until fresh scenarios are solved in a row, or the budget is spent.

    Args:
        setup: The inputs of the stage.
        progress: The result of earlier stages.
        tests: The stage's own test scenarios, which are tried first.
        draw: Draws fresh scenarios.

    Returns:
        The new skill with what it solves and misses; the old one if eq. 1 could not be met.
    """
    if setup.remembers and len(progress.missed):  # which a stage that comes back draws anew
        return _without_missed(setup, progress, tests, draw)
    began = time.perf_counter()
    try:
        state = _begun(setup, progress, tests, draw)
        state = begun(state) if setup.remembers else state
    except BudgetSpentError:
        return progress
    if not len(state.scenarios):  # so nothing can be evolved
        return progress
    first, accepted, best, idle, done = state, False, (0, 0), 0, False
    for _ in range(setup.attempts):
        before = state.current
        try:
            candidate, state = proposed(setup, state)
        except BudgetSpentError:  # when the time is over
            setup.purse.exhausted = True
            break
        if done and candidate is before:
            break
        if done:  # the new one has to show some of it, too
            in_a_row = min(state.in_a_row, setup.practice) - REFLECT
            state = replace(state, in_a_row=max(0, in_a_row))
        state, done = acted(setup, state, candidate, draw)
        if state.judged is None and int(state.keep.sum()) >= DECISIVE:
            state = without_chance(setup, state)
        accepted |= bool((state.keep & ~state.known).any())
        solved = int(state.keep[: len(first.keep)].sum())
        idle = 0 if solved > best[0] or state.in_a_row > best[1] else idle + 1
        best = max(best[0], solved), max(best[1], state.in_a_row)
        if state.repeats != first.repeats:  # means are compared from now on
            break
        if setup.purse.exhausted or (state.repeats and (done or idle == IDLE)):
            break
    if accepted and state.judged is not state.current:
        state = without_chance(setup, state)
    chance = progress.chance or state.repeats != setup.repeats
    about = {"knowledge": state.knowledge, "specialists": state.population, "chance": chance}
    progress = replace(progress, **about)
    if state.current is None:
        return progress
    old = state.current.skill
    skill = Skill(setup.name, old.graph, old.actions, old.max_transitions)
    spent = setup.purse.exhausted and not setup.purse.late()  # else the search can go on
    if progress.skill is None and spent and not state.tried.any():
        return replace(progress, skill=skill)
    if not accepted:
        return progress
    parent = None if progress.skill is None else progress.skill.name
    _report_accepted(setup, state, skill, time.perf_counter() - began, parent)
    (rest, seen), scenarios, percepts = state.rest, state.scenarios, state.percepts
    good, bad = state.tried & state.keep, state.tried & ~state.keep
    return replace(
        progress,
        skill=skill,
        solved=scenarios[good].joined(rest),
        missed=scenarios[bad],
        seen=torch.cat([percepts[good], seen, percepts[bad]]),
    )


def _without_missed(setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]) -> Progress[S]:
    """The result of a stage that leaves what earlier ones missed aside, and hands it on."""
    solved, missed, seen = len(progress.solved), progress.missed, progress.seen
    assert seen is not None  # noqa: S101  as something was missed
    few = replace(progress, missed=missed[:0], seen=seen[:solved])
    after = improve(setup, few, tests, draw)
    assert after.seen is not None  # noqa: S101  as `few` has some
    both = after.missed.joined(missed)
    return replace(after, missed=both, seen=torch.cat([after.seen, seen[solved:]]))


def _begun(setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]) -> StageState[S]:
    """A coreset of W, the tests, M, and first percepts to practise on in the models."""
    solved, missed = progress.solved, progress.missed
    repeats = setup.repeats and not progress.chance
    waiting, tests = (tests[:0], tests) if repeats else (tests, tests[:0])
    looks, seen = _looks(setup, progress, tests, draw)
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
        outcomes=torch.zeros(sum(sizes), len(members), dtype=torch.long),
        population=progress.specialists,
        current=None if skill is None else Candidate(skill),
        repeats=repeats,
    )


def _looks(setup: Setup[S], progress: Progress[S], tests: S, draw: Draw[S]) -> tuple[S, Tensor]:
    """Fresh scenarios to practise on in the models, and first percepts of the tests and of these.

    Percepts of the data stand for looks of a robot, which would need a scene for each, and for
    those that the budget does not cover. BudgetSpentError if the tests need some.
    """
    if not setup.live:
        looks = draw(setup.looks, setup.generator)
        try:
            return looks, looked(setup, tests.joined(looks))
        except BudgetSpentError:
            if len(tests) or setup.learn is None:
                raise
    seen = progress.knowledge.dataset.percept[: setup.looks]
    return draw(len(seen), setup.generator), seen


def _report_accepted(
    setup: Setup[S], state: StageState[S], skill: Skill, seconds: float, parent: str | None
) -> None:
    """Report the new skill with its result on all scenarios that were tried, and on the rest."""
    rows, rest = state.tried, state.rest[0]
    keep, known, targets = (
        pad(column[rows], (0, len(rest)), value=value)
        for column, value in ((state.keep, 1), (state.known, 1), (state.targets, 0))
    )
    noise = state.other_noise if state.judged is state.current else None
    about = state.scenarios[rows].joined(rest), keep, known, targets, seconds, noise, parent
    setup.watch(SkillAccepted(setup.name, skill, *about))


def acted(
    setup: Setup[S], state: StageState[S], candidate: Candidate, draw: Draw[S]
) -> tuple[StageState[S], bool]:
    """The state after a candidate acted in the world, and whether the stage is finished.

    In a world that repeats itself, the candidate does not replace the current skill if it loses
    some of W. Fresh scenarios follow until it fails or has solved enough of them in a row. In any
    other world, the models learn after `REFLECT` episodes even if all succeeded.
    """
    experience, done = list[Dataset](), False
    if state.repeats and candidate is not state.current:
        state = replace(state, in_a_row=0)
    try:
        state, lost = _on_known(setup, state, candidate, experience)
        size = BATCH if state.repeats else 1
        while not lost and (wanted := _wanted(setup, state) - state.in_a_row) > 0:
            if not state.repeats and len(experience) == REFLECT:
                break
            tests, fresh = len(state.waiting) > 0, state.waiting[:size]
            if not tests:
                fresh = draw(min(size, wanted), setup.generator)
            state = replace(state, waiting=state.waiting[size:])
            most = None if state.repeats else state.most
            trial = attempt(setup, candidate.skill, fresh, "practice", most)
            experience.append(trial.experience)
            rows = torch.arange(len(fresh)) + len(state.keep)
            state = state.extended(fresh, trial.percepts, targets=tests)
            state = state.after(candidate, rows, *results(trial))
            if not trial.succeeded.all():
                state = replace(state, in_a_row=0)
                break
            size = 2 * size if state.repeats else 1
            size = min(size, LARGEST) if setup.remembers else size
            state = replace(state, in_a_row=state.in_a_row + len(fresh))
        missed = state.repeats and bool((state.targets & ~state.keep).any())
        done = not lost and state.in_a_row >= _wanted(setup, state) and not missed
    except BudgetSpentError:
        done = True
        if not state.tried.any():  # the models decide, as the world is not asked again
            thought = replace(state, current=candidate, repeats=False)
            state = replace(proposed(setup, thought)[1], repeats=state.repeats)
    setup.watch(Practised(setup.name, candidate.skill, state.in_a_row, _wanted(setup, state)))
    if experience and not (state.repeats and done):
        more = reduce(Dataset.extended, experience)
        state = replace(state, knowledge=learned(setup, state.knowledge, more))
    return state, done


def _wanted(setup: Setup[S], state: StageState[S]) -> int:
    """The number of fresh scenarios to solve in a row, and the tests that still wait.

    Where nothing can be tried twice, a skill that nothing has corrected yet has to solve more, and
    after many successes half as many are enough.
    """
    share, practice = 1.0, setup.practice
    if not state.repeats and int(state.tried.sum()) < FIRST * practice:
        share = FIRST
    elif not state.repeats and len(state.actions) >= LONG * practice:
        share = 0.5
    return max(int(share * practice), state.in_a_row + len(state.waiting))


def without_chance(setup: Setup[S], state: StageState[S]) -> StageState[S]:
    """The state, which does not count on repetition any more if what was solved is chance.

    It is if under other noise the skill solves significantly less than `SAME` of it.
    """
    rows = state.keep.nonzero()[:, 0]
    if not (state.repeats and setup.noisy) or state.current is None or not len(rows):
        return state
    if len(rows) > MOST_JUDGED:
        rows = rows[torch.linspace(0, len(rows) - 1, MOST_JUDGED).long()]
    others = state.scenarios[rows].with_noise(OTHER)
    try:
        trial = attempt(setup, state.current.skill, others, "other noise")
    except BudgetSpentError:
        return state
    share = int(trial.succeeded.sum()), len(rows)
    state = replace(state, judged=state.current, other_noise=share)
    _, most = wilson(*share, CONFIDENCE)
    if most >= SAME or len(rows) < DECISIVE:
        return state
    setup.watch(ChanceFound(setup.name, *share))
    return replace(state, repeats=False)


def _on_known(
    setup: Setup[S], state: StageState[S], candidate: Candidate, experience: list[Dataset]
) -> tuple[StageState[S], bool]:
    """The state after a candidate met what has to be tried, and whether it lost some of W."""
    again = state.repeats and candidate is not state.current
    wanted = state.targets & ~state.tried
    rows = (wanted | state.tried if again else wanted).nonzero()[:, 0]
    if again and len(state.rest[0]):
        state, held = _on_rest(setup, state, candidate)
        if not held:
            return state, True
    if not len(rows):
        return replace(state, current=candidate), False
    most = None if state.repeats else state.most
    known = surely(state, candidate)[rows] * setup.remembers
    new = (known == 0).nonzero()[:, 0]
    succeeded, actions = known > 0, torch.empty(0, dtype=torch.long)
    if len(new):
        trial = attempt(setup, candidate.skill, state.scenarios[rows[new]], "trials", most)
        experience.append(trial.experience)
        succeeded[new], actions = results(trial)
    counts = solved_of(succeeded, state.keep[rows])
    setup.watch(WorldTested(setup.name, candidate.skill.name, *counts))
    after = state.after(candidate, rows, succeeded, actions)
    if again and bool((state.keep[rows] & ~succeeded).any()):
        state = replace(state, trust=after.trust, outcomes=after.outcomes)
        return state if setup.remembers else _with_current(state), True
    return replace(after, current=candidate), False


def results(trial: Trial) -> tuple[Tensor, Tensor]:
    """Whether a trial succeeded (B,), and the world actions of its successes."""
    return trial.succeeded, trial.actions[trial.succeeded]


def _on_rest(
    setup: Setup[S], state: StageState[S], candidate: Candidate
) -> tuple[StageState[S], bool]:
    """The state, with lost scenarios of the rest of W among the first, and whether none is lost."""
    scenarios, percepts = state.rest
    held = attempt(setup, candidate.skill, scenarios, "trials").succeeded
    if not held.all():
        lost = percepts[~held]
        state = state.extended(scenarios[~held], lost, kept=True)
        state = _with_current(replace(state, rest=(scenarios[held], percepts[held])))
    return state, bool(held.all())


def _with_current(state: StageState[S]) -> StageState[S]:
    """The state with the skill that acts, which solves all of W, as a member."""
    current = state.current
    if current is None or any(member is current.skill for member in state.members):
        return state
    return state.joined_by(current.skill)
