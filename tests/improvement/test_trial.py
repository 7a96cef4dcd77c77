"""What a journal says of a trial is a trial, or one error."""

import pytest
import torch
from torch import Tensor

from cgtorch.ground.errors import RunError
from cgtorch.improvement.trial import trial_from

SIZE = 7


def tensors() -> dict[str, Tensor]:
    """Of a trial of three scenarios, which went through two transitions and one test."""
    return {
        "solved": torch.tensor([True, False, True]),
        "transitions": torch.tensor([1, 2, 3]),
        "percept": torch.zeros(2, SIZE),
        "control": torch.zeros(2, 3),
        "next_percept": torch.zeros(2, SIZE),
        "tested": torch.zeros(1, SIZE),
        "succeeded": torch.tensor([True]),
    }


def test_a_trial_is_read() -> None:
    trial = trial_from(tensors(), 3, SIZE)
    assert trial.succeeded.tolist() == [True, False, True]
    assert len(trial.experience.percept) == 2


@pytest.mark.parametrize("name", sorted(tensors()))
def test_nonsense_is_one_error(name: str) -> None:
    whole = tensors()
    for bad in (torch.tensor(1.5), whole[name][:-1], whole[name][None], whole[name].half()):
        with pytest.raises(RunError, match="is not one of 3 scenarios; remove the journal"):
            trial_from({**whole, name: bad}, 3, SIZE)
    del whole[name]
    with pytest.raises(RunError, match=f"lacks '{name}'"):
        trial_from(whole, 3, SIZE)


def test_a_trial_of_another_world_is_refused() -> None:
    for count, size in ((4, SIZE), (3, SIZE + 1)):
        with pytest.raises(RunError, match="remove the journal"):
            trial_from(tensors(), count, size)
