"""A whole stage on a robot, from models of what it has met to a skill, killed and resumed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import END, NEAR, CartDriver, cart, lines
from support import models_of, seeded
from torch import Generator

from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.live import OnRobot
from cgtorch.evolution import EvolutionSettings
from cgtorch.graphs import skill_to_dict
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import DomainError
from cgtorch.improvement.events import Event, ModelsFitted, Practised, SkillAccepted
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.runs.journal import FileJournal


def met(count: int) -> Dataset:
    """What an exploration of the cart could have met."""
    g = seeded(0)
    place, push = ((2 * torch.rand(count, 1, generator=g) - 1) * by for by in (END, 1.0))
    free = (place + push).abs() <= END
    after = torch.where(free, place + push, place)

    def seen(at: torch.Tensor) -> torch.Tensor:
        return torch.cat([at, at % 1], 1)

    rows = free[:, 0]
    return Dataset(
        seen(place)[rows], push[rows], seen(after)[rows], seen(place), place[:, 0].abs() < NEAR
    )


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Knowledge:
    domain = cart(tmp_path_factory.mktemp("cart") / "log")
    return models_of(domain).fit(met(90), 0)


def setup_of(domain: OnRobot, journal: FileJournal | None = None, **more: Any) -> Setup[Any]:
    about: dict[str, Any] = {"purse": Purse(), "practice": 4, "attempts": 10, **more}
    if journal is not None:
        about["journal"] = journal
    models = models_of(domain)
    return Setup(
        domain.actions(),
        world_of=domain.world,
        imagine=lambda known, scenes, percepts, *how: models.imagine(known, percepts, *how),
        learn=models.learn,
        evolution=EvolutionSettings(population=40, capacity=10, initial_nodes=(3, 6)),
        budget=Budget(generations=6),
        looks=12,
        replays=4,
        repeats=False,
        live=True,
        max_transitions=12,
        **about,
    )


def staged(
    setup: Setup[Any], domain: OnRobot, known: Knowledge, watch: Callable[[Event], None]
) -> Progress[Any]:
    def draw(count: int, generator: Generator) -> Any:
        return domain.draw("near", count, generator)

    none = draw(0, Generator())
    stage = replace(setup, name="S0", generator=seeded(0), watch=watch)
    return improve(stage, Progress(None, none, none, known), domain.tests("near"), draw)


def asked_by(path: Path) -> Asked:
    """What a log says was asked."""
    actions = lines(path, "action")
    motions = sum(row["what"] == "motion" for row in actions)
    looks, episodes = (len(lines(path, name)) for name in ("look", "episode"))
    return Asked(motions, len(actions) - motions, looks, episodes)


def test_a_robot_finds_a_skill_and_each_scene_is_met_once(known: Knowledge, tmp_path: Path) -> None:
    path, driver, told = tmp_path / "log", CartDriver(), list[Event]()
    domain = cart(path, driver)
    setup = setup_of(domain)
    after = staged(setup, domain, known, told.append)
    assert after.skill is not None
    asked = asked_by(path)
    assert setup.purse.total == asked
    assert set(setup.purse.spent) == {"practice"}  # nobody has to arrange a scene for a look
    assert driver.calls.count("arrange near") == asked.episodes == asked.looks
    assert len(after.solved) + len(after.missed) == asked.episodes
    succeeded = [row["succeeded"] for row in lines(path, "episode")]
    assert len(after.solved) == sum(succeeded)
    (accepted,) = (e for e in told if isinstance(e, SkillAccepted))
    assert accepted.succeeded.sum() == sum(succeeded)
    practised = [e for e in told if isinstance(e, Practised)]
    in_a_row = practised[-1].in_a_row
    assert in_a_row == practised[-1].wanted >= 2
    assert all(succeeded[-in_a_row:])
    assert {row["stage"] for row in lines(path)} == {"S0"}
    fitted = sum(isinstance(e, ModelsFitted) for e in told)
    before, now = (len(k.dataset.tested) + len(k.aside.tested) for k in (known, after.knowledge))
    assert (now > before) == (fitted > 0)


@pytest.mark.parametrize("killed_at", [[1], [4], [3, 2, 5], [9, 1]])
def test_a_stage_that_is_killed_goes_on_where_it_was(
    killed_at: list[int], known: Knowledge, tmp_path: Path
) -> None:
    """What is in the log is not asked again, and ends as if the same process had gone on."""
    path, seed, found = tmp_path / "log", 0, None
    for actions in killed_at:
        driver = CartDriver(seed)
        driver.script = {actions: unplugged}
        domain, seed = cart(path, driver), seed + 1
        with (
            pytest.raises(DomainError, match="unplugged"),
            FileJournal(tmp_path / "S0", seconds=0) as journal,
        ):
            staged(setup_of(domain, journal), domain, known, lambda event: None)
    before = asked_by(path)
    driver = CartDriver(seed)
    domain = cart(path, driver)
    with FileJournal(tmp_path / "S0", seconds=0) as journal:
        setup = setup_of(domain, journal)
        found = staged(setup, domain, known, lambda event: None)
    assert found.skill is not None
    asked = asked_by(path)
    assert setup.purse.total.episodes == asked.episodes
    assert driver.calls.count("arrange near") == asked.looks - before.looks
    assert len(found.solved) + len(found.missed) == asked.episodes
    # Where the log is whole, all of it is recalled, and it comes to the same skill.
    idle = CartDriver(99)
    last = cart(path, idle)
    again = staged(setup_of(last), last, known, lambda event: None)
    assert not idle.calls
    assert again.skill is not None
    assert skill_to_dict(again.skill) == skill_to_dict(found.skill)
    assert len(again.solved) == len(found.solved)


def unplugged() -> None:
    raise DomainError("unplugged")


def test_a_budget_ends_a_robots_stage(known: Knowledge, tmp_path: Path) -> None:
    path = tmp_path / "log"
    for name, limit in (("motions", 7), ("episodes", 3), ("looks", 2), ("tests", 0)):
        path.unlink(missing_ok=True)
        domain = cart(path, CartDriver())
        setup = setup_of(domain, purse=Purse({name: limit}), practice=20)
        staged(setup, domain, known, lambda event: None)
        assert setup.purse.exhausted
        asked = asked_by(path)
        assert getattr(setup.purse.total, name) <= limit
        if name != "episodes":  # the last one has begun, and ends nowhere
            assert getattr(asked, name) <= limit
        assert asked.looks <= (limit if name in ("episodes", "looks") else 99)
