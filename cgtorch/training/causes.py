"""The cause of each failure: what is tried, in the world and in the models, to find it."""

from dataclasses import replace
from typing import Any

import torch
from torch import Generator, Tensor

from cgtorch.domains.domain import Domain, Surveyed, noisy
from cgtorch.domains.failures import CAUSES
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.models import Models
from cgtorch.graphs import ActionSet, Skill
from cgtorch.graphs.skill import SubSkill
from cgtorch.simulation.endings import Ending
from cgtorch.training.evaluate import REPLICAS, imagined_successes, try_on

NOISES = 4  # other ones under which a failure is tried
LONGER = 2  # times as many transitions with which a failure is tried
HALF = 0.5  # probability, or share, beyond which something counts as so


def causes_of(
    skill: Skill,
    domain: Domain[Any],
    scenarios: Any,
    percepts: Tensor,
    ended: list[Ending],
    knowledge: Knowledge | None,
    usual: str,
) -> list[str]:
    """The cause of each of B failures, a key of `CAUSES`.

    Args:
        skill: The skill.
        domain: Its domain.
        scenarios: B scenarios on which it fails.
        percepts: (B, D) their first percepts.
        ended: How it ends on them.
        knowledge: Γ and C of the skill's run, if they are at hand.
        usual: The cause of what has no other.
    """
    holds = {name: torch.zeros(len(ended), dtype=torch.bool) for name in CAUSES}
    if isinstance(domain, Surveyed):
        holds["unreachable"] = ~domain.solvable(scenarios)
    if noisy(domain) and domain.repeats:
        holds["noise"] = _under_other_noise(skill, domain, scenarios) > HALF
    holds["limit"] = try_on(patient(skill), domain, scenarios).succeeded
    models = domain.models and domain.models(domain)
    if knowledge is not None and isinstance(models, Models):
        about = skill, knowledge, percepts, Generator().manual_seed(0)
        imagined = imagined_successes(models, *about, REPLICAS).float().mean(1) > HALF
        holds["classifier"] = imagined & _said_so(knowledge, ended)
        holds["gamma"], usual = imagined, "search"
    holds[usual] = torch.ones(len(ended), dtype=torch.bool)
    return [next(name for name in CAUSES if holds[name][i]) for i in range(len(ended))]


def _said_so(knowledge: Knowledge, ended: list[Ending]) -> Tensor:
    """(B,) bool, whether C says success at a percept at which a test has failed."""
    with torch.no_grad():
        said = [knowledge.classifier(one.tested) > HALF for one in ended]
    return torch.tensor([bool(each.any()) for each in said])


def _under_other_noise(skill: Skill, domain: Domain[Any], scenarios: Any) -> Tensor:
    """(B,) the share of other noise under which a skill solves scenarios."""
    copies = [scenarios.with_noise(1 + copy) for copy in range(NOISES)]
    solved = try_on(skill, domain, copies[0].joined(*copies[1:])).succeeded
    return solved.float().view(NOISES, -1).mean(0)


def patient(skill: Skill) -> Skill:
    """A skill that may take more transitions, and so may all skills in it."""
    pairs = zip(skill.actions.names, skill.actions.actions, strict=True)
    parts = {n: SubSkill(patient(a.skill)) if isinstance(a, SubSkill) else a for n, a in pairs}
    actions = ActionSet(tuple(parts), tuple(parts.values())) if skill.sub_skills else skill.actions
    return replace(skill, actions=actions, max_transitions=LONGER * skill.max_transitions)
