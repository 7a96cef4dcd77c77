"""What a trial of a skill is, what it costs, and what a journal says of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import CartDriver, cart, lines, pusher, told
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import unrepeatable, world_of
from support import seeded
from torch import Tensor
from watched import Watched, of_kind, stage_of, without_models

from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.environment import Lanes
from cgtorch.ground.errors import DomainError, RunError
from cgtorch.improvement.events import WorldAsked
from cgtorch.improvement.trial import (
    attempt,
    first_percepts,
    looked,
    trial_from,
    trial_tensors,
    try_skill,
)
from cgtorch.runs.journal import FileJournal
from cgtorch.simulation import rollout
from cgtorch.tabletop.world import random_scenarios

SIZE = 7


def tensors() -> dict[str, Tensor]:
    """Of a trial of three scenarios, which went through two transitions and one test."""
    return {
        "first": torch.zeros(3, SIZE),
        "solved": torch.tensor([True, False, True]),
        "transitions": torch.tensor([1, 2, 3]),
        "actions": torch.tensor([1, 0, 2]),
        "asked": torch.tensor([2, 1, 3, 3, 50, 40]),
        "percept": torch.zeros(2, SIZE),
        "control": torch.zeros(2, 3),
        "next_percept": torch.zeros(2, SIZE),
        "tested": torch.zeros(1, SIZE),
        "succeeded": torch.tensor([True]),
    }


def test_a_trial_is_read() -> None:
    trial = trial_from(tensors(), 3)
    assert trial.succeeded.tolist() == [True, False, True]
    assert trial.actions.tolist() == [1, 0, 2]
    assert trial.asked == Asked(motions=2, tests=1, looks=3, episodes=3, steps=50, simulated=40)
    assert len(trial.experience.percept) == 2


@pytest.mark.parametrize("name", sorted(tensors()))
def test_nonsense_is_one_error(name: str) -> None:
    whole = tensors()
    for bad in (torch.tensor(1.5), whole[name][:-1], whole[name][None], whole[name].half()):
        with pytest.raises(RunError, match="remove the journal") as caught:
            trial_from({**whole, name: bad}, 3)
        assert "\n" not in str(caught.value)
    del whole[name]
    with pytest.raises(RunError, match=f"lacks '{name}'"):
        trial_from(whole, 3)


def test_a_trial_of_other_scenarios_is_refused() -> None:
    for count in (0, 2, 4):
        with pytest.raises(RunError, match=f"is not one of {count} scenarios; remove the journal"):
            trial_from(tensors(), count)


@given(st.integers(0, 2**20), st.integers(1, 8), st.none() | st.integers(1, 9))
def test_what_a_trial_says_is_what_was_asked(seed: int, count: int, most: int | None) -> None:
    scenarios = random_scenarios("perimeter", count, seeded(seed))
    watched, purse = Watched(), Purse()
    trial = try_skill(nearly(0.3), watched(scenarios), purse, "practice", most)
    (about,) = watched.log
    assert trial.actions.tolist() == [about.actions[i] for i in range(count)]
    assert trial.succeeded.tolist() == [i in about.succeeded for i in range(count)]
    assert int(trial.actions.max()) <= (most or 40)
    assert torch.equal(trial.percepts, first_percepts(world_of(scenarios)))
    assert purse.spent == {"practice": trial.asked}
    assert trial.asked.actions == about.actions.total()
    assert trial.asked.looks == trial.asked.episodes == count
    assert trial.asked.tests == len(trial.experience.tested)
    assert trial.asked.motions >= len(trial.experience.percept)
    if most is None:
        skill = nearly(0.3)
        runs = rollout(skill.graph, skill.actions, world_of(scenarios), max_transitions=6)
        assert torch.equal(trial.succeeded, runs.succeeded[0])
        assert torch.equal(trial.transitions, runs.transitions[0])
    same = trial_from(trial_tensors(trial), count)
    for name, value in trial_tensors(trial).items():
        assert torch.equal(trial_tensors(same)[name], value)


def test_an_episode_that_the_budget_does_not_cover_is_not_begun() -> None:
    watched, purse = Watched(), Purse({"episodes": 4})
    try_skill(nearly(0.3), watched(random_scenarios("near", 3, seeded(0))), purse)
    before = watched.asked
    with pytest.raises(BudgetSpentError):
        try_skill(nearly(0.3), watched(random_scenarios("near", 2, seeded(0))), purse)
    assert watched.asked == before
    assert purse.total.episodes == 3


def test_low_level_steps_are_a_cost_of_the_trial_that_takes_them() -> None:
    world: Any = world_of(random_scenarios("near", 3, seeded(0)))
    world.asked, purse, step = Asked(steps=5), Purse(), world.step

    def counted(lanes: Lanes, control: Tensor) -> Any:
        world.asked += Asked(steps=len(control))
        return step(lanes, control)

    for _ in range(2):
        before, earlier = world.asked.steps, purse.total.steps
        world.step = step  # which counts nothing
        assert try_skill(nearly(0.3), world, purse).asked.steps == 0
        world.step = counted
        trial = try_skill(nearly(0.3), world, purse, "practice")
        assert trial.asked.steps == world.asked.steps - before > 0
        assert purse.total.steps == purse.spent["practice"].steps == earlier + trial.asked.steps


def test_a_journal_recalls_trials_and_looks_and_what_they_cost(tmp_path: Path) -> None:
    """The world is not asked again, and all of it is counted, though no budget covers it."""
    watched = Watched(unrepeatable)
    scenarios = [random_scenarios("near", 4, seeded(i)) for i in range(3)]

    def everything(limits: dict[str, float]) -> tuple[list[Tensor], Purse, list[Any]]:
        told: list[Any] = []
        setup = without_models(world_of=watched, journal=FileJournal(tmp_path), purse=Purse(limits))
        stage = stage_of(setup, told.append)
        seen = looked(stage, scenarios[0])
        trials = [attempt(stage, nearly(0.3), s, "trials", 5) for s in scenarios]
        found = [seen, *(t.percepts for t in trials), *(t.succeeded for t in trials)]
        return found, setup.purse, told

    first, purse, told = everything({})
    before = watched.asked
    again, other, recalled = everything({"actions": 1})
    assert watched.asked == before
    assert all(map(torch.equal, first, again))
    assert purse.spent == other.spent
    assert not other.exhausted
    events = [of_kind(each, WorldAsked) for each in (told, recalled)]
    for one, two in zip(*events, strict=True):
        assert (one.phase, one.asked, one.succeeded) == (two.phase, two.asked, two.succeeded)
        assert two.recalled
        assert not one.recalled


def test_looks_are_paid_for_and_an_episode_of_a_robot_knows_its_stage(tmp_path: Path) -> None:
    setup = without_models(purse=Purse())
    looked(stage_of(setup), random_scenarios("near", 4, seeded(0)))
    assert setup.purse.spent == {"looks": Asked(looks=4)}
    domain = cart(tmp_path / "log", CartDriver(1))
    robot: Any = replace(setup, world_of=domain.world)
    attempt(stage_of(robot), pusher(domain, 0.2), domain.draw("near", 1, seeded(0)), "practice")
    (row,) = lines(tmp_path / "log", "episode")
    assert (row["phase"], row["stage"]) == ("practice", "S1")


@pytest.mark.parametrize("bad", [None, torch.zeros(4), torch.zeros(3, SIZE), torch.ones(4, 7) > 0])
def test_looks_that_make_no_sense_are_one_error(bad: Tensor | None, tmp_path: Path) -> None:
    """Whole files with nonsense in them: somebody wrote them on purpose."""
    journal = FileJournal(tmp_path)
    journal.record("looks", {"other": torch.zeros(1)} if bad is None else {"percepts": bad})
    setup = without_models(journal=FileJournal(tmp_path))
    with pytest.raises(RunError, match="remove the journal"):
        looked(stage_of(setup), random_scenarios("near", 4, seeded(0)))


def test_a_robots_episodes_are_recalled_and_the_rest_is_carried_out(tmp_path: Path) -> None:
    """An episode that was broken off is asked again, and its data and cost belong to the trial."""

    def unplugged() -> None:
        raise DomainError("unplugged")

    path, driver, purse = tmp_path / "log", CartDriver(1), Purse()
    domain = cart(path, driver)
    skill = pusher(domain, 0.2)
    driver.script = {20: unplugged}
    with pytest.raises(DomainError, match="unplugged"):
        try_skill(skill, told(domain, count=5))
    finished = lines(path, "episode")
    assert 0 < len(finished) < 4
    driver = CartDriver(2)
    trial = try_skill(skill, told(cart(path, driver), count=5), purse)
    assert trial.asked == purse.total
    episodes, actions = lines(path, "episode"), lines(path, "action")
    assert driver.calls.count("arrange near") == 5 - len(finished)
    assert trial.succeeded.tolist() == [row["succeeded"] for row in episodes]
    motions = sum(row["what"] == "motion" for row in actions)
    assert (trial.asked.motions, trial.asked.tests) == (motions, len(actions) - motions)
    assert len(trial.experience.percept) == motions
    assert len(trial.experience.tested) == len(actions) - motions
    idle, again = CartDriver(3), Purse()
    recalled = try_skill(skill, told(cart(path, idle), count=5), again)
    assert not idle.calls
    assert again.total == purse.total == recalled.asked
    assert torch.equal(recalled.percepts, trial.percepts)
    assert torch.equal(recalled.actions, trial.actions)
    assert recalled.succeeded.tolist() == trial.succeeded.tolist()
    assert torch.equal(recalled.experience.percept, trial.experience.percept)
