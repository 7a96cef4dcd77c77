"""A search for the best mean in worlds that are rows of tensors, where further lanes cost little.

All that is tuned is updated in the same rollouts. First steps are as long as actions ask for,
however many parameters there are, as a sample that is worth little costs little, too.
"""

from dataclasses import replace

from torch import Generator

from cgtorch.evolution import Generation
from cgtorch.improvement.expected_state import State
from cgtorch.improvement.mean_search import MeanSearch
from cgtorch.improvement.tuning import Tuning


class SideBySide(MeanSearch):
    """A `MeanSearch` that updates the holder's tuning and its rivals in the same rollouts."""

    def _turn(self, state: State) -> tuple[Tuning, ...]:
        """All that is tuned; the holder's tuning has its own turns once it needs more scenarios."""
        tuning, rivals = state.tuning, state.rivals
        if tuning is None or any(tuning.scenarios > each.scenarios for each in rivals):
            return super()._turn(state)
        return *rivals, tuning

    def _with_rivals(self, state: State, generation: Generation) -> State:
        state = super()._with_rivals(state, generation)
        tuning = None if state.tuning is None else lengthened(state.tuning)
        return replace(state, tuning=tuning, rivals=tuple(map(lengthened, state.rivals)))

    def known_better(self, state: State, count: int, generator: Generator) -> State:
        """The state with so many further values of the holder, if there is one."""
        if state.holder is None:
            return state
        values = self.fresh.of_skills([state.holder.skill], count, generator)[0]
        return replace(state, holder=state.holder.met(values))


def lengthened(tuning: Tuning) -> Tuning:
    """A tuning with first steps that are not the shorter the more parameters there are."""
    about = tuning.distribution
    if about.updates:
        return tuning
    return replace(tuning, distribution=replace(about, step=len(about.mean) ** 0.5))
