"""Trying a skill in the world (Algorithm 1, line 2).

A scenario is an initial state together with its noise. In a world that repeats itself, W and eq. 1a
are exact statements. In any other world, a trial is one sample of what may happen.
"""

from dataclasses import astuple, dataclass, fields, replace
from functools import reduce

import torch
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.asked import NAMES, Asked, Purse
from cgtorch.ground.environment import Dataset, Environment, Episode, Live
from cgtorch.ground.errors import RunError
from cgtorch.improvement.events import S, WorldAsked
from cgtorch.improvement.setup import Setup
from cgtorch.simulation import Recording, rollout


@dataclass(frozen=True)
class Trial:
    """The result of a skill on B scenarios of a world.

    First percepts are (B, D). `succeeded`, the executed actions of the skill, the world actions
    among them, and the `returns`, if the world gives rewards, are (B,). `asked` is what it cost.
    """

    percepts: Tensor
    succeeded: Tensor
    transitions: Tensor
    experience: Dataset
    actions: Tensor
    asked: Asked
    returns: Tensor | None = None


def try_skill(
    skill: Skill,
    world: Environment,
    purse: Purse | None = None,
    phase: str = "trials",
    most: int | None = None,
) -> Trial:
    """Run a skill once on every scenario, each with at most so many world actions.

    BudgetSpentError if `purse` does not cover it.
    """
    purse = Purse() if purse is None else purse
    rows = torch.arange(world.num_scenarios)
    if not isinstance(world, Live):
        return _tried(skill, world, purse, phase, most, rows)
    trials = []
    for row in rows.split(1):
        known = world.recall()
        if known is not None:
            trials.append(_recalled(known, purse, phase))
            continue
        trial = _tried(skill, world, purse, phase, most, row)
        left, asked = world.ended(bool(trial.succeeded))
        purse.add(phase, asked)
        both = left.extended(trial.experience)
        trials.append(replace(trial, experience=both, asked=trial.asked + asked))
    return _joined(trials)


def _tried(
    skill: Skill, world: Environment, purse: Purse, phase: str, most: int | None, rows: Tensor
) -> Trial:
    """A trial on some scenarios, all at once."""
    before, place = purse.total, Recording(world, purse, phase, most)
    purse.pay(phase, Asked(episodes=len(rows)))
    about, limit = (skill.graph, skill.actions, place), skill.max_transitions
    runs = rollout(*about, scenarios=rows, max_transitions=limit)
    return Trial(
        percepts=place.first[rows],
        succeeded=runs.succeeded[0],
        transitions=runs.transitions[0],
        experience=Dataset(*place.experience()),
        actions=place.actions[rows],
        asked=purse.total - before,
        returns=None if runs.returns is None else runs.returns[0],
    )


def _recalled(known: Episode, purse: Purse, phase: str) -> Trial:
    """The trial that an episode of before an interruption was."""
    purse.add(phase, known.asked)
    actions, succeeded = torch.tensor([known.actions]), torch.tensor([known.succeeded])
    return Trial(known.percept, succeeded, actions, known.experience, actions, known.asked)


def _joined(trials: list[Trial]) -> Trial:
    """One trial of several, at least one."""
    experience = reduce(Dataset.extended, (trial.experience for trial in trials))
    names = "percepts", "succeeded", "transitions", "actions"
    columns = {name: torch.cat([getattr(trial, name) for trial in trials]) for name in names}
    asked = sum((trial.asked for trial in trials), Asked())
    return Trial(experience=experience, asked=asked, **columns)


def first_percepts(world: Environment) -> Tensor:
    """(B, D) the first percept of each scenario."""
    return world.start(torch.arange(world.num_scenarios))[1]


def looked(setup: Setup[S], scenarios: S) -> Tensor:
    """(B, D) first percepts, which are paid for, from the journal if possible."""
    step, asked = "looks", Asked(looks=len(scenarios))
    known = setup.journal.recall(step)
    if known is not None:
        setup.purse.add(step, asked)
        percepts, count = known.get("percepts", torch.empty(0)), len(scenarios)
        if percepts.dim() != 2 or len(percepts) != count or percepts.dtype != torch.float32:
            raise RunError(
                f"the journal's looks are not those at {count} scenarios; remove the journal"
            )
    else:
        setup.purse.pay(step, asked)
        percepts = first_percepts(setup.world_of(scenarios))
        setup.journal.record(step, {"percepts": percepts})
    setup.watch(WorldAsked(setup.name, step, asked, recalled=known is not None))
    return percepts


def attempt(
    setup: Setup[S], skill: Skill, scenarios: S, phase: str, most: int | None = None
) -> Trial:
    """The result of `try_skill`, from the journal if possible.

    RunError if that does not fit, BudgetSpentError if the purse does not cover it.
    """
    step = f"trial of {skill.name}"
    world = setup.world_of(scenarios)
    if isinstance(world, Live):  # its own log recalls it
        world.told(phase, setup.name)
        known, trial = None, try_skill(skill, world, setup.purse, phase, most)
    elif (known := setup.journal.recall(step)) is not None:
        trial = trial_from(known, len(scenarios))
        setup.purse.add(phase, trial.asked)
    else:
        trial = try_skill(skill, world, setup.purse, phase, most)
        setup.journal.record(step, trial_tensors(trial))
    about = trial.asked, int(trial.succeeded.sum()), known is not None
    setup.watch(WorldAsked(setup.name, phase, *about))
    return trial


def trial_tensors(trial: Trial) -> dict[str, Tensor]:
    """The tensors of a trial in a journal."""
    return {
        "first": trial.percepts,
        "solved": trial.succeeded,
        "transitions": trial.transitions,
        "actions": trial.actions,
        "asked": torch.tensor(astuple(trial.asked)),
        **vars(trial.experience),
    }


def trial_from(tensors: dict[str, Tensor], scenarios: int) -> Trial:
    """A trial of B scenarios from `trial_tensors`; RunError if they do not belong to one."""
    try:
        experience = Dataset(*(tensors[f.name] for f in fields(Dataset)))
        names = "first", "solved", "transitions", "actions", "asked"
        first, solved, transitions, actions, asked = (tensors[name] for name in names)
    except KeyError as e:
        raise RunError(f"the journal's trial of a skill lacks {e}; remove the journal") from e
    one_each = solved.shape == transitions.shape == actions.shape == first.shape[:1]
    counts = one_each and solved.shape == (scenarios,) and asked.shape == (len(NAMES),)
    whole = {each.dtype for each in (transitions, actions, asked)} == {torch.long}
    kinds = whole and solved.dtype == torch.bool and first.dtype == torch.float32
    if not (counts and kinds and first.dim() == 2 and experience.whole(first.shape[1])):
        raise RunError(
            f"the journal's trial of a skill is not one of {scenarios} scenarios; remove the "
            "journal"
        )
    return Trial(first, solved, transitions, experience, actions, Asked(*asked.tolist()))
