"""Dry run of a domain on two scenarios, with errors that name the faulty method."""

import time
from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator

from cgtorch.domains.domain import Domain
from cgtorch.domains.files import Files
from cgtorch.domains.live import OnRobot
from cgtorch.domains.models import Models
from cgtorch.domains.pictures import Pictures
from cgtorch.domains.rewarded_models import RewardedModels
from cgtorch.domains.world import World
from cgtorch.graphs import Action, ActionSet, Step
from cgtorch.ground.dry_run import (
    ROWS,
    check_default_type,
    check_environment,
    expect,
    kind,
    returned,
    two_rows,
    what_differs,
    what_is_shared,
)
from cgtorch.ground.environment import (
    Copied,
    Counting,
    Environment,
    Episodic,
    Named,
    Rewarded,
    ScenarioBatch,
    start_lanes,
)
from cgtorch.ground.errors import ActionError, DomainError
from cgtorch.ground.fields import Field, bounds_of
from cgtorch.ground.rows_alone import TOGETHER, what_others_change
from cgtorch.ground.whole_episode import SECONDS, STEPS, what_differs_late

OF_MODELS = "explore", "worth_trying", "worth_testing", "transition_features", "success_features"
"""What users write for models, and what would be left aside in a domain."""


def check_domain(domain: Domain[Any], scenarios: str) -> bool:
    """Try a domain on a kind of scenarios, and whether its world repeats itself.

    DomainError or WorldError says what is wrong. Nothing is asked of a live world.
    """
    who = type(domain).__name__
    check_default_type(who)
    _check_names(domain, who)
    if scenarios not in domain.kinds:
        known = ", ".join(domain.kinds)
        raise DomainError(f"{who} has no scenarios {scenarios!r:.40}; use one of {known}")
    if isinstance(domain, OnRobot):
        return False
    drawn = [_drawn(domain, who, scenarios, count) for count in (0, ROWS, ROWS)]
    if not torch.equal(_numbers(drawn[1]), _numbers(drawn[2])):
        raise DomainError(
            f"{who}.draw gave other scenarios for the same generator; draw all numbers from it"
        )
    world: Environment = returned(DomainError, f"{who}.world", domain.world, drawn[1])
    began = time.monotonic()
    check_environment(world)
    slow = time.monotonic() - began > SECONDS
    if isinstance(world, Rewarded):
        _check_rewards(world, who)
    for name, size in (("percept", world.percept_size), ("control", world.control_size)):
        if (given := len(getattr(domain, name))) != size:
            raise DomainError(
                f"{who}.{name} names {given} numbers, its world has {size}; give one Field for each"
            )
    differs = _differs(domain, world, who, slow)
    if isinstance(world, Rewarded) and differs:
        what = f"{who} gives rewards, and its world"
        advice = "noise belongs to a scenario, so draw it in Domain.draw, read no clock"
        if isinstance(world, Named):
            what, advice = world.what, world.advice
        raise DomainError(
            f"{what} gave something else when it was called twice with the same arguments "
            f"({differs}); {advice}, and keep nothing of an earlier episode"
        )
    if isinstance(world, World):
        name, state = f"{type(world).__name__}.succeeded", world.start(two_rows(ROWS))[0]
        succeeded = returned(DomainError, name, world.succeeded, state)
        expect(DomainError, name, "", succeeded, (ROWS,), torch.bool)
    foreign = not type(world).__module__.startswith("cgtorch.")  # as the library's are tested
    if foreign and not differs and domain.repeats and not isinstance(world, Copied | Counting):
        _check_rows(domain, who, scenarios, ROWS if slow else TOGETHER)
    actions = returned(DomainError, f"{who}.actions", domain.actions)
    if not isinstance(actions, ActionSet):
        raise DomainError(f"{who}.actions returned {kind(actions)}; return an ActionSet")
    return not differs


def _differs(domain: Domain[Any], world: Environment, who: str, slow: bool) -> str:
    """What a world shows otherwise when it is called again, or "".

    DomainError if an episode changes another one.
    """
    if not domain.repeats:
        return "it is said not to repeat itself"
    if differs := what_differs(world):
        return differs
    shared, left, controls = what_is_shared(world), "", trial_controls(domain)
    if not shared and isinstance(world, Episodic) and not isinstance(world, Counting):
        differs, left = what_differs_late(world, controls, slow)
    if (shared or left) and not differs:
        what = world.what if isinstance(world, Named) else f"{who}'s world"
        how = "when its scenarios began in another order" if shared else "in a second episode"
        raise DomainError(
            f"{what} showed something else {how} ({shared or left}); let what one scenario does "
            "change nothing in another one, and keep no state in classes or modules, or from one "
            "episode to the next"
        )
    return differs


