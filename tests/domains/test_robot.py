"""A robot's actions and its log: each is logged, stopped with care, and not asked for again."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import END, CartDriver, begun, cart, lines, push, pusher, told
from hypothesis import given, settings
from hypothesis import strategies as st

from cgtorch.domains.exploration import EXPLORATION
from cgtorch.domains.robot import ProtectiveStop, Robot, dataset_of, episodes_in
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.errors import DomainError, RobotStoppedError, RunError
from cgtorch.ground.files import JsonLines
from cgtorch.improvement.trial import Trial, try_skill
from cgtorch.training.deadline import deadline


def same(one: Trial, other: Trial) -> bool:
    """Whether trials are alike to the last bit, so that models which learn from them are, too."""
    pairs = zip(vars(one.experience).values(), vars(other.experience).values(), strict=True)
    return (
        torch.equal(one.succeeded, other.succeeded)
        and one.asked == other.asked
        and torch.equal(one.actions, other.actions)
        and torch.equal(one.percepts, other.percepts)
        and all(torch.equal(a, b) for a, b in pairs)
    )


def test_trials_are_recalled_from_the_log(tmp_path: Path) -> None:
    """Another process asks nothing of the robot again, and counts the same."""
    domain, purse = cart(tmp_path / "log"), Purse()
    skills = [pusher(domain, speed) for speed in (0.2, -0.3)]
    trials = [
        try_skill(skill, told(domain, phase=phase), purse, phase)
        for skill, phase in zip(skills, ("trials", "practice"), strict=True)
    ]
    before = (tmp_path / "log").read_text()
    driver, other = CartDriver(7), Purse()
    again = cart(tmp_path / "log", driver)
    recalled = [
        try_skill(skill, told(again, phase=phase), other, phase)
        for skill, phase in zip(skills, ("trials", "practice"), strict=True)
    ]
    assert all(same(*pair) for pair in zip(trials, recalled, strict=True))
    assert other.spent == purse.spent
    assert not driver.calls
    assert (tmp_path / "log").read_text() == before
    assert any(bool(t.succeeded.any()) for t in trials)
    next_one = try_skill(skills[0], told(again), other)
    assert driver.calls[0] == "arrange near"
    assert next_one.asked.episodes == 3
    assert [row["episode"] for row in lines(tmp_path / "log", "look")] == [*range(1, 10)]


@pytest.mark.parametrize("stage", ["S0", "S1"])
def test_what_was_broken_off_is_counted_and_learned_once(tmp_path: Path, stage: str) -> None:
    """Its data come with those of the next episode that ends, of whatever stage.

    Else a robot would be asked more than its budget, each time that it is killed.
    """
    path, purse = tmp_path / "log", Purse()
    domain = cart(path, CartDriver(2))
    trials = [try_skill(pusher(domain, 0.2), told(domain), purse)]
    world, lanes = begun(domain)
    for _ in range(3):
        lanes, _ = world.step(lanes, push(0.05))
    for seed, at in ((3, "S0"), (4, stage)):  # two further processes
        domain = cart(path, CartDriver(seed))
        if at == "S0":
            purse = Purse()
            assert same(try_skill(pusher(domain, 0.2), told(domain), purse), trials[0])
        trials.append(try_skill(pusher(domain, 0.2), told(domain, stage=at), purse))
        if seed == 3:
            assert purse.total.actions == len(lines(path, "action"))
            assert purse.total.looks == len(lines(path, "look"))
        elif at == "S0":  # what the second process met is recalled first
            assert same(trials[-1], trials[-2])
            trials[-1] = try_skill(pusher(domain, 0.2), told(domain), purse)
    rows = lines(path, "action")
    assert all(0 <= row["seconds"] < 60 for row in rows)
    assert all(row["seconds"] == round(row["seconds"], 3) for row in rows)  # ms
    moved = [row for row in rows if row["what"] == "motion" and row["done"]]
    assert sum(len(t.experience.percept) for t in trials) == len(moved)
    tests = [row for row in rows if row["what"] == "test"]
    assert sum(len(t.experience.tested) for t in trials) == len(tests)


EPISODE = st.tuples(
    st.sampled_from(["S0", "S1", "start"]),
    st.lists(st.sampled_from(["far", "back", "test", "wall"]), max_size=5),
    st.sampled_from([None, True, False]),
)


@settings(max_examples=25)
@given(st.lists(EPISODE, max_size=7))
def test_the_log_tells_what_happened(tmp_path_factory: pytest.TempPathFactory, plan: Any) -> None:
    path = tmp_path_factory.mktemp("robot") / "log"
    domain, happened = cart(path), list[dict[str, Any]]()
    for stage, what, succeeded in plan:
        phase = EXPLORATION if stage == "start" else "practice"
        world, lanes = begun(domain, phase=phase, stage=stage)
        about: dict[str, Any] = {"stage": stage, "ended": succeeded, "moved": [], "tests": []}
        about.update(first=lanes.percept, motions=0)
        for name in what:
            if name == "test":
                at = lanes.percept
                lanes, chance = world.success(lanes)
                about["tests"].append((at, bool(chance > 0.5)))
                continue
            by = {"far": 0.125, "back": -0.25, "wall": 3 * END}[name]
            before = lanes.percept
            lanes, done = world.step(lanes, push(by))
            about["motions"] += 1
            if done:
                about["moved"].append((before, push(by), lanes.percept))
        if succeeded is not None and phase != EXPLORATION:
            world.ended(succeeded)
        happened.append(about)
    robot = cart(path, CartDriver(1)).actor
    assert robot.episode == len(plan)
    assert robot.actions == sum(len(what) for _, what, _ in plan)

    def expected(some: list[dict[str, Any]]) -> tuple[torch.Tensor, ...]:
        moved = [row for each in some for row in each["moved"]]
        tests = [row for each in some for row in each["tests"]]
        none = torch.zeros(0, 2)
        return (
            torch.cat([none, *(row[0] for row in moved)]),
            torch.cat([none[:, :1], *(row[1] for row in moved)]),
            torch.cat([none, *(row[2] for row in moved)]),
            torch.cat([none, *(row[0] for row in tests)]),
            torch.tensor([row[1] for row in tests], dtype=torch.bool),
        )

    def assert_data(found: Any, some: list[dict[str, Any]]) -> None:
        """It begins with what happened, and is no more than that unless some was broken off."""
        for rows, wanted in zip(vars(found).values(), expected(some), strict=True):
            assert torch.equal(rows if some is not left else rows[: len(wanted)], wanted)

    left = [e for e in happened if e["ended"] is None and e["stage"] != "start"]
    data, asked = robot.explored(2, 1)
    start = [each for each in happened if each["stage"] == "start"]
    assert_data(data, start)
    motions, tests = sum(e["motions"] for e in start), sum(len(e["tests"]) for e in start)
    assert asked == Asked(motions, tests, looks=len(start))
    driver = CartDriver(1)
    again = cart(path, driver)
    skill = pusher(again, 0.2)
    for stage in ("S0", "S1"):
        mine = [e for e in happened if e["stage"] == stage and e["ended"] is not None]
        if mine:
            trial = try_skill(skill, told(again, stage=stage, count=len(mine)))
            assert trial.succeeded.tolist() == [each["ended"] for each in mine]
            assert torch.equal(trial.percepts, torch.cat([each["first"] for each in mine]))
            assert_data(trial.experience, mine)
            motions, tests = sum(e["motions"] for e in mine), sum(len(e["tests"]) for e in mine)
            assert trial.asked == Asked(motions, tests, len(mine), len(mine))
            actions = [e["motions"] + len(e["tests"]) for e in mine]
            assert trial.actions.tolist() == actions
    assert not driver.calls
    trial = try_skill(skill, told(again, stage="S2", count=1))
    assert_data(trial.experience, left)
    tests = sum(len(e["tests"]) for e in left)
    assert len(trial.experience.tested) == int(trial.actions) // 2 + tests


@pytest.mark.parametrize(
    "row",
    [
        {"event": "look", "stage": "S0", "phase": "trials", "percept": [0, 0]},
        {"event": "look", "stage": "S0", "phase": "trials", "episode": [1], "percept": [0, 0]},
        {"event": "action", "what": "test", "percept": [0, 0], "done": True},
        {"event": "action", "episode": 7},
        {"event": "episode", "episode": 7, "succeeded": True},
        {"stage": "S0"},
    ],
)
def test_a_line_that_lacks_something_is_one_error(row: dict[str, Any]) -> None:
    with pytest.raises(RunError, match=r"the log has a line without .*; restore it") as caught:
        episodes_in([row])
    assert "\n" not in str(caught.value)
    look = {"event": "look", "stage": "S0", "phase": "trials", "episode": 1, "percept": [0, 0]}
    (found,) = episodes_in([{"event": "models", "x": 1}, look, {"event": "asked"}])
    assert (found.succeeded, len(found.actions)) == (None, 0)  # other events are passed over


def test_data_have_their_shapes_and_kinds_even_if_there_are_none() -> None:
    shapes = [(0, 3), (0, 2), (0, 3), (0, 3), (0,)]
    kinds = [*[torch.float32] * 4, torch.bool]
    found = vars(dataset_of([], 3, 2)).values()
    assert [(tuple(rows.shape), rows.dtype) for rows in found] == [*zip(shapes, kinds, strict=True)]


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


@pytest.mark.parametrize("where", ["arrange", "perceive", "step"])
def test_a_stop_for_safety_pauses_the_run_whatever_is_asked(where: str, tmp_path: Path) -> None:
    """It is no failed action from which models would learn."""
    driver: Any = CartDriver()
    domain = cart(tmp_path / "log", driver)
    world, lanes = begun(domain)
    lanes, _ = world.step(lanes, push(0.1))
    setattr(driver, where, lambda *about: failing(ProtectiveStop("elbow"))())
    with pytest.raises(RobotStoppedError, match=r"stopped for safety \(elbow\); release it"):
        world.step(lanes, push(0.1)) if where == "step" else begun(domain)
    assert [row["done"] for row in lines(tmp_path / "log", "action")] == [True]


@pytest.fixture
def interruptible() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt() -> None:
    """As somebody presses Control and C in the middle of a motion, which goes on for a while."""
    time.sleep(0.05)
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_waits_for_the_end_of_a_motion_and_its_line(tmp_path: Path) -> None:
    driver = CartDriver()
    driver.script = {2: interrupt}
    domain = cart(tmp_path / "log", driver)
    world, lanes = begun(domain)
    lanes, _ = world.step(lanes, push(0.1))
    before = driver.place
    with pytest.raises(KeyboardInterrupt):
        world.step(lanes, push(0.1))
    assert driver.place == pytest.approx(before + 0.1)
    rows = lines(tmp_path / "log", "action")
    assert [row["done"] for row in rows] == [True, True]
    assert rows[1]["next"][0] == pytest.approx(driver.place, abs=1e-6)
    assert not lines(tmp_path / "log", "episode")
    world, lanes = begun(domain)  # the same process can go on, as a notebook does
    try:
        _, done = world.step(lanes, push(0.1))
    except KeyboardInterrupt:
        pytest.fail("nobody has interrupted it")
    assert done.tolist() == [True]


def test_the_end_of_the_time_waits_for_the_end_of_a_motion_and_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is no failed action."""
    monkeypatch.setattr("cgtorch.training.deadline.GRACE", 0.1)
    driver = CartDriver()
    driver.script = {1: lambda: time.sleep(0.5)}
    world, lanes = begun(cart(tmp_path / "log", driver))
    before = driver.place
    with pytest.raises(BudgetSpentError), deadline(Purse(until=time.monotonic())):
        world.step(lanes, push(0.1))
    assert driver.place == pytest.approx(before + 0.1)
    assert [row["done"] for row in lines(tmp_path / "log", "action")] == [True]


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
    with pytest.raises(DomainError, match="driver CartDriver has no method sing"):
        Robot(CartDriver(), ("sing", "test"), JsonLines(Path("nowhere")))
