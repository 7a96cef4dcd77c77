"""Stages without models, worlds that note what they are asked, and specialists made by hand."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import pytest
import torch
from reaching import in_the_world, small_setup, world_of
from support import seeded
from torch import Tensor

from cgtorch.graphs import Skill
from cgtorch.ground.environment import Lanes
from cgtorch.improvement.events import Event
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.state import StageState
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.tabletop.world import Scenarios, TabletopWorld, random_scenarios, stage_scenarios

Key = tuple[float, ...]
Worlds = Callable[[Scenarios], TabletopWorld]
NONE = stage_scenarios("near", 0)


def keys(scenarios: Scenarios) -> list[Key]:
    """What tells scenarios apart, with their noise."""
    about = torch.cat([scenarios.pose, scenarios.object, scenarios.seed[:, None]], 1)
    return [tuple(row) for row in about.tolist()]


@dataclass
class Asked:
    """What the scenarios of one world were asked, and who succeeded."""

    keys: list[Key]
    looks: Counter[int] = field(default_factory=Counter)
    actions: Counter[int] = field(default_factory=Counter)
    succeeded: set[int] = field(default_factory=set)


@dataclass
class Watched:
    """Worlds of which each notes what it is asked, in `log`."""

    worlds: Worlds = world_of
    log: list[Asked] = field(default_factory=list)
    before_action: Callable[[int], None] = lambda asked: None
    asked: int = 0

    def __call__(self, scenarios: Scenarios) -> TabletopWorld:
        world: Any = self.worlds(scenarios)
        start, step, success = world.start, world.step, world.success
        about = Asked(keys(scenarios))
        self.log.append(about)

        def started(scenario: Tensor) -> Any:
            about.looks.update(scenario.tolist())
            return start(scenario)

        def act(scenario: Tensor) -> None:
            self.before_action(self.asked)
            self.asked += len(scenario)
            about.actions.update(scenario.tolist())

        def stepped(lanes: Lanes, control: Tensor) -> Any:
            act(lanes.scenario[control.isfinite().all(1)])  # others send no control at all
            return step(lanes, control)

        def tested(lanes: Lanes) -> Any:
            act(lanes.scenario)
            after, chance = success(lanes)
            about.succeeded.update(lanes.scenario[chance > 0.5].tolist())
            return after, chance

        world.start, world.step, world.success = started, stepped, tested
        return world

    @property
    def trials(self) -> list[Asked]:
        """The worlds in which something was done."""
        return [each for each in self.log if each.actions]

    @property
    def acted(self) -> list[Key]:
        """The scenarios that were acted on, as often as they were."""
        return [each.keys[i] for each in self.trials for i in each.actions]


def without_models(**changed: Any) -> Setup[Scenarios]:
    """A small search in the world itself."""
    return replace(small_setup(), imagine=in_the_world, learn=None, **changed)


def first_stage(skill: Skill | None = None, **more: Any) -> Progress[Scenarios]:
    """Before a stage, without models."""
    return Progress(skill, more.pop("solved", NONE), more.pop("missed", NONE), None, **more)


def known(
    worlds: Worlds, skill: Skill, solved: Scenarios, missed: Scenarios = NONE
) -> Progress[Scenarios]:
    """What a stage begins with if a skill solves W and not M."""
    both = solved.joined(missed)
    trial = try_skill(skill, worlds(both))
    assert trial.succeeded.tolist() == [True] * len(solved) + [False] * len(missed)
    return first_stage(skill, solved=solved, missed=missed, seen=trial.percepts)


def stage_of(
    setup: Setup[Scenarios],
    watch: Callable[[Event], None] = lambda event: None,
    name: str = "S1",
    seed: int = 0,
) -> Setup[Scenarios]:
    return replace(setup, name=name, generator=seeded(seed), watch=watch)


def improved(
    progress: Progress[Scenarios],
    tests: Scenarios,
    draw: Callable[[int, torch.Generator], Scenarios],
    **changed: Any,
) -> tuple[Progress[Scenarios], list[Event]]:
    """The result of a stage in the world itself, and its events."""
    told: list[Event] = []
    return improve(stage_of(without_models(**changed), told.append), progress, tests, draw), told


def along(edge: str) -> Callable[[int, torch.Generator], Scenarios]:
    """Draws scenarios with objects along an edge."""
    return lambda count, generator: random_scenarios(edge, count, generator)


def recruited(monkeypatch: pytest.MonkeyPatch, *members: Skill) -> list[Skill]:
    """Where a specialist would be evolved, the next of these joins; those that have not yet."""
    left = list(members)

    def with_member(
        setup: Setup[Scenarios], state: StageState[Scenarios], missed: Tensor
    ) -> StageState[Scenarios]:
        assert missed.any()
        if not left:
            return state
        return state.joined_by(left.pop(0))

    monkeypatch.setattr("cgtorch.improvement.team.with_member", with_member)
    return left


def state_of(
    scenarios: Scenarios, members: tuple[Skill, ...] = (), keep: Tensor | None = None, **more: Any
) -> StageState[Scenarios]:
    """The state of a stage that has tried W, and nothing else yet."""
    nobody = torch.zeros(len(scenarios), dtype=torch.bool)
    keep = nobody if keep is None else keep
    percepts = first_percepts(world_of(scenarios))
    about = {
        "scenarios": scenarios,
        "percepts": percepts,
        "targets": ~keep,
        "shown": keep.long(),
        "rest": (NONE, percepts[:0]),
        "waiting": NONE,
        "knowledge": None,
        "members": members,
        "trust": torch.ones(len(scenarios), len(members)),
        "outcomes": torch.zeros(len(scenarios), len(members), dtype=torch.long),
        **dict.fromkeys(("keep", "known", "tried"), keep),
        **more,
    }
    return StageState(**{f.name: about[f.name] for f in fields(StageState) if f.name in about})


def of_kind(told: list[Event], kind: type[Any]) -> list[Any]:
    return [event for event in told if isinstance(event, kind)]
