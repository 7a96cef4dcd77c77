"""The team of skills that a composed skill branches to, and the next skill to act in the world.

The models tell how well members do, what specialist is missing, and whether a candidate is better.
"""

import time
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from cgtorch.evolution import join
from cgtorch.graphs import Skill, merged, same_behaviour
from cgtorch.ground.environment import Dataset
from cgtorch.improvement.compose import branching_action, compose, fewest_members
from cgtorch.improvement.events import ModelsFitted, S
from cgtorch.improvement.gating import train_gating
from cgtorch.improvement.outcomes import (
    decisive,
    estimated_rates,
    expected,
    known_rates,
    near_by,
    tried,
)
from cgtorch.improvement.setup import Models, Setup
from cgtorch.improvement.specialists import specialist
from cgtorch.improvement.state import BLAME, Candidate, StageState
from cgtorch.simulation import rollout

RELIABLE = 0.9  # share of replays from which a skill counts as solving a scenario
FEWEST = 4  # missed scenarios, to which solved ones are added for a group
DECIDES = 30.0  # weight of a scenario where the wrong member is known to fail
OTHERS = 8  # solved scenarios that are added
REFLECT = 8  # episodes after which the models learn, however well all went
THOUGHTS = 3  # candidates in the models before one acts, where trials take a robot's time
WORTH = 0.02  # least share of replays by which a candidate replaces a skill that does not fail
ERRORS = 2.0  # standard errors by which a candidate may be worse on W
MOST_WORSE = 0.05  # share of replays by which it may be worse, however few there are
CLEAR = 0.7  # standard errors by which it has to be better on all scenarios together


def shares(setup: Setup[S], state: StageState[S], skills: list[Skill]) -> Tensor:
    """(B, K) share of replays in the models in which each of K skills solves each scenario.

    All skills meet the same errors of Γ, so differences between them are differences of pairs. A
    replay is broken off about where a trial in the world would be.
    """
    count = len(state.percepts)
    if not skills:
        return torch.empty(count, 0)
    about = state.knowledge, state.scenarios, state.percepts, setup.replays
    environment = setup.imagine(*about, setup.generator, "cpu")
    found, steps = [], None if state.repeats else state.most_steps
    with torch.no_grad():
        for skill in skills:
            who, most = (skill.graph, skill.actions), skill.max_transitions
            runs = rollout(*who, environment, max_transitions=most, max_steps=steps)
            found.append(runs.succeeded[0].view(count, setup.replays).float().mean(1))
    return torch.stack(found, 1)


