"""Scores: how often a skill succeeds, and how sure that number is."""

from dataclasses import replace

import pytest
import torch
from members import nearly
from reaching import TABLE, TABLE_MODELS, small_knowledge
from support import random_skill, seeded, world
from walking import FewPaths, Walking, Walks, chain, walking_actions

from cgtorch.graphs import ActionSet, BranchingNN, ContinuousNN, Skill, SubSkill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import SettingsError
from cgtorch.improvement.trial import first_percepts, try_skill
from cgtorch.native.rank_processes import in_ranks
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import random_scenarios
from cgtorch.training.evaluate import (
    Score,
    evaluate_skill,
    robust_success,
    robust_successes,
    try_on,
)


def score(successes: int, tried: int) -> Score:
    scenarios = random_scenarios("near", tried, seeded(0))
    return Score(scenarios, first_percepts(TABLE.world(scenarios)), torch.arange(tried) < successes)


def test_a_score_is_said_in_a_word() -> None:
    few = score(3, 4)
    assert repr(few) == "Score(3 of 4)"
    assert repr(replace(few, returns=torch.tensor([1.0, 2, 3, 4.5]))) == (
        "Score(3 of 4, mean return 2.625)"
    )


@pytest.mark.parametrize(("last", "mean"), [(4.5, 2.625), (-torch.inf, None), (torch.nan, None)])
def test_returns_of_which_one_is_missing_have_no_mean(last: float, mean: float | None) -> None:
    returns = torch.tensor([1.0, 2, 3, last])
    found = replace(score(3, 4), returns=returns)
    assert found.mean_return == mean
    assert found.error == (None if mean is None else pytest.approx((2.2291667 / 4) ** 0.5))
    assert torch.equal(found.values, returns) or last != last
    assert replace(score(1, 1), returns=returns[:1]).error is None
    assert replace(score(2, 2), returns=returns[:2]).error == pytest.approx(0.5)
    assert score(3, 4).values.tolist() == [1, 1, 1, 0]
    assert score(3, 4).error is None
    assert replace(score(0, 0), returns=returns[:0]).mean_return is None
    assert score(3, 4).mean_return is None


def test_with_rewards_a_scenario_is_solved_if_its_return_reaches_the_target() -> None:
    domain, actions = Walking(), walking_actions()
    skill = Skill("walk", chain(actions, "Aim", "Step", speed=10.0), actions, 99)
    walks = domain.draw("any", 20, seeded(0))
    returns = try_skill(skill, domain.world(walks)).returns
    assert returns is not None
    domain.target_return = float(returns.median())
    found = try_on(skill, domain, walks)
    assert found.returns is not None
    assert torch.equal(found.returns, returns)
    assert torch.equal(found.succeeded, returns >= domain.target_return)
    assert 0 < found.successes < 20


def test_scenarios_come_from_the_seed() -> None:
    skill = random_skill(4, "some", paper_actions())
    first, again, other = (evaluate_skill(skill, TABLE, "left", 30, s) for s in (1, 1, 2))
    assert torch.equal(first.scenarios.object, again.scenarios.object)
    assert torch.equal(first.succeeded, again.succeeded)
    assert not torch.equal(first.scenarios.object, other.scenarios.object)
    alone = try_skill(skill, TABLE.world(first.scenarios))
    assert torch.equal(alone.succeeded, first.succeeded)


def test_parts_change_nothing_and_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    skill, told = random_skill(1, "any", paper_actions()), list[int]()
    whole = evaluate_skill(skill, TABLE, "perimeter", 20, 3, told.append)
    assert told == [20]
    monkeypatch.setattr("cgtorch.training.evaluate.PART", 7)
    parts = evaluate_skill(skill, TABLE, "perimeter", 20, 3, told.append)
    assert told == [20, 7, 7, 6]
    assert torch.equal(whole.succeeded, parts.succeeded)
    assert torch.equal(whole.scenarios.seed, parts.scenarios.seed)
    assert torch.equal(whole.percepts, parts.percepts)
    assert torch.equal(whole.percepts, first_percepts(TABLE.world(whole.scenarios)))


def test_the_score_on_some() -> None:
    mask = torch.tensor([True, False, True, True])
    some = score(2, 4).of(mask)
    assert (some.tried, some.successes) == (3, 1)
    assert torch.equal(some.scenarios.object, score(2, 4).scenarios.object[mask])
    assert torch.equal(some.percepts, first_percepts(TABLE.world(some.scenarios)))
    assert (score(2, 4).of(~mask).successes, score(2, 4).of(~mask).tried) == (1, 1)


