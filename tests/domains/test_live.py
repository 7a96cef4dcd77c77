"""A robot as a world: one lane, every action logged before the next, and stopped with care."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import END, NEAR, CartDriver, begun, cart, lines, push, told
from rail import Cart, Rail
from support import models_of, seeded
from torch import Generator

from cgtorch.domains.domain import noisy, rewarded
from cgtorch.domains.exploration import EXPLORATION, Exploration
from cgtorch.domains.knowledge import Knowledge
from cgtorch.domains.live import OnRobot, Placements, domain_of_driver, on_robot, routine_names
from cgtorch.domains.robot import RobotDriver
from cgtorch.evolution import EvolutionSettings
from cgtorch.graphs import ActionSet, BranchingNN, Step, Test, skill_to_dict
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Dataset, Environment, Live, Rewarded, start_lanes
from cgtorch.ground.errors import DomainError
from cgtorch.ground.files import JsonLines
from cgtorch.improvement.events import Event, ModelsFitted, Practised, SkillAccepted
from cgtorch.improvement.improve import improve
from cgtorch.improvement.setup import Budget, Progress, Setup
from cgtorch.runs.journal import FileJournal
from cgtorch.simulation import Recording
from cgtorch.tabletop.actions import paper_actions


def test_a_robot_is_a_live_environment(tmp_path: Path) -> None:
    domain = cart(tmp_path / "log")
    world = told(domain)
    assert isinstance(world, Live)
    assert isinstance(world, Environment)
    assert not isinstance(world, Rewarded)
    assert (world.num_scenarios, world.percept_size, world.control_size) == (3, 2, 1)
    assert not domain.repeats
    assert not noisy(domain)
    assert not rewarded(domain)
    assert domain.kinds == ("near", "far")
    assert type(domain).__name__ == "LiveCartDriver"
    drawn = domain.draw("far", 4, seeded(0))
    assert isinstance(drawn, Placements)
    assert drawn.kind.tolist() == [1] * 4
    assert len(domain.tests("near")) == 0
    assert domain.pictures(domain).scenarios(drawn, torch.ones(4), torch.ones(4)) is None


def test_one_scene_is_met_at_a_time(tmp_path: Path) -> None:
    driver = CartDriver()
    domain = cart(tmp_path / "log", driver)
    world = told(domain)
    for rows in ([0, 1], []):
        with pytest.raises(
            DomainError, match=f"a robot cannot start {len(rows)} scenarios at once"
        ):
            world.start(torch.tensor(rows, dtype=torch.long))
    assert not driver.calls
    lanes = start_lanes(world, torch.tensor([2]), 1, 0)
    assert driver.calls == ["arrange near", "perceive"]
    both = torch.tensor([0, 0])
    for method, more in (("step", [push(0.1).expand(2, 1)]), ("success", []), ("observe", [])):
        with pytest.raises(DomainError, match="run one skill on one scenario at a time"):
            getattr(world, method)(lanes.rows(both), *more)
    assert len(driver.calls) == 2


def test_nobody_goes_back_to_where_the_robot_was(tmp_path: Path) -> None:
    driver = CartDriver()
    world, lanes = begun(cart(tmp_path / "log", driver))
    after, done = world.step(lanes, push(0.1))
    assert done.tolist() == [True]
    for method, more in (("step", [push(0.1)]), ("success", []), ("observe", [])):
        with pytest.raises(DomainError, match="a robot cannot go back to where it was"):
            getattr(world, method)(lanes, *more)
    assert driver.calls.count("step") == 1
    tested, chance = world.success(after)
    assert chance.tolist() == [float(abs(driver.place) < NEAR)]
    with pytest.raises(DomainError, match="cannot go back"):
        world.success(after)
    seen = world.observe(tested)
    assert torch.equal(seen.state, tested.state)
    world.success(seen)


def test_a_control_that_is_no_number_is_not_sent(tmp_path: Path) -> None:
    driver = CartDriver()
    world, lanes = begun(cart(tmp_path / "log", driver))
    for bad in (float("nan"), float("inf")):
        after, done = world.step(lanes, push(bad))
        assert done.tolist() == [False]
        assert after is lanes
    assert "step" not in driver.calls
    assert not lines(tmp_path / "log", "action")


def test_routines_are_named_like_the_actions() -> None:
    assert routine_names(paper_actions()) == ("move_base", "grasp")
    names = ("PushFarAway", "Look", "TestIt2Now")
    found = ActionSet(names, (Step(1), BranchingNN(2), Test()))
    assert routine_names(found) == ("push_far_away", "test_it2_now")
    for kind, rest in (("Step", (BranchingNN(2), Test())), ("Test", (Step(1),))):
        few = ActionSet(tuple(f"A{i}" for i in range(len(rest))), rest)
        with pytest.raises(DomainError, match=f"is no {kind}; add one"):
            routine_names(few)


def test_a_driver_names_its_numbers_if_it_is_a_domain_of_its_own() -> None:
    found = domain_of_driver(CartDriver)
    domain = found()
    assert found.__name__ == "CartDriver"
    assert [f.name for f in domain.percept] == ["place", "wheel"]
    assert domain.control == CartDriver.control
    assert domain.kinds == ("near", "far")
    with pytest.raises(DomainError, match="CartDriver is a robot and has no simulated world"):
        domain.world(domain.draw("near", 1, seeded(0))).start(torch.arange(1))
    for bad in ({"percept": ()}, {"control": ()}):
        with pytest.raises(DomainError, match="names no percept or no control; give a Field"):
            domain_of_driver(type("Blind", (CartDriver,), bad))


class Rewired(RobotDriver):
    """A driver for another domain: it names nothing."""

    def perceive(self) -> list[float]:
        return [0.0] * 4

    def step(self, control: tuple[float, ...]) -> bool:
        return len(control) == 3

    def test(self) -> bool:
        return True


def test_a_domain_keeps_all_but_its_world(tmp_path: Path) -> None:
    simulated = Cart()
    simulated.repeats = True
    domain = on_robot(simulated, Rewired(), JsonLines(tmp_path / "log"))
    assert isinstance(domain, Cart)
    assert not domain.repeats
    assert domain.simulated is simulated
    assert isinstance(simulated.world(simulated.draw("any", 1, seeded(0))), Rail)
    assert domain.settings == simulated.settings
    assert domain.percept == Cart.percept
    world, lanes = begun(domain, kind="any")
    assert lanes.percept.tolist() == [[0.0] * 4]
    _, done = world.step(lanes, torch.tensor([[0.0, float("nan"), 0.0]]))
    assert done.tolist() == [False]
    _, done = world.step(lanes, torch.zeros(1, 3))
    assert done.tolist() == [True]


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


def unplugged() -> None:
    raise DomainError("unplugged")


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Knowledge:
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
    setup: Setup[Any], domain: OnRobot, pushed: Knowledge, watch: Callable[[Event], None]
) -> Progress[Any]:
    def draw(count: int, generator: Generator) -> Any:
        return domain.draw("near", count, generator)

    none = draw(0, Generator())
    stage = replace(setup, name="S0", generator=seeded(0), watch=watch)
    return improve(stage, Progress(None, none, none, pushed), domain.tests("near"), draw)


def asked_by(path: Path) -> Asked:
    """What a log says was asked."""
    actions = lines(path, "action")
    motions = sum(row["what"] == "motion" for row in actions)
    looks, episodes = (len(lines(path, name)) for name in ("look", "episode"))
    return Asked(motions, len(actions) - motions, looks, episodes)


def test_a_robot_finds_a_skill_and_each_scene_is_met_once(
    pushed: Knowledge, tmp_path: Path
) -> None:
    path, driver, told = tmp_path / "log", CartDriver(), list[Event]()
    domain = cart(path, driver)
    setup = setup_of(domain)
    after = staged(setup, domain, pushed, told.append)
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
    before, now = (len(k.dataset.tested) + len(k.aside.tested) for k in (pushed, after.knowledge))
    assert (now > before) == (fitted > 0)


@pytest.mark.parametrize(
    "killed_at",
    [
        pytest.param([1], marks=pytest.mark.hostile),
        [3, 2, 5],
        pytest.param([9, 1], marks=pytest.mark.hostile),
    ],
)
def test_a_stage_that_is_killed_goes_on_where_it_was(
    killed_at: list[int], pushed: Knowledge, tmp_path: Path
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
            staged(setup_of(domain, journal), domain, pushed, lambda event: None)
    before = asked_by(path)
    driver = CartDriver(seed)
    domain = cart(path, driver)
    with FileJournal(tmp_path / "S0", seconds=0) as journal:
        setup = setup_of(domain, journal)
        found = staged(setup, domain, pushed, lambda event: None)
    assert found.skill is not None
    asked = asked_by(path)
    assert setup.purse.total.episodes == asked.episodes
    assert driver.calls.count("arrange near") == asked.looks - before.looks
    assert len(found.solved) + len(found.missed) == asked.episodes
    # Where the log is whole, all of it is recalled, and it comes to the same skill.
    idle = CartDriver(99)
    last = cart(path, idle)
    again = staged(setup_of(last), last, pushed, lambda event: None)
    assert not idle.calls
    assert again.skill is not None
    assert skill_to_dict(again.skill) == skill_to_dict(found.skill)
    assert len(again.solved) == len(found.solved)


def test_a_budget_ends_a_robots_stage(pushed: Knowledge, tmp_path: Path) -> None:
    path = tmp_path / "log"
    for name, limit in (("motions", 7), ("episodes", 3), ("looks", 2), ("tests", 0)):
        path.unlink(missing_ok=True)
        domain = cart(path, CartDriver())
        setup = setup_of(domain, purse=Purse({name: limit}), practice=20)
        staged(setup, domain, pushed, lambda event: None)
        assert setup.purse.exhausted
        asked = asked_by(path)
        assert getattr(setup.purse.total, name) <= limit
        if name != "episodes":  # the last one has begun, and ends nowhere
            assert getattr(asked, name) <= limit
        assert asked.looks <= (limit if name in ("episodes", "looks") else 99)


def test_a_robot_explores_from_where_it_is(tmp_path: Path) -> None:
    """It asks for one scene only, and goes on after an interruption with what it knows."""
    driver, purse = CartDriver(), Purse()
    domain = cart(tmp_path / "log", driver)

    def exploration(known: Any) -> Exploration:
        def worlds(kind: str, count: int) -> Environment:
            world = domain.world(domain.draw(kind, count, seeded(0)))
            world.told(EXPLORATION, "start")
            return Recording(world, purse, EXPLORATION)

        nothing: Any = None
        return Exploration("near", worlds, nothing, 30, 1, seeded(1), purse, known)

    driver.script = {9: unplugged}
    with pytest.raises(DomainError, match="unplugged"):
        models_of(domain).explore(exploration(None))
    assert driver.calls.count("arrange near") == 1
    domain = cart(tmp_path / "log", CartDriver(1))
    data, asked = domain.actor.explored(2, 1)
    assert len(data.percept) + len(data.tested) <= asked.actions == 8
    assert asked.looks == 1
    fitted: list[int] = []

    class EnoughError(Exception):
        pass

    def fit(rows: Any) -> Any:
        fitted.append(len(rows.percept))
        assert torch.equal(rows.percept[: len(data.percept)], data.percept)
        raise EnoughError

    about = exploration(data)
    with pytest.raises(EnoughError):
        models_of(domain).explore(Exploration(**{**vars(about), "fit": fit}))
    assert fitted[0] >= 10