def proposed(setup: Setup[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill to act next, and the state that knows the members it may have been made of.

    Where nothing repeats itself, it is the best of several candidates in the models.
    """
    candidate, state = _candidate(setup, state)
    if state.repeats:
        return candidate, state
    for _ in range(1, THOUGHTS):
        candidate, state = _candidate(setup, state.acting(candidate))
    return candidate, state.acting(candidate)


def _candidate(setup: Setup[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
    """The skill that acts, or one that is better in the models."""
    state = replace(state, number=state.number + 1)
    if setup.remembers:
        state = tried(setup, state, range(len(state.members)))
    rates = _rates(setup, state)
    missed = (rates < RELIABLE).all(1)
    if missed.any():
        state = with_member(setup, state, missed)
        if setup.remembers:
            state = tried(setup, state, range(len(state.members))[-1:])
        rates = _rates(setup, state)
    best, current = rates[:, :-1].amax(1), state.current
    if current is not None and bool((rates[:, -1] >= best.clamp(max=RELIABLE)).all()):
        return current, state
    if setup.remembers:
        rates = pad(estimated_rates(state, RELIABLE), (0, 1))
    new = composed(setup, state, rates[:, :-1])
    if setup.remembers and (longer := extended(setup, state, rates[:, :-1])):
        new = min(new, longer, key=lambda each: _losses(state, each))
    if current is None:
        return new, state
    if same_behaviour(new.skill, current.skill):
        return current, state
    if setup.remembers:
        now, then = expected(state, new).unbind(1)
        better = no_worse(now, then, state.keep)
        return (new if better else current), state
    now = shares(setup, state, [current.skill, new.skill])
    # The models may not know the failures that the world has shown.
    now[state.shown < 0, 0] *= 0.0 if state.repeats else BLAME
    gain = 0.0
    if not state.repeats:  # else the world decides on W
        now[state.shown > 0, 0] = now[state.shown > 0, 0].clamp(min=RELIABLE)
        gain = WORTH if state.in_a_row >= REFLECT else 0.0
    better = no_worse(now[:, 0], now[:, 1], state.keep, gain)
    return (new if better else current), state


def _rates(setup: Setup[S], state: StageState[S]) -> Tensor:
    """(B, M + 1) how surely members, and last the current skill, solve each scenario.

    These are shares of replays in the models, corrected by what has happened in the world; without
    models, they are what has happened.
    """
    if setup.remembers:
        return known_rates(state)
    current, members = state.current, list(state.members)
    if current is None:
        rates = pad(shares(setup, state, members), (0, 1))
    else:
        rates = shares(setup, state, [*members, current.skill])
    rates[:, :-1] *= state.trust
    rates[state.shown < 0, -1] = 0.0
    if not state.repeats:
        return rates
    rates[state.keep, -1] = 1.0
    if current is not None:
        sent = current.sent_to(state.percepts)
        sure = (state.keep & (sent >= 0)).nonzero()[:, 0]
        rates[sure, sent[sure]] = 1.0
        same = [i for i, member in enumerate(members) if member is current.skill]
        rates[:, same] = rates[:, -1:]
    return rates


def with_member(setup: Setup[S], state: StageState[S], missed: Tensor) -> StageState[S]:
    """The state with a specialist evolved in the models on `missed` (B,) scenarios."""
    name = f"{setup.name}.{state.number}"
    most = max(setup.group, setup.widest)
    rows = setup.group_of(state.percepts, missed, most, setup.generator)
    if setup.remembers:
        solved = (~missed).nonzero()[:, 0]
        near = near_by(state, rows, solved, min(OTHERS, most - len(rows)))
        # In turns, one is sought that solves what is missed, and one that loses nothing near it.
        rows = torch.cat([rows, near] if state.number % 2 else [near, rows])
    elif len(rows) < FEWEST:
        solved = (~missed).nonzero()[:, 0]
        some = torch.randperm(len(solved), generator=setup.generator)[:OTHERS]
        rows = torch.cat([rows, solved[some]])
    about = state.knowledge, state.scenarios[rows], state.percepts[rows], state.population
    champion, solved = specialist(setup, name, *about)
    graphs = join(state.population, champion) if state.population else champion
    member = Skill(name, merged(champion.graphs), setup.actions, setup.max_transitions)
    state = replace(state, population=graphs).joined_by(member)
    if not setup.remembers:
        return state
    return state.learned(len(state.members) - 1, rows[: len(solved)], solved)


def no_worse(old: Tensor, new: Tensor, keep: Tensor, gain: float = 0.0) -> bool:
    """Whether a candidate is not worse on W and better elsewhere, by shares (B,) of replays.

    Both skills meet the same errors of Γ, so the differences on W (`keep` (B,) bool) are those of
    pairs. Their mean may be at most `ERRORS` standard errors below 0, and at most `MOST_WORSE`. On
    all scenarios together the candidate has to be better by `CLEAR` standard errors, and by `gain`.
    """
    change = new - old
    inside, outside = change[keep], change[~keep]
    if len(inside):
        slack = ERRORS * float(inside.std(correction=0)) / len(inside) ** 0.5
        if float(inside.mean()) < -min(slack, MOST_WORSE) - 1e-6:
            return False
    clear = CLEAR * float(change.std(correction=0)) / len(change) ** 0.5
    return float(outside.sum()) > 0 and float(change.mean()) > max(clear, gain)


def composed(setup: Setup[S], state: StageState[S], rates: Tensor) -> Candidate:
    """The smallest team that solves what its members solve, given their shares (B, M)."""
    chosen = fewest_members(rates >= RELIABLE, setup.team) or [int(rates.mean(0).argmax())]
    return _branching(setup, state, chosen, _trained(setup, state, rates[:, chosen]))


def extended(setup: Setup[S], state: StageState[S], rates: Tensor) -> Candidate | None:
    """The skill that acts, which branches to further members before it branches to its own.

    Its own branches stay as they are, so W can only be lost by the new ones. The members' shares
    are (B, M). None if no other member solves more, or if the branches of the skill are not known.
    """
    current = state.current
    if current is None or current.branches is None:
        return None
    held = known_rates(state)[:, -1:]
    more = (rates >= RELIABLE) & (held == 0)
    more[:, list(current.chosen)] = False
    first = fewest_members(more, setup.team - len(current.chosen))
    if not first:
        return None
    new = _trained(setup, state, torch.cat([rates[:, first], held], 1))
    branches = torch.stack([*new, *current.branches])
    return _branching(setup, state, [*first, *current.chosen], branches)


def _losses(state: StageState[S], candidate: Candidate) -> tuple[float, float]:
    """What a candidate loses of W as far as is known, and what it does not solve elsewhere."""
    fails = 1 - expected(state, candidate)[:, 1]
    return float(fails[state.keep].sum()), float(fails.sum())


def _trained(setup: Setup[S], state: StageState[S], rates: Tensor) -> Tensor:
    """(M - 1, K) parameters that send scenarios to those of M who solve them, by rates (B, M)."""
    _, branch = branching_action(setup.actions)
    weight = torch.where(state.tried | state.targets, 3.0, 1.0)
    if setup.remembers:
        weight[decisive(state)] = DECIDES
    return train_gating(branch, state.percepts, rates, weight, setup.generator)


def _branching(
    setup: Setup[S], state: StageState[S], chosen: list[int], branches: Tensor
) -> Candidate:
    """The skill that branches to the `chosen` members by parameters (M - 1, K)."""
    name, members = f"{setup.name}-{state.number}", [state.members[i] for i in chosen]
    about = branches, setup.actions, setup.max_transitions
    skill = compose(name, members, *about, corrected=not setup.remembers)
    return Candidate(skill, tuple(chosen), branches)


def learned(setup: Setup[Any], models: Models, experience: Dataset) -> Models:
    """The models after learning from experience; unchanged if nothing learns."""
    if setup.learn is None:
        return models
    began = time.perf_counter()
    models = setup.learn(models, experience, setup.generator)
    summary = replace(setup.describe(models), first=False)
    setup.watch(ModelsFitted(setup.name, summary, time.perf_counter() - began))
    return models