def test_no_scenarios_are_a_score_of_none() -> None:
    score = evaluate_skill(nearly(0.3), TABLE, "near", 0, 0)
    assert (score.successes, score.tried) == (0, 0)


@pytest.mark.parametrize(("placement", "count"), [("top", 5), ("near", -1), ("", 3)])
def test_bad_requests(placement: str, count: int) -> None:
    with pytest.raises(SettingsError):
        evaluate_skill(random_skill(4, "some", paper_actions()), TABLE, placement, count, 0)


def wider_actions() -> ActionSet:
    """The paper's actions with networks that read eleven numbers."""
    paper = paper_actions()
    return ActionSet(
        paper.names, (*paper.actions[:3], ContinuousNN(inputs=11), BranchingNN(inputs=11))
    )


def test_a_skill_of_the_papers_table_can_be_tried_on_any_table() -> None:
    skill = random_skill(4, "some", paper_actions())
    score = evaluate_skill(skill, TABLE, "general", 30, 1)
    assert score.tried == 30
    assert torch.equal(try_skill(skill, TABLE.world(score.scenarios)).succeeded, score.succeeded)


def test_a_skill_must_read_what_there_is_to_see() -> None:
    narrow, wide = (random_skill(4, "some", a) for a in (paper_actions(), wider_actions()))
    assert evaluate_skill(wide, TABLE, "general-clutter", 10, 1).tried == 10
    outer = wider_actions().extended(["some"], [SubSkill(narrow)])
    for skill, kind, reads, has in (
        (narrow, "general-clutter", 7, 11),
        (random_skill(5, "outer", outer), "general-clutter", 7, 11),
        (wide, "general", 11, 7),
        (wide, "near", 11, 7),
    ):
        says = f"'some' reads percepts of {reads} numbers, .* of {kind} have {has}; use"
        with pytest.raises(SettingsError, match=says):
            evaluate_skill(skill, TABLE, kind, 10, 1)


def test_a_promise_holds_under_every_error_drawn() -> None:
    """What the models promise, against running each imagined scenario by itself."""
    skill, knowledge = nearly(0.3), small_knowledge()
    percepts = first_percepts(world(0, 20))
    found = robust_success(TABLE_MODELS, skill, knowledge, percepts, seeded(3), replicas=5)
    place = TABLE_MODELS.imagine(knowledge, percepts, 5, seeded(3))
    one_by_one = [
        all(
            bool(rollout(skill.graph, skill.actions, place, scenarios=torch.tensor([i])).succeeded)
            for i in range(5 * row, 5 * row + 5)
        )
        for row in range(20)
    ]
    assert found.tolist() == one_by_one
    assert 0 < sum(one_by_one) < 20


def test_where_models_predict_robust_success_there_is_a_score_of_its_own() -> None:
    skill, knowledge, every = nearly(0.3), small_knowledge(), score(7, 12)
    found = robust_successes(every, skill, knowledge, TABLE_MODELS, 3)
    rows = robust_success(TABLE_MODELS, skill, knowledge, every.percepts, seeded(3))
    assert found is not None
    assert 0 < found.tried == int(rows.sum()) < 12
    assert found.succeeded.tolist() == every.succeeded[rows].tolist()
    other = replace(every, percepts=every.percepts[:, 1:])
    assert robust_successes(other, skill, knowledge, TABLE_MODELS, 3) is None


class FewAtOnce(Walking):
    """Walks of which few run at once, in worlds that are kept."""

    def __init__(self) -> None:
        super().__init__()
        self.worlds = list[FewPaths]()

    def world(self, scenarios: Walks) -> FewPaths:
        self.worlds.append(FewPaths(scenarios))
        return self.worlds[-1]


def test_ranks_share_the_scenarios_where_few_run_at_once() -> None:
    skill, found, begun = random_skill(5, "any", walking_actions()), list[Score](), list[int]()
    alone = evaluate_skill(skill, FewAtOnce(), "any", 21, 4)

    def work() -> None:
        domain = FewAtOnce()
        found.append(evaluate_skill(skill, domain, "any", 21, 4))
        begun.extend(
            ranks.all_gather(torch.tensor([sum(each.begun for each in domain.worlds)]), 2).tolist()
        )

    in_ranks(work, 2)
    assert begun == [10, 11]
    assert torch.equal(found[0].percepts, alone.percepts)
    assert torch.equal(found[0].succeeded, alone.succeeded)
    assert found[0].returns is not None
    assert alone.returns is not None
    assert torch.equal(found[0].returns, alone.returns)
    assert found[0].tried == 21
