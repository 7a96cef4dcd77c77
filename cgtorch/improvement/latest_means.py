"""What the latest means of a tuning got tells whether it has become better than the holder.

Where steps are what costs, a race between two good skills costs more than it is worth. So each mean
is tried a little where a race is due, and the latest of them count for the present one.
"""

import math

import torch

from cgtorch.improvement.paired_race import Holder
from cgtorch.improvement.tuning import TRAIL, Tuning


def decide(holder: Holder | None, tuning: Tuning) -> bool:
    """Whether enough is known of a holder and of the latest means."""
    return holder is not None and min(holder.count, len(tuning.trail)) >= TRAIL


def better(holder: Holder | None, tuning: Tuning, goes_on: bool) -> bool:
    """Whether the latest means of a tuning decide, and are better than the holder.

    Those of a rival have to be better by a standard error of both, as it begins anew. Where what
    was tuned before `goes_on`, it tends to become better, so that as good is enough.
    """
    if holder is None or not decide(holder, tuning):
        return False
    trail = torch.tensor(tuning.trail, dtype=torch.float64)
    error = math.hypot(holder.error, float(trail.std()) / math.sqrt(TRAIL))
    least = holder.mean if goes_on else holder.mean + error
    return float(trail.mean()) >= least
