"""A small stage, told by the events of a real evolution, and the models that they tell of."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from support import FOOTPRINT, search, seeded
from torch import Tensor

from cgtorch.domains.knowledge import Knowledge, summary_of
from cgtorch.domains.success import fit_success_classifier
from cgtorch.domains.transition import Grid
from cgtorch.domains.transition_fit import fit_transition_model
from cgtorch.evolution import EvolutionSettings
from cgtorch.graphs import Skill
from cgtorch.improvement.compose import branching_action, compose
from cgtorch.improvement.events import (
    Event,
    FreshTested,
    GenerationDone,
    ModelsFitted,
    SkillAccepted,
    StageStarted,
    WorldTested,
)
from cgtorch.improvement.setup import Budget
from cgtorch.improvement.specialists import evolve_candidate
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.data import Scenes, collect
from cgtorch.tabletop.models import GraspClassifier, TableTransitionModel
from cgtorch.tabletop.world import Scenarios, TabletopWorld, random_scenarios
from cgtorch.tabletop.world.scenarios import stage_scenarios

GENERATIONS = 45  # of the first candidate; the second has two


def _graspable(at: Tensor, table: Tensor) -> Tensor:
    """A stand-in for the arms, in reach of a few objects from the start."""
    return (at[:, 0] > 0.2) & (at[:, 0] < 1.3) & (at[:, 1].abs() < 0.5)


def _world_of(scenarios: Scenarios) -> TabletopWorld:
    return TabletopWorld(scenarios, _graspable, FOOTPRINT)


SCENES = Scenes(_world_of)


def _knowledge() -> Knowledge:
    """The models that the events tell of."""
    data = collect(SCENES, 120, 100, seeded(0))
    gamma, gamma_report = fit_transition_model(
        TableTransitionModel(),
        data.percept,
        data.control,
        data.next_percept,
        grid=Grid((8.0,), (0.12,), (0.1,), 800),
    )
    classifier, report = fit_success_classifier(
        GraspClassifier(), data.tested, data.succeeded, C=(8.0,), gamma=(0.03,)
    )
    return Knowledge(data, gamma, gamma, classifier, gamma_report, report, data)


def _events(knowledge: Knowledge) -> list[Event]:
    """Two candidates of stage S1, the models between them, and the skill made of both."""
    told: list[Event] = []
    actions, generator = paper_actions(), seeded(3)
    scenarios = random_scenarios("near", 6, generator).joined(stage_scenarios("left"))
    targets = torch.arange(11) >= 6
    world, keep = _world_of(scenarios), ~targets
    told.append(StageStarted("S1", ("S0", "S1", "S2"), 6, 5, attempts=4))
    told.append(ModelsFitted("S1", summary_of(knowledge), 1.5))
    members: list[Skill] = []
    kept = torch.zeros(11, dtype=torch.bool)
    for name, limit in (("S1.1", GENERATIONS), ("S1.2", 2)):
        budget = Budget(limit, patience=10**6, stall=10**6, enough=2.0)
        setup = search(actions, EvolutionSettings(population=60, capacity=12), budget)
        stage = replace(setup, name="S1", generator=generator, watch=told.append)
        found = evolve_candidate(stage, name, world, keep=kept)
        champion = found.champion
        members.append(Skill(name, champion.graphs, actions))
        result = try_skill(members[-1], world).succeeded
        kept = result & keep
        w, m = int(result[keep].sum()), int(result[~keep].sum())
        told.append(WorldTested("S1", name, w, 6, m, 5))
    branch = branching_action(actions)[1]
    parameters = branch.initial_parameters(1, generator)
    skill = compose("S1", members, parameters, actions, 20)
    result = try_skill(skill, world).succeeded
    told.append(WorldTested("S1", "S1", int(result[keep].sum()), 6, int(result[~keep].sum()), 5))
    told.append(FreshTested("S1", "S1", 30, 40, 0.9, decisive=False))
    keep = torch.arange(len(scenarios)) < 6
    told.append(SkillAccepted("S1", skill, scenarios, result, keep, targets, 62.0))
    assert sum(isinstance(e, GenerationDone) for e in told) == GENERATIONS + 2
    return told


@dataclass(frozen=True)
class Told:
    """A stage."""

    knowledge: Knowledge
    events: list[Event]


def make_stage(path: Path) -> None:
    """Make the stage; `tools/mutate.py` does so before it changes lines."""
    knowledge = _knowledge()
    path.write_bytes(pickle.dumps(Told(knowledge, _events(knowledge))))


def told_stage(path: Path) -> Told:
    """The stage that was made."""
    told: Told = pickle.loads(path.read_bytes())  # noqa: S301  another of these processes wrote it
    return told
