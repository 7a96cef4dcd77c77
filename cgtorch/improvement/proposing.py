"""The next skill to act in the world, thought out in the models."""

from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.graphs import same_behaviour
from cgtorch.improvement.acceptance import no_worse
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.setup import Stage
from cgtorch.improvement.team import (
    BLAME,
    RELIABLE,
    Candidate,
    StageState,
    composed,
    shares,
    with_member,
)

REFLECT = 8  # episodes after which the models learn, however well all went
THOUGHTS = 3  # candidates in the models before one acts, where trials take a robot's time
WORTH = 0.02  # share of replays that a candidate gains before a skill that does not fail gives way


def proposed(stage: Stage[S], state: StageState[S]) -> tuple[Candidate, StageState[S]]:
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
