"""Trying a skill in the world once: what a journal knows is not tried again."""

from torch import Tensor

from cgtorch.data import Dataset
from cgtorch.errors import RunError
from cgtorch.graphs import Skill
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.trial import Trial, try_skill
from cgtorch.world import Scenarios


def attempt(setup: Setup, skill: Skill, scenarios: Scenarios) -> Trial:
    """What `try_skill` gives in the world of these scenarios, from the setup's journal if it can.

    Raises:
        RunError: the journal knows something else of it.
    """
    step = f"trial of {skill.name}"
    known = setup.journal.recall(step)
    if known is not None:
        return _read(known, len(scenarios))
    trial = try_skill(skill, setup.world_of(scenarios))
    own = {"succeeded": trial.succeeded, "transitions": trial.transitions}
    setup.journal.record(step, {**own, **vars(trial.experience)})
    return trial


def _read(known: dict[str, Tensor], count: int) -> Trial:
    """A trial of so many scenarios from a journal's tensors, which may be anything."""
    try:
        succeeded, transitions = known["succeeded"], known["transitions"]
        names = ("percept", "motion", "next_percept", "grasp_percept", "graspable")
        experience = Dataset(*(known[name] for name in names))
        if not len(succeeded) == len(transitions) == count:
            raise ValueError(f"it is of {len(succeeded)} scenarios, not {count}")
    except (KeyError, TypeError, ValueError) as e:
        raise RunError(f"the journal's trial of a skill is damaged ({e}); remove it") from e
    return Trial(succeeded, transitions, experience)
