"""Algorithm 1: a new skill that forgets nothing and solves something new.

Growing one graph with W as a hard constraint stalls. So by default specialists are evolved on
groups of missed scenarios, and branching nodes, trained by gradient, send each scenario to a member
that solves it. `cgtorch.improvement.grow` is the paper's method.
"""

import time
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.improvement.events import SkillAccepted, WorldTested, solved_of
from cgtorch.improvement.grouping import cover
from cgtorch.improvement.interfaces import Draw, S
from cgtorch.improvement.setup import Progress, Stage
from cgtorch.improvement.team import (
    StageState,
    compose_team,
    initial_state,
    recruit,
    try_all,
    with_fresh,
)
from cgtorch.improvement.trial import attempt, first_percepts

CHECKS = 8  # on all of W, before a team is given up


def improve(
    stage: Stage[S], progress: Progress[S], scenarios: S, targets: Tensor, draw: Draw[S]
) -> Progress[S]:
    """Evolve specialists, compose them, and repeat with what fails on fresh scenarios.

    Args:
        stage: What the stage works with.
        progress: The result of earlier stages.
        scenarios: B scenarios to solve.
        targets: (B,) bool, the stage's own test scenarios.
        draw: Draws fresh scenarios.

    Returns:
        The new skill with what it solves and misses; the old one if eq. 1 could not be met.
    """
    began = time.perf_counter()
    state, accepted = _begun(stage, progress, scenarios, targets), None
    for _ in range(stage.setup.rounds):
        state, composed = _recruit_and_compose(stage, state, progress)
        if composed is None:
            break
        skill, succeeded = composed
        _report_accepted(stage, state, skill, succeeded, time.perf_counter() - began)
        state, tested = _tested_on_fresh(stage, state, draw, skill, succeeded)
        # A further try that fails moves parts of the rest of W into its scenarios.
        accepted = skill, state
        if state.keep.all() or not tested:
            break
    progress = replace(progress, knowledge=state.knowledge, specialists=state.population)
    if accepted is None:
        return progress
    skill, state = accepted
    return replace(
        progress,
        skill=skill,
        solved=state.scenarios[state.keep].joined(state.rest),
        missed=state.scenarios[~state.keep],
    )


def _recruit_and_compose(
    stage: Stage[S], state: StageState[S], progress: Progress[S]
) -> tuple[StageState[S], tuple[Skill, Tensor] | None]:
    """The result of `_compose` with as many new members as it needs."""
    state, composed = _compose(stage, _recruit_all(stage, state), progress)
    if composed is None and state.tried < stage.setup.attempts and not state.keep.all():
        # Where no branches could tell the members apart, one more makes that easier: for all that
        # the earlier skill misses, whoever else solves it.
        state = recruit(stage, state, ~state.keep)
        state, composed = _compose(stage, state, progress)
    return state, composed


def _tested_on_fresh(
    stage: Stage[S], state: StageState[S], draw: Draw[S], skill: Skill, succeeded: Tensor
) -> tuple[StageState[S], int]:
    """The state after a skill was tried on fresh scenarios, and their number.

    They are drawn in batches until the skill fails in one, or until it has solved all of
    `Setup.clean_batches`. Members are tried on what failed only: what the skill solves joins the
    rest of W.
    """
    setup, state, tested = stage.setup, replace(state, keep=succeeded), 0
    for _ in range(setup.clean_batches):
        fresh = draw(stage.generator)
        held = attempt(setup, skill, fresh).succeeded
        state, tested = replace(state, rest=state.rest.joined(fresh[held])), tested + len(fresh)
        if not held.all():
            failed = torch.zeros(int((~held).sum()), dtype=torch.bool)
            keep = torch.cat([state.keep, failed])
            return with_fresh(setup, state, keep, fresh[~held]), tested
        if not tested:
            break
    return state, tested


def _begun(stage: Stage[S], progress: Progress[S], scenarios: S, targets: Tensor) -> StageState[S]:
    """The first state, with a coreset of W, the rest of W, and the earlier skill."""
    setup, solved = stage.setup, progress.solved
    rows, _ = cover(first_percepts(setup.world_of(solved)), setup.core)
    kept = torch.zeros(len(solved), dtype=torch.bool)
    kept[rows] = True
    start = replace(progress, solved=solved[rows])
    state = initial_state(stage, start, scenarios, targets)
    state = replace(state, rest=solved[~kept])
    if progress.skill is None:
        return state
    rate = state.keep.float()  # W is what the earlier skill succeeds on
    rate[~state.keep], _ = try_all(setup, progress.skill, state.scenarios[~state.keep])
    rates = [rate, *(try_all(setup, m, state.scenarios)[0] for m in progress.members)]
    members = (progress.skill, *progress.members)
    return replace(state, members=members, rates=torch.stack(rates, 1))


def _compose(
    stage: Stage[S], state: StageState[S], progress: Progress[S]
) -> tuple[StageState[S], tuple[Skill, Tensor] | None]:
    """The result of `compose_team` if it loses nothing of the rest of W; otherwise None for it.

    Lost scenarios of the rest join the scenarios of the state, and another team is composed.
    """
    for _ in range(CHECKS):
        composed = compose_team(stage, state, progress)
        if composed is None or not len(state.rest):
            return state, composed
        held = attempt(stage.setup, composed[0], state.rest).succeeded
        if held.all():
            return state, composed
        _report_lost(stage, state, composed[1], held)
        keep = torch.cat([state.keep, torch.ones(int((~held).sum()), dtype=torch.bool)])
        state = with_fresh(stage.setup, state, keep, state.rest[~held])
        state = replace(state, rest=state.rest[held])
    return state, None


def _report_accepted(
    stage: Stage[S], state: StageState[S], skill: Skill, succeeded: Tensor, seconds: float
) -> None:
    """Report a skill that solves `succeeded` (B,) of the state's scenarios, and all of the rest."""
    yes = torch.ones(len(state.rest), dtype=torch.bool)
    event = SkillAccepted(
        stage.name,
        skill,
        state.scenarios.joined(state.rest),
        torch.cat([succeeded, yes]),
        torch.cat([state.keep, yes]),
        torch.cat([state.targets, ~yes]),
        seconds,
    )
    stage.watch(event)


def _report_lost(stage: Stage[S], state: StageState[S], succeeded: Tensor, held: Tensor) -> None:
    """Report a composed skill that loses some of the rest of W, of which it solves `held` (R,)."""
    solved, keep = torch.cat([succeeded, held]), torch.cat([state.keep, torch.ones_like(held)])
    stage.watch(WorldTested(stage.name, stage.name, *solved_of(solved, keep)))


def _recruit_all(stage: Stage[S], state: StageState[S]) -> StageState[S]:
    """Recruit until each scenario has a member that always solves it, or no progress is made."""
    idle = 0
    while state.tried < stage.setup.attempts and idle < stage.setup.idle:
        missed = (state.rates < 1).all(1)
        if not missed.any():
            break
        size = len(state.members)
        state = recruit(stage, state, missed)
        idle = 0 if len(state.members) > size else idle + 1
    return state
