"""When a candidate replaces the skill that acts, judged by replays in Γ and C, and by counts.

In a world that repeats itself, eq. 1 is exact: a candidate has to solve all of W in the world. In
any other world a scenario cannot be tried again, so W and M are replayed in the models.
"""

from torch import Tensor

ERRORS = 2.0  # standard errors by which a candidate may be worse on W
MOST = 0.05  # share of replays by which it may be worse, however few there are
CLEAR = 0.7  # standard errors by which it has to be better on all scenarios together


def no_worse(old: Tensor, new: Tensor, keep: Tensor, gain: float = 0.0) -> bool:
    """Whether a candidate is not worse on W and better elsewhere, by shares (B,) of replays.

    Both skills meet the same errors of Γ, so the differences on W (`keep` (B,) bool) are those of
    pairs. Their mean may be at most `ERRORS` standard errors below 0, and at most `MOST`. On all
    scenarios together the candidate has to be better by `CLEAR` standard errors, and by `gain`.
    """
    change = new - old
    inside, outside = change[keep], change[~keep]
    if len(inside):
        slack = ERRORS * float(inside.std(correction=0)) / len(inside) ** 0.5
        if float(inside.mean()) < -min(slack, MOST) - 1e-6:
            return False
    clear = CLEAR * float(change.std(correction=0)) / len(change) ** 0.5
    return float(outside.sum()) > 0 and float(change.mean()) > max(clear, gain)