def _check_rows(domain: Domain[Any], who: str, scenarios: str, count: int) -> None:
    """DomainError if what a scenario shows depends on the others of a batch."""
    several = _drawn(domain, who, scenarios, count)
    world: Environment = returned(DomainError, f"{who}.world", domain.world, several)
    if changed := what_others_change(world, trial_controls(domain)):
        what = world.what if isinstance(world, Named) else f"{who}'s world"
        raise DomainError(
            f"{what} showed something else for a scenario alone than for the same one beside "
            f"others ({changed}); let each row of a batch depend on itself only, so use "
            "torch.where in place of if, and no mean, sum or largest number of all rows"
        )


def trial_controls(domain: Domain[Any]) -> torch.Tensor:
    """(N, U) random controls of an episode, within bounds as far as there are any."""
    generator, (low, high) = Generator().manual_seed(0), bounds_of(domain.control)
    shape = STEPS, len(low)
    within = low + (high - low) * torch.rand(shape, generator=generator)
    return torch.where(within.isfinite(), within, torch.randn(shape, generator=generator))


def _check_names(domain: Domain[Any], who: str) -> None:
    for name in ("percept", "control"):
        given = getattr(domain, name, None)
        fields = given if isinstance(given, Sequence) else ()
        if not fields or not all(isinstance(f, Field) for f in fields):
            how = ", in a tuple: a single one needs a comma, (field,)"
            raise DomainError(
                f"{who}.{name} is {given!r:.60}; give a Field for each number"
                f"{how if isinstance(given, Field) else ''}"
            )
    given = domain.kinds
    if not isinstance(given, tuple) or not all(isinstance(k, str) for k in given):
        raise DomainError(f"{who}.kinds is {given!r:.60}; give names in a tuple")
    several = Models, RewardedModels
    for name, parts in (("models", several), ("pictures", (Pictures,)), ("files", (Files,))):
        kind_of = getattr(domain, name)
        none = name == "models" and kind_of is None
        if not (none or (isinstance(kind_of, type) and issubclass(kind_of, parts))):
            known = " or ".join(f"cgtorch.{part.__name__}" for part in parts)
            known += ", or None where no models are learned" if name == "models" else ""
            raise DomainError(f"{who}.{name} is {kind_of!r:.60}; give a subclass of {known}")
    for name in OF_MODELS:
        if hasattr(domain, name):
            raise DomainError(
                f"{who} has {name}, which is asked of its models; define it in a subclass of "
                "cgtorch.Models, and give that as models"
            )
    if not domain.kinds:
        raise DomainError(f"{who}.kinds is empty; name at least one kind of scenarios")
    for stage, of in domain.stages.items():
        if of not in domain.kinds:
            raise DomainError(
                f"{who}.stages has {stage!r} about {of!r}, which is none of its kinds of scenarios"
            )


def _drawn(domain: Domain[Any], who: str, scenarios: str, count: int) -> ScenarioBatch:
    given = scenarios, count, Generator().manual_seed(0)
    found = returned(DomainError, f"{who}.draw", domain.draw, *given)
    if not isinstance(found, ScenarioBatch) or len(found) != count:
        said = f"{len(found)} scenarios" if isinstance(found, ScenarioBatch) else kind(found)
        raise DomainError(
            f"{who}.draw returned {said} for a count of {count}; return a ScenarioBatch of "
            f"{count} scenarios"
        )
    return found


def _numbers(scenarios: ScenarioBatch) -> torch.Tensor:
    return torch.cat([v.double().flatten() for v in vars(scenarios).values()])


def _check_rewards(world: Any, who: str) -> None:
    lanes = start_lanes(world, two_rows(world.num_scenarios), world.control_size, 0)
    over = returned(DomainError, f"{who}'s world.over", world.over, lanes)
    expect(DomainError, f"{who}'s world.over", "", over, (ROWS,), torch.bool)
    gained = returned(DomainError, f"{who}'s world.returns", world.returns, lanes)
    floats = isinstance(gained, torch.Tensor) and gained.is_floating_point()
    if not floats or gained.shape != (ROWS,):
        raise DomainError(
            f"{who}'s world.returns returned {kind(gained)}; return a tensor ({ROWS},) of floats"
        )


def check_sizes(name: str, action: Action, percept: int, control: int) -> None:
    """ActionError if an action is for percepts or controls of other lengths."""
    reads = getattr(action, "percept_size", percept)
    if reads != percept:
        raise ActionError(
            f"action {name!r} reads {reads} numbers, and a percept has {percept}; make it for these"
        )
    if type(action) is Step and action.message_size != control:  # others may send more
        raise ActionError(
            f"action {name!r} sends {action.message_size} numbers as a control, of which the "
            f"domain has {control}; make it as Step({control})"
        )
