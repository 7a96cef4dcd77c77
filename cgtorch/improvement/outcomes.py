"""What members solve, where it is remembered: in a world that repeats itself, without models.

There, a replay is a trial. So none is made twice: members are tried on one scenario before on many,
and W is tried again only where a candidate takes another way than one that is known to succeed.
"""

from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor

from cgtorch.improvement.compose import branches_of
from cgtorch.improvement.events import S
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.state import Candidate, StageState
from cgtorch.improvement.trial import attempt

NEIGHBOURS = 6


def known_rates(state: StageState[S]) -> Tensor:
    """(B, M + 1) 1 where a member, and last the current skill, is known to solve a scenario."""
    solved = (state.outcomes > 0).float()
    current = (state.keep & (state.shown >= 0)).float()
    if state.current is not None:
        current = torch.maximum(current, (surely(state, state.current) > 0).float())
    return torch.cat([solved, current[:, None]], 1)


def estimated_rates(state: StageState[S], reliable: float) -> Tensor:
    """(B, M) how surely members solve scenarios: 1 or 0 where that is known.

    Elsewhere a member counts as `reliable` if, among the `NEIGHBOURS` nearest scenarios by first
    percepts, it is known to solve some and to fail on none.
    """
    distance = torch.cdist(state.percepts, state.percepts)
    near = distance.topk(min(NEIGHBOURS, len(distance)), largest=False).indices
    around = state.outcomes[near]
    promising = (around > 0).any(1) & ~(around < 0).any(1)
    rates = torch.where(promising, reliable, 0.0)
    return torch.where(state.outcomes == 0, rates, (state.outcomes > 0).float())


def decisive(state: StageState[S]) -> Tensor:
    """(B,) bool, where one member is known to succeed and another to fail."""
    return (state.outcomes > 0).any(1) & (state.outcomes < 0).any(1)


def near_by(state: StageState[S], rows: Tensor, among: Tensor, count: int) -> Tensor:
    """`count` indices of those `among` (N,) whose first percepts are nearest to some of `rows`."""
    distance = torch.cdist(state.percepts[among], state.percepts[rows]).amin(1)
    return among[distance.argsort(stable=True)[:count]]


def surely(state: StageState[S], candidate: Candidate) -> Tensor:
    """(B,) long, 1 or -1 where the result of a candidate is known, else 0."""
    sent = candidate.sent_to(state.percepts)
    known = torch.zeros_like(state.shown)
    rows = (sent >= 0).nonzero()[:, 0]
    known[rows] = state.outcomes[rows, sent[rows]]
    return known


def expected(state: StageState[S], new: Candidate) -> Tensor:
    """(B, 2) 1 where the current skill, and a new one, solve a scenario as far as is known.

    Where the result of the new one is not known, it is taken to be equal.
    """
    now, then = known_rates(state)[:, -1], surely(state, new)
    return torch.stack([now, torch.where(then == 0, now, (then > 0).to(now))], 1)


def tried(setup: Setup[S], state: StageState[S], places: Iterable[int]) -> StageState[S]:
    """The state after the members at `places` met scenarios that none is known to solve.

    Each meets one, then more and more, until it fails on some.
    """
    for place in places:
        most = 1
        while True:
            missed = ~(state.outcomes > 0).any(1) & (state.outcomes[:, place] == 0)
            rows = missed.nonzero()[:most, 0]
            if not len(rows):
                break
            scenarios = state.scenarios[rows]
            succeeded = attempt(setup, state.members[place], scenarios, "trials").succeeded
            state = state.learned(place, rows, succeeded)
            if not succeeded.all():
                break
            most *= 2
    return state


def begun(state: StageState[S]) -> StageState[S]:
    """The state at the start of a stage, in which it is known who has solved W, and missed M."""
    if state.current is None:
        return state
    skill, names = state.current.skill, [member.name for member in state.members]
    found = branches_of(skill)
    chosen = (0,) if found is None else tuple(names.index(name) for name in found[0])
    branches = torch.empty(0, 0) if found is None else found[1]
    current = Candidate(skill, chosen, branches)
    sent, outcomes = current.sent_to(state.percepts), state.outcomes.clone()
    rows = state.shown.nonzero()[:, 0]
    outcomes[rows, sent[rows]] = state.shown[rows]
    return replace(state, current=current, outcomes=outcomes)
