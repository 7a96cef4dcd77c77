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

from cgtorch.environment import Dataset
from cgtorch.environment.asked import BudgetSpentError
from cgtorch.graphs import Skill, same_behaviour
from cgtorch.ground.interval import wilson
from cgtorch.improvement.acceptance import no_worse
from cgtorch.improvement.compose import specialists_of
from cgtorch.improvement.events import ChanceFound, Practised, SkillAccepted, WorldTested, solved_of
from cgtorch.improvement.grouping import cover
from cgtorch.improvement.interfaces import Draw, S
from cgtorch.improvement.setup import Progress, Stage
from cgtorch.improvement.team import (
    BLAME,
    RELIABLE,
    Candidate,
    StageState,
    composed,
    learned,
    shares,
    with_member,
)
from cgtorch.improvement.trial import attempt, looked

DECISIVE = 30  # solved scenarios that tell whether success is chance
MOST_JUDGED = 100  # scenarios, evenly spread, that are met under other noise
SAME, CONFIDENCE = 0.8, 0.95
OTHER = 1000  # the number of the other noise
FIRST = 1.5  # episodes before a stage ends, as a multiple of those to solve in a row
LONG = 2.5  # successes, as the same multiple, after which half as many in a row are enough
REFLECT = 8  # episodes after which the models learn, however well all went
IDLE = 6  # candidates in a row that solve nothing more, after which a stage ends
BATCH = 3  # fresh scenarios of the first batch; later batches double
THOUGHTS = 3  # candidates in the models before one acts, where trials take a robot's time
WORTH = 0.02  # share of replays that a candidate gains before a skill that does not fail gives way


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
        candidate, state = _proposed(stage, state)
        if done and candidate is before:
            break
        if done:  # the new one has to show some of it, too
            in_a_row = min(state.in_a_row, stage.setup.practice) - REFLECT
            state = replace(state, in_a_row=max(0, in_a_row))
        state, done = _acted(stage, state, candidate, draw)
        if state.judged is None and int(state.keep.sum()) >= DECISIVE:
            state = _without_chance(stage, state)
        accepted |= bool((state.keep & ~state.known).any())
        solved = int(state.keep[: len(first.keep)].sum()) if state.repeats else 0
        idle = 0 if solved > best[0] or state.in_a_row > best[1] else idle + 1
        best = max(best[0], solved), max(best[1], state.in_a_row)
        if stage.setup.purse.exhausted or (state.repeats and (done or idle == IDLE)):
            break
    if accepted and state.judged is not state.current:
        state = _without_chance(stage, state)
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


def _proposed(stage: Stage[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill to act next, and the state that knows the members it may have been made of.

    Where nothing repeats itself, it is the best of several candidates in the models.
    """
    candidate, state = _candidate(stage, state)
    if state.repeats:
        return candidate, state
    for _ in range(1, THOUGHTS):
        candidate, state = _candidate(stage, state.acting(candidate))
    return candidate, state.acting(candidate)


def _candidate(stage: Stage[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill that acts, or one that is better in the models."""
    state = replace(state, number=state.number + 1)
    rates = _rates(stage, state)
    missed = (rates < RELIABLE).all(1)
    if missed.any():
        state = with_member(stage, state, missed)
        rates = _rates(stage, state)
    best = rates[:, :-1].amax(1)
    old = rates[:, -1]
    if state.current is not None and bool((old >= torch.minimum(best, _RELIABLE)).all()):
        return state.current, state
    new = composed(stage, state, rates[:, :-1])
    if state.current is None:
        return new, state
    if same_behaviour(new.skill, state.current.skill):
        return state.current, state
    now = shares(stage, state, [state.current.skill, new.skill])
    # What the world has shown of it, the models may not know.
    now[state.shown < 0, 0] *= 0.0 if state.repeats else BLAME
    gain = 0.0
    if not state.repeats:  # else the world has the last word on W
        now[state.shown > 0, 0] = now[state.shown > 0, 0].clamp(min=RELIABLE)
        gain = WORTH if state.in_a_row >= REFLECT else 0.0
    better = no_worse(now[:, 0], now[:, 1], state.keep, gain)
    return (new if better else state.current), state


_RELIABLE = torch.tensor(RELIABLE)


def _rates(stage: Stage[S], state: StageState[S]) -> Tensor:
    """(B, M + 1) how surely members, and last the current skill, solve each scenario.

    These are shares of replays in the models, corrected by what has happened in the world.
    """
    current = state.current
    skills = [*state.members, *([] if current is None else [current.skill])]
    rates = shares(stage, state, skills)
    if current is None:
        rates = torch.cat([rates, torch.zeros(len(rates), 1)], 1)
    rates[:, :-1] *= state.trust
    rates[state.shown < 0, -1] = 0.0
    if state.repeats:
        rates[state.keep, -1] = 1.0
        if current is not None:
            sent = current.sent_to(state.percepts)
            sure = (state.keep & (sent >= 0)).nonzero()[:, 0]
            rates[sure, sent[sure]] = 1.0
            for i, member in enumerate(state.members):
                if member is current.skill:
                    rates[:, i] = rates[:, -1]
    return rates


def _acted(
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
            state = replace(_proposed(stage, thought)[1], repeats=state.repeats)
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


def _without_chance(stage: Stage[S], state: StageState[S]) -> StageState[S]:
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
