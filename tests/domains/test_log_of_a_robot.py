"""The log of a robot: what happened is told by it, and what was done is not asked again."""

from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import END, CartDriver, begun, cart, lines, push, pusher, told
from hypothesis import given, settings
from hypothesis import strategies as st
from support import models_of, seeded

from cgtorch.domains.exploration import EXPLORATION, Exploration
from cgtorch.domains.robot import episodes_in
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.environment import Environment
from cgtorch.ground.errors import DomainError, RunError
from cgtorch.improvement.trial import Trial, try_skill
from cgtorch.simulation import Recording


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


def test_trials_of_another_stage_are_not_recalled(tmp_path: Path) -> None:
    domain = cart(tmp_path / "log")
    try_skill(pusher(domain, 0.2), told(domain, stage="S0"))
    driver = CartDriver(1)
    again = cart(tmp_path / "log", driver)
    try_skill(pusher(again, 0.2), told(again, stage="S1"))
    assert driver.calls.count("arrange near") == 3
    driver.calls.clear()
    try_skill(pusher(again, 0.2), told(again, stage="S0"))
    assert not driver.calls


def test_an_episode_without_a_motion_is_recalled(tmp_path: Path) -> None:
    domain, purse = cart(tmp_path / "log"), Purse()
    tester = pusher(domain, 0.0, ("Test",))
    trial = try_skill(tester, told(domain), purse)
    assert trial.asked.motions == 0
    other = Purse()
    again = try_skill(tester, told(cart(tmp_path / "log")), other)
    assert same(trial, again)
    assert again.experience.whole(2)
    assert other.spent == purse.spent


def killed(path: Path, driver: CartDriver, after: int) -> None:
    """A process that is killed in the middle of an episode, after so many actions."""
    domain = cart(path, driver)
    world, lanes = begun(domain)
    for _ in range(after):
        lanes, _ = world.step(lanes, push(0.05))


def test_what_was_broken_off_is_not_lost(tmp_path: Path) -> None:
    """Its data come with those of the next episode that ends, once."""
    path = tmp_path / "log"
    domain = cart(path)
    first = try_skill(pusher(domain, 0.2), told(domain))
    killed(path, CartDriver(2), 3)
    again = cart(path, CartDriver(3))
    purse, skill = Purse(), pusher(again, 0.2)
    recalled = try_skill(skill, told(again), purse)
    assert same(first, recalled)
    fresh = try_skill(skill, told(again), purse)
    moved = [row for row in lines(path, "action") if row["what"] == "motion" and row["done"]]
    assert len(recalled.experience.percept) + len(fresh.experience.percept) == len(moved)
    more = try_skill(skill, told(again), purse)
    assert len(more.experience.percept) <= more.asked.motions
    tests = [row for row in lines(path, "action") if row["what"] == "test"]
    known = [len(t.experience.tested) for t in (recalled, fresh, more)]
    assert sum(known) == len(tests)


def test_what_was_broken_off_is_counted(tmp_path: Path) -> None:
    """Else a robot would be asked more than its budget, each time that it is killed."""
    path = tmp_path / "log"
    killed(path, CartDriver(2), 3)
    domain, purse = cart(path, CartDriver(3)), Purse()
    try_skill(pusher(domain, 0.2), told(domain), purse)
    rows = lines(path, "action")
    assert purse.total.actions == len(rows)
    assert purse.total.looks == len(lines(path, "look"))


def test_what_was_broken_off_and_learned_is_not_learned_again(tmp_path: Path) -> None:
    """Its stage was finished by the second process, and a third one begins another."""
    path = tmp_path / "log"
    killed(path, CartDriver(2), 3)
    domain = cart(path, CartDriver(3))
    second = try_skill(pusher(domain, 0.2), told(domain, stage="S0"))
    last = cart(path, CartDriver(4))
    third = try_skill(pusher(last, 0.2), told(last, stage="S1"))
    moved = [row for row in lines(path, "action") if row["what"] == "motion" and row["done"]]
    assert len(second.experience.percept) + len(third.experience.percept) == len(moved)


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
        for rows, wanted in zip(vars(found).values(), expected(some), strict=True):
            assert torch.equal(rows, wanted)

    start = [each for each in happened if each["stage"] == "start"]
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
    left = [e for e in happened if e["ended"] is None and e["stage"] != "start"]
    trial = try_skill(skill, told(again, stage="S2", count=1))
    own = expected(left)
    for rows, wanted in zip(vars(trial.experience).values(), own, strict=True):
        assert torch.equal(rows[: len(wanted)], wanted)
    assert len(trial.experience.tested) == int(trial.actions) // 2 + len(own[3])


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


def test_other_events_in_a_log_are_passed_over() -> None:
    look = {"event": "look", "stage": "S0", "phase": "trials", "episode": 1, "percept": [0, 0]}
    (found,) = episodes_in([{"event": "models", "x": 1}, look, {"event": "asked"}])
    assert found.succeeded is None
    assert not found.actions


def unplugged() -> None:
    raise DomainError("unplugged")


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
