"""Trying a skill in the world (Algorithm 1, line 2), and what success means.

A scenario is an initial state together with its noise, drawn from the scenario's seed. A skill
succeeds on it if one run reaches a successful terminal outcome. A repeated run gives the same
result, so W and eq. 1a are exact statements. A statement about initial states under any noise is a
share with Wilson's 95 % interval: of fresh scenarios (`cgtorch-evaluate`, the tests of a round),
and of W under other noise (`w_other_noise` in the ledger). A specialist counts as solving a
scenario only if it succeeds under all of `Setup.trials` draws of noise.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from cgtorch.environment import Dataset, Environment
from cgtorch.graphs import Skill
from cgtorch.ground.errors import RunError
from cgtorch.improvement.interfaces import S
from cgtorch.improvement.setup import Setup
from cgtorch.simulation import Recording, rollout


@dataclass(frozen=True)
class Trial:
    """The result of a skill on B scenarios of a world.

    `succeeded` and the number of executed actions are (B,). The experience is empty if it was not
    recorded. `returns` (B,) are those of its episodes, if the world gives rewards.
    """

    succeeded: Tensor
    transitions: Tensor
    experience: Dataset
    returns: Tensor | None = None


def try_skill(skill: Skill, world: Environment, record: bool = True) -> Trial:
    """Run a skill once on every scenario; `record` its experience, a lot of long episodes."""
    recording = Recording(world)
    place = recording if record else world
    runs = rollout(skill.graph, skill.actions, place, max_transitions=skill.max_transitions)
    returns = None if runs.returns is None else runs.returns[0]
    return Trial(runs.succeeded[0], runs.transitions[0], Dataset(*recording.experience()), returns)


def first_percepts(world: Environment) -> Tensor:
    """(B, D) the first percept of each scenario."""
    return world.start(torch.arange(world.num_scenarios))[1]


def attempt(setup: Setup[S], skill: Skill, scenarios: S) -> Trial:
    """What `try_skill` gives on scenarios, from the journal if it can; RunError if it disagrees."""
    step, world = f"trial of {skill.name}", setup.world_of(scenarios)
    known = setup.journal.recall(step)
    if known is not None:
        return trial_from(known, len(scenarios), world.percept_size)
    trial = try_skill(skill, world, record=setup.learn is not None)
    setup.journal.record(step, trial_tensors(trial))
    return trial


def trial_tensors(trial: Trial) -> dict[str, Tensor]:
    """The tensors of a trial in a journal."""
    own = {"solved": trial.succeeded, "transitions": trial.transitions}
    return {**own, **vars(trial.experience)}


def trial_from(tensors: dict[str, Tensor], scenarios: int, percept_size: int) -> Trial:
    """A trial of B scenarios from `trial_tensors`; RunError if they do not belong to one."""
    try:
        experience = Dataset(*(tensors[f.name] for f in fields(Dataset)))
        trial = Trial(tensors["solved"], tensors["transitions"], experience)
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
