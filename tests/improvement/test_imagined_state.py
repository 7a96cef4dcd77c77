"""What is kept of a search in imagined episodes is what is read."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import pytest
import torch
from lottery import ACTIONS, staking
from torch import Tensor

from cgtorch.ground.asked import Asked
from cgtorch.ground.errors import RunError
from cgtorch.improvement import expected_state as expected
from cgtorch.improvement.imagined_state import (
    CHAMPIONS,
    CURIOUS,
    PROGRESS,
    RANDOM,
    State,
    state_from_tensors,
    tensors_of_state,
)
from cgtorch.improvement.paired_race import Holder


@dataclass(frozen=True)
class Told:
    """What is known, of which nothing but its tensors is asked; and how it becomes known."""

    number: float = 0.0

    def tensors(self) -> dict[str, Tensor]:
        return {"number": torch.tensor(self.number)}

    def recalled(self, tensors: Mapping[str, Tensor]) -> "Told":
        assert set(tensors) == {"number"}
        return Told(float(tensors["number"]))


MODELS: Any = Told()
INNER = expected.State(
    Holder(staking(0.5), 3.0, 5.0, 2), spent=expected.Spent(generations=3, episodes=40)
)
ASKED = {RANDOM: Asked(motions=4, looks=2), CURIOUS: Asked(motions=3, episodes=1)}
KNOWN: Any = Told(7.0)
STATE = State(KNOWN, INNER, waited=2, patience=12, episodes=5, asked=ASKED, mark=-2.5)
LIKE = staking(0.0, name="like")


def test_what_is_kept_is_what_is_read() -> None:
    found = state_from_tensors(tensors_of_state(STATE, None), MODELS, ACTIONS, LIKE, None)
    names = "known", "waited", "patience", "episodes", "asked", "mark", "generations", "steps"
    assert [getattr(found, name) for name in names] == [getattr(STATE, name) for name in names]
    assert (found.generations, found.steps) == (3, 7)
    assert (found.skill, found.seed) == (None, None)
    assert found.inner.spent == INNER.spent
    assert found.inner.holder is not None
    assert (found.inner.holder.skill.name, found.inner.holder.mean) == ("like", 1.5)


@pytest.mark.parametrize("name", ["waited", "world", "mark"])
def test_what_is_damaged_is_one_error(name: str) -> None:
    tensors = tensors_of_state(STATE, None)
    del tensors[name]
    with pytest.raises(RunError, match="damaged"):
        state_from_tensors(tensors, MODELS, ACTIONS, LIKE, None)


def test_progress_is_more_than_a_share_of_what_is_lacking() -> None:
    """The mean is 1.5."""
    assert PROGRESS == 0.1
    for mark, target, progress in ((1.0, 6.0, False), (1.0, 5.0, True), (-inf, 6.0, True)):
        state = State(KNOWN, INNER, waited=2, mark=mark).waiting(target)
        assert (state.waited, state.mark) == ((0, 1.5) if progress else (3, mark))
    nobody = State(KNOWN, expected.State(), waited=2).waiting(6.0)
    assert (nobody.waited, nobody.mark) == (3, -inf)


def test_new_knowledge_makes_the_holders_values_old() -> None:
    new: Any = Told(8.0)
    after = STATE.met(new, RANDOM, Asked(motions=5, episodes=2))
    assert INNER.holder is not None
    assert after.inner.holder == Holder(INNER.holder.skill)
    assert (after.known, after.waited, after.mark) == (new, 0, -inf)
    assert after.asked == {**ASKED, RANDOM: Asked(motions=9, looks=2, episodes=2)}
    assert (after.episodes, after.steps) == (7, 12)
    nobody = replace(STATE, inner=expected.State()).met(new, CHAMPIONS, Asked(motions=5))
    assert nobody.inner.holder is None
    assert nobody.asked == {**ASKED, CHAMPIONS: Asked(motions=5)}
