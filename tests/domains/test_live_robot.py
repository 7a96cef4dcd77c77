"""A robot as a world: one lane, every action logged before the next, and stopped with care."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import NEAR, CartDriver, begun, cart, lines, push, pusher, told
from rail import Cart, Rail
from support import seeded

from cgtorch.domains.domain import noisy, rewarded
from cgtorch.domains.live import Placements, domain_of_driver, on_robot, routine_names
from cgtorch.domains.robot import ProtectiveStop, Robot, RobotDriver
from cgtorch.graphs import ActionSet, BranchingNN, Step, Test
from cgtorch.ground.environment import Environment, Live, Rewarded, start_lanes
from cgtorch.ground.errors import DomainError, RobotStoppedError
from cgtorch.ground.files import JsonLines
from cgtorch.improvement.trial import try_skill
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


def test_every_action_is_in_the_log_before_the_next_begins(tmp_path: Path) -> None:
    path, driver, seen = tmp_path / "log", CartDriver(), list[int]()
    driver.script = {n: lambda: seen.append(len(lines(path, "action"))) for n in range(1, 9)}
    world, lanes = begun(cart(path, driver), phase="practice", stage="S3")
    places = [driver.place]
    for by in (0.25, 9.0, -0.5):
        lanes, done = world.step(lanes, push(by))
        places.append(driver.place)
        assert bool(done) == (by != 9.0)
        assert float(lanes.percept[0, 0]) == pytest.approx(driver.place)
    lanes, chance = world.success(lanes)
    world.ended(bool(chance > 0.5))
    assert seen == [0, 1, 2, 3]
    first, *actions, last = lines(path)
    assert first["event"] == "look"
    assert first["percept"][0] == pytest.approx(places[0], abs=1e-6)
    assert last["event"] == "episode"
    assert last["succeeded"] == (abs(driver.place) < NEAR)
    for row in (first, *actions, last):
        assert (row["stage"], row["phase"], row["episode"]) == ("S3", "practice", 1)
    assert [row["what"] for row in actions] == ["motion"] * 3 + ["test"]
    assert [row.get("control") for row in actions] == [[0.25], [9.0], [-0.5], None]
    assert [row["done"] for row in actions[:3]] == [True, False, True]
    for i, row in enumerate(actions[:3]):
        assert row["percept"][0] == pytest.approx(places[i], abs=1e-6)
        assert row["next"][0] == pytest.approx(places[i + 1], abs=1e-6)
    assert all(row["seconds"] >= 0 for row in actions)


def failing(error: Exception) -> Any:
    def fail() -> None:
        raise error

    return fail


@pytest.mark.parametrize("error", [ValueError("gear\njammed"), OSError("bus"), KeyError("x")])
def test_whatever_a_driver_raises_its_action_has_failed(error: Exception, tmp_path: Path) -> None:
    driver = CartDriver()
    driver.script = {1: failing(error), 2: failing(error)}
    world, lanes = begun(cart(tmp_path / "log", driver))
    before = driver.place
    lanes, done = world.step(lanes, push(0.1))
    assert done.tolist() == [False]
    assert driver.place == before
    lanes, chance = world.success(lanes)
    assert chance.tolist() == [0.0]
    lanes, done = world.step(lanes, push(0.1))
    assert done.tolist() == [True]
    rows = lines(tmp_path / "log", "action")
    assert [row["done"] for row in rows] == [False, False, True]
    for row in rows[:2]:
        assert row["error"].startswith(f"{type(error).__name__}: ")
    assert "error" not in rows[2]


def test_what_takes_too_long_is_stopped_and_has_failed(tmp_path: Path) -> None:
    """Its routine is waited for, since there is only one robot."""
    halted = threading.Event()

    class Slow(CartDriver):
        seconds = 0.05

        def stop(self) -> None:
            super().stop()
            halted.set()

    driver = Slow()
    driver.script = {1: lambda: halted.wait(20) and None}
    world, lanes = begun(cart(tmp_path / "log", driver))
    before = driver.place
    lanes, done = world.step(lanes, push(0.1))
    assert done.tolist() == [False]
    assert driver.stopped == 1
    assert driver.place == pytest.approx(before + 0.1)  # which is seen, though it has failed
    assert float(lanes.percept[0, 0]) == pytest.approx(driver.place)
    (row,) = lines(tmp_path / "log", "action")
    assert row["error"] == "TimeoutError: it took more than 0.05 s"
    assert not row["done"]
    lanes, done = world.step(lanes, push(0.1))
    assert done.tolist() == [True]
    assert driver.stopped == 1


def test_a_stop_for_safety_pauses_the_run(tmp_path: Path) -> None:
    """It is no failed action from which models would learn."""
    driver = CartDriver()
    driver.script = {2: failing(ProtectiveStop("elbow"))}
    world, lanes = begun(cart(tmp_path / "log", driver))
    lanes, _ = world.step(lanes, push(0.1))
    with pytest.raises(RobotStoppedError, match=r"stopped for safety \(elbow\); release it"):
        world.step(lanes, push(0.1))
    assert all(row["done"] for row in lines(tmp_path / "log", "action"))


@pytest.mark.parametrize("where", ["arrange", "perceive"])
def test_a_robot_that_is_stopped_is_so_whatever_it_is_asked(where: str, tmp_path: Path) -> None:
    driver: Any = CartDriver()
    domain = cart(tmp_path / "log", driver)
    setattr(driver, where, lambda *kind: failing(ProtectiveStop("door"))())
    with pytest.raises(RobotStoppedError, match=r"\(door\)"):
        begun(domain)


@pytest.fixture
def interruptible() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt() -> None:
    """As somebody presses Control and C in the middle of a motion, which goes on for a while."""
    time.sleep(0.05)
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.3)


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_waits_for_the_end_of_a_motion_and_its_line(tmp_path: Path) -> None:
    driver = CartDriver()
    driver.script = {2: interrupt}
    world, lanes = begun(cart(tmp_path / "log", driver))
    lanes, _ = world.step(lanes, push(0.1))
    before = driver.place
    with pytest.raises(KeyboardInterrupt):
        world.step(lanes, push(0.1))
    assert driver.place == pytest.approx(before + 0.1)
    rows = lines(tmp_path / "log", "action")
    assert [row["done"] for row in rows] == [True, True]
    assert rows[1]["next"][0] == pytest.approx(driver.place, abs=1e-6)
    assert not lines(tmp_path / "log", "episode")


@pytest.mark.usefixtures("interruptible")
def test_who_interrupts_while_a_scene_is_arranged_sees_no_motion_begin(tmp_path: Path) -> None:
    class Patient(CartDriver):
        def arrange(self, kind: str) -> None:
            super().arrange(kind)
            interrupt()

    driver = Patient()
    domain = cart(tmp_path / "log", driver)
    with pytest.raises(KeyboardInterrupt):
        try_skill(pusher(domain, 0.2), told(domain))
    assert "step" not in driver.calls
    assert "test" not in driver.calls


@pytest.mark.usefixtures("interruptible")
def test_after_an_interruption_the_same_process_can_go_on(tmp_path: Path) -> None:
    """As in a notebook, where somebody runs the cell again."""
    driver = CartDriver()
    driver.script = {1: interrupt}
    domain = cart(tmp_path / "log", driver)
    world, lanes = begun(domain)
    with pytest.raises(KeyboardInterrupt):
        world.step(lanes, push(0.1))
    world, lanes = begun(domain)
    try:
        _, done = world.step(lanes, push(0.1))
    except KeyboardInterrupt:
        pytest.fail("nobody has interrupted it")
    assert done.tolist() == [True]


@pytest.mark.parametrize(
    "bad", [[0.5], [0.1, 0.2, 0.3], None, 0.5, ["a", "b"], [0.1, float("nan")], [1e60, 0], "ab"]
)
def test_a_percept_is_as_many_finite_numbers(bad: Any, tmp_path: Path) -> None:
    driver: Any = CartDriver()
    domain = cart(tmp_path / "log", driver)
    world, lanes = begun(domain)
    driver.perceive = lambda: bad
    for ask in (lambda: world.observe(lanes), lambda: begun(domain)):
        with pytest.raises(DomainError, match=r"CartDriver\.perceive returned .*; return 2 finite"):
            ask()
    with pytest.raises(DomainError, match="return 2 finite"):
        world.step(lanes, push(0.1))


@pytest.mark.parametrize(("name", "what"), [("step", "motion"), ("test", "test")])
def test_a_method_that_is_missing_is_named(name: str, what: str, tmp_path: Path) -> None:
    driver: Any = CartDriver()
    setattr(driver, name, None)
    with pytest.raises(DomainError, match=f"has no method {name}, which carries out a {what}"):
        cart(tmp_path / "log", driver)
    assert not (tmp_path / "log").exists()


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
    domain = on_robot(simulated, Rewired(), JsonLines(tmp_path / "log"))
    assert isinstance(domain, Cart)
    assert domain.simulated is simulated
    assert isinstance(simulated.world(simulated.draw("any", 1, seeded(0))), Rail)
    assert domain.settings == simulated.settings
    assert domain.percept == Cart.percept
    world, lanes = begun(domain, kind="any")
    assert lanes.percept.tolist() == [[0.0] * 4]
    _, done = world.step(lanes, torch.zeros(1, 3))
    assert done.tolist() == [True]


def test_the_robot_knows_its_names() -> None:
    class Mute(CartDriver):
        pass

    with pytest.raises(DomainError, match="driver Mute has no method sing"):
        Robot(Mute(), ("sing", "test"), JsonLines(Path("nowhere")))
