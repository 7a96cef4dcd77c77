"""The results of rollouts."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Rollouts:
    """The results of P graphs on B scenarios.

    Attributes:
        succeeded: (P, B) bool, whether the graph ended with a successful terminal outcome.
        timed_out: (P, B) bool, whether it reached the limit of transitions first.
        percept: (P, B, D), the last percept p_t.
        state: (P, B, S), the environment's last state of the lane.
        transitions: (P, B) long, actions until the end. Those of endless loops are counted, not
            executed.
        executed: Total number of actions that were executed.
        returns: (P, B) sums of rewards, -inf for an episode that did not finish; None without
            rewards.
    """

    succeeded: Tensor
    timed_out: Tensor
    percept: Tensor
    state: Tensor
    transitions: Tensor
    executed: int
    returns: Tensor | None = None
