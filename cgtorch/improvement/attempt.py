"""Trying a skill in the world once: what a journal knows is not tried again."""

from dataclasses import fields

import torch
from torch import Tensor

from cgtorch.environment import Dataset
from cgtorch.graphs import Skill
from cgtorch.ground.errors import RunError
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.setup import Setup
from cgtorch.improvement.trial import Trial, run_skill, try_skill


def attempt(setup: Setup[S], skill: Skill, scenarios: S) -> Trial:
    """What `try_skill` gives in the world of these scenarios, from the setup's journal if it can.

    Raises:
        RunError: the journal knows something else of it.
    """
    step, world = f"trial of {skill.name}", setup.world_of(scenarios)
    known = setup.journal.recall(step)
    if known is not None:
        return trial_from(known, len(scenarios), world.percept_size)
    trial = run_skill(skill, world) if setup.learn is None else try_skill(skill, world)
    setup.journal.record(step, trial_tensors(trial))
    return trial


def trial_tensors(trial: Trial) -> dict[str, Tensor]:
    """What a journal keeps of a trial; its experience says `succeeded` of tests, not scenarios."""
    own = {"solved": trial.succeeded, "transitions": trial.transitions}
    return {**own, **vars(trial.experience)}


def trial_from(tensors: dict[str, Tensor], scenarios: int, percept_size: int) -> Trial:
    """A trial of B scenarios with percepts (B, D) from a journal's tensors.

    Raises:
        RunError: they are not what `trial_tensors` gives.
    """
    try:
        trial = Trial(
            tensors["solved"],
            tensors["transitions"],
            Dataset(*(tensors[f.name] for f in fields(Dataset))),
        )
    except KeyError as e:
        raise RunError(f"the journal's trial of a skill lacks {e}; remove the journal") from e
    counts = trial.succeeded.shape == trial.transitions.shape == (scenarios,)
    kinds = trial.succeeded.dtype == torch.bool and trial.transitions.dtype == torch.long
    if not (counts and kinds and trial.experience.whole(percept_size)):
        raise RunError(
            f"the journal's trial of a skill is not one of {scenarios} scenarios; remove the "
            "journal"
        )
    return trial
