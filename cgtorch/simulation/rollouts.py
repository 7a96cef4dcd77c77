"""What rollouts come to."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Rollouts:
    """How P graphs did on B scenarios.

    Attributes:
        succeeded: (P, B) bool, a terminal outcome with success was reached.
        timed_out: (P, B) bool, no terminal outcome within the limit of transitions.
        percept: (P, B, D), the last percept p_t.
        state: (P, B, S), what the environment kept of the lane at its end.
        transitions: (P, B) long, actions until the end, also those of endless loops, which are
            counted and not executed.
        executed: how many actions were executed in all.
        returns: (P, B) the sums of rewards, -inf where an episode was not finished; None where the
            environment gives no rewards.
    """

    succeeded: Tensor
    timed_out: Tensor
    percept: Tensor
    state: Tensor
    transitions: Tensor
    executed: int
    returns: Tensor | None = None
