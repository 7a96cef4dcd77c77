"""The cause of each failure: each arises in a world of its own, and is told from the others."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from members import nearly
from reaching import TABLE, Reaching, reachable, small_knowledge
from support import FOOTPRINT, circle, random_skill, seeded
from torch import Tensor

from cgtorch.domains.failures import CAUSES, Failures, Searched
from cgtorch.domains.registry import make_domain
from cgtorch.graphs import SubSkill
from cgtorch.ground.environment import Lanes
from cgtorch.tabletop.actions import paper_actions
from cgtorch.tabletop.world import Scenarios, TabletopWorld
from cgtorch.training import causes
from cgtorch.training.advice import about_search, unskilled
from cgtorch.training.evaluate import Score, evaluate_skill, try_on
from cgtorch.training.failures import Background, failures_of

AHEAD = nearly(0.25)


class Slipping(Reaching):
    """A base that drives three times as far, and backwards, which the models have not seen."""

    def world(self, scenarios: Scenarios) -> TabletopWorld:
        return Slipped(scenarios, reachable, FOOTPRINT)


class Slipped(TabletopWorld):
    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        return super().step(lanes, control * torch.tensor([-3.0, 1, 1]))


class Slippery(Reaching):
    """Objects that slip out of a hand, of which the models have not heard."""

    def world(self, scenarios: Scenarios) -> TabletopWorld:
        return TabletopWorld(scenarios, lambda at, table: at[:, 0] > 99, FOOTPRINT)

    def solvable(self, scenarios: Scenarios) -> Tensor:
        return torch.ones(len(scenarios), dtype=torch.bool)


def found_in(domain: Any, skill: Any, known: Background, kind: str = "near") -> Failures:
    return failures_of(skill, domain, evaluate_skill(skill, domain, kind, 12, 3), known)


def models() -> Background:
    return Background(small_knowledge(), modelled=True)


def test_gamma_is_to_blame_where_the_world_leads_elsewhere() -> None:
    found = found_in(Slipping(robot=TABLE.robot, networks="percept"), AHEAD, models())
    assert next(iter(found.causes())) == "gamma"
    kind = found.kinds[0]
    assert kind.causes[0].name == "gamma"
    assert kind.way.parts is not None
    assert found.blame.startswith("The models are to blame for ")
    assert f"(Γ for {found.causes()['gamma']}" in found.blame
    (advice,) = [each for each in found.advice if each.cause == "gamma"]
    assert advice.count == found.causes()["gamma"]
    assert "In kind 1 Γ is wrong about " in advice.text
    assert f" in step {kind.way.parts}; " in advice.text


def test_c_is_to_blame_where_it_says_success_and_the_world_does_not() -> None:
    found = found_in(Slippery(robot=TABLE.robot, networks="percept"), AHEAD, models())
    assert found.causes().get("classifier", 0) > 0
    assert "gamma" not in found.causes()
    for kind in found.kinds:
        if kind.causes[0].name == "classifier":
            grasps = [act.chance or 0 for act in kind.way.acts if "Grasp" in act.node]
            assert max(grasps) > 0.5
    assert "C says success where a test in the world fails" in str(found.advice)


def test_the_search_is_to_blame_where_the_models_foresee_the_failure() -> None:
    found = found_in(TABLE, nearly(-0.2), models())
    assert set(found.causes()) == {"search"}
    assert found.blame == (
        f"The search is to blame for {found.failed} of {found.failed}: there the skill fails in Γ "
        "and C, too."
    )


def test_no_model_is_to_blame_without_models_and_it_is_open_if_they_are_not_at_hand() -> None:
    world, absent = (found_in(TABLE, nearly(-0.2), Background(None, m)) for m in (False, True))
    assert (set(world.causes()), set(absent.causes())) == ({"world"}, {"open"})
    assert world.blame.startswith("The skill was evolved in the world itself, so no model is")
    assert "it is open" in absent.blame


def test_a_limit_that_is_too_low_also_of_a_skill_within() -> None:
    """Two actions are too few to drive and to grasp, four are enough."""
    short = replace(AHEAD, max_transitions=2)
    actions = paper_actions().extended(["short"], [SubSkill(short)])
    for skill in (short, replace(circle(actions, "short", "Detect"), max_transitions=3)):
        score = evaluate_skill(skill, TABLE, "near", 12, 3)
        assert not score.successes
        solved = try_on(replace(AHEAD, max_transitions=4), TABLE, score.scenarios).succeeded
        found = failures_of(skill, TABLE, score)
        late = {n for k in found.kinds for c in k.causes if c.name == "limit" for n in c.scenarios}
        assert late == set(solved.nonzero()[:, 0].tolist())
        assert late
        assert "raise --max-transitions" in str(found.advice)


class Chancy(Reaching):
    """Grasps that fail where the seed of the noise, divided by 4, leaves less than `bad`."""

    bad = 1

    def world(self, scenarios: Scenarios) -> TabletopWorld:
        world = Chance(scenarios, reachable, FOOTPRINT)
        world.bad = self.bad
        return world


class Chance(TabletopWorld):
    bad = 1

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        lanes, found = super().success(lanes)
        return lanes, found * (self.scenarios.seed[lanes.scenario] % 4 >= self.bad)


@pytest.mark.parametrize(("bad", "cause"), [(1, "noise"), (2, "world")])
def test_bad_luck_is_what_most_other_noise_would_have_spared(bad: int, cause: str) -> None:
    """Four other noises leave four other rests, of which one is bad, or two."""
    domain = Chancy(robot=TABLE.robot, networks="percept")
    domain.bad = bad
    score = evaluate_skill(AHEAD, domain, "near", 24, 3)
    lucky = evaluate_skill(AHEAD, TABLE, "near", 24, 3).succeeded & ~score.succeeded
    assert lucky.any()
    found = failures_of(AHEAD, domain, score)
    rows = {n for k in found.kinds for c in k.causes if c.name == cause for n in c.scenarios}
    assert set(lucky.nonzero()[:, 0].tolist()) <= rows
    assert ("They are bad luck" in str(found.advice)) == (cause == "noise")


def test_bad_luck_is_unknown_where_nothing_repeats_itself() -> None:
    domain = Chancy(robot=TABLE.robot, networks="percept")
    domain.repeats = False
    found = failures_of(AHEAD, domain, evaluate_skill(AHEAD, domain, "near", 24, 3))
    assert found.kinds
    assert "noise" not in found.causes()


def test_other_noise_is_never_that_of_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    scenarios, met = TABLE.draw("near", 5, seeded(0)), list[Scenarios]()

    def recorded(skill: Any, domain: Any, some: Scenarios) -> Score:
        met.append(some)
        good = torch.arange(len(some)) % 5 < torch.arange(len(some)) // 5
        return replace(try_on(skill, domain, some), succeeded=good)

    monkeypatch.setattr(causes, "try_on", recorded)
    share = causes._under_other_noise(AHEAD, TABLE, scenarios)
    assert causes.NOISES == 4
    assert share.tolist() == [0.75, 0.5, 0.25, 0.0, 0.0]
    (every,) = met
    assert torch.equal(every.object, scenarios.object.repeat(4, 1))
    assert len({*every.seed.tolist(), *scenarios.seed.tolist()}) == 25


def test_what_nothing_can_solve_has_no_other_cause() -> None:
    """An object in the middle of a wide table, and one at its edge."""
    near = TABLE.draw("near", 2, seeded(0))
    wide = torch.tensor([[0.0, 0, 0, 6, 6, 0.7]]).expand(2, 6)
    scenarios = replace(near, table=wide, object=torch.tensor([[0.0, 0], [-2.9, 0]]))
    score = Score(scenarios, torch.zeros(2, 7), torch.zeros(2, dtype=torch.bool))
    found = failures_of(nearly(-0.2), TABLE, score, models())
    of = {
        number: cause.name for k in found.kinds for cause in k.causes for number in cause.scenarios
    }
    assert of == {0: "unreachable", 1: "search"}
    assert "Neither is to blame for 1 that nothing can solve." in found.blame


def test_where_a_mean_counts_that_is_reached_nothing_is_to_blame() -> None:
    domain = make_domain("gymnasium:CartPole-v1")
    seen = torch.zeros(4, len(domain.percept))
    scenarios = domain.draw("starts", 4, seeded(0))
    returns = torch.tensor([520.0, 500.0, 510.0, 470.0])
    score = Score(scenarios, seen, returns >= domain.target_return, returns)
    skill = random_skill(0, "any", domain.actions())
    found = failures_of(skill, domain, score)
    assert score.mean_return == 500
    assert score.error == pytest.approx(10.8, abs=0.1)
    assert found.blame == "Neither: the target is reached."
    assert [advice.cause for advice in found.advice] == ["goal"]
    low = failures_of(skill, domain, replace(score, returns=returns / 4))
    assert [advice.cause for advice in low.advice] == [*low.causes()]


S = Searched("auto-1", 40, 20, 0.5, False, "finished")


@pytest.mark.parametrize(
    ("searched", "told", "untold"),
    [
        (
            replace(S, solving=0.0, best=0.125),
            "anything (the best fitness is 0.125)",
            "--generations",
        ),
        (replace(S, ended="goal", value=0.95), "its target of 0.95: raise --target", "--practice"),
        (
            replace(S, ended="goal", value=0.95, scarce=("--attempts 1 (usually 24)",)),
            "its target of 0.95: raise --target",
            "had little",
        ),
        (replace(S, ended="practice", value=150), "150 fresh scenarios in a row", "--population"),
        (
            replace(S, ended="limits", limits="--minutes 2"),
            "at its limits (--minutes 2): go on with cgtorch-train --resume RUN",
            "--population",
        ),
        (
            replace(S, ended="failed", scarce=("--attempts 1 (usually 24)",)),
            "The search had little: --attempts 1 (usually 24). Give it the usual first.",
            "did not rise",
        ),
        (replace(S, rising=True), "raise --generations", "--population"),
        (replace(S, ended="failed"), "raise --population", "--generations"),
        (replace(S, ended="interrupted"), "auto-1 has not come to its end", "--population"),
        (S, "Raise --population", "--generations"),
        (None, "--generations", "--target"),
    ],
)
def test_advice_about_a_search_follows_from_how_it_went(
    searched: Searched | None, told: str, untold: str
) -> None:
    text = " ".join(about_search(searched))
    assert told in text
    assert untold not in text


def test_a_run_without_a_skill_tells_whether_models_or_the_search_have_failed() -> None:
    tried = replace(S, imagined=(10, 24), met=(0, 27))
    models_, search, none, world = (
        unskilled(*about).blame
        for about in (
            (tried, "Γ and C"), (replace(tried, imagined=(0, 24)), "Γ and C"), (None, "Γ and C"),
            (tried, "the world itself, so no model is to blame"),
        )
    )  # fmt: skip
    assert "The models are to blame: in Γ and C an individual solved 10 of 24 " in models_
    assert "The search has found none in Γ and C." in search
    assert "Nothing was searched so far." in none
    assert "The search has found none in the world itself, so no model is to blame." in world


def test_every_cause_has_words() -> None:
    assert all(text and not text.endswith(".") for text in CAUSES.values())


@pytest.mark.parametrize(("solved", "cause"), [(0.5, "search"), (0.625, "gamma")])
def test_models_are_to_blame_where_most_copies_succeed_in_them(
    solved: float, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def imagined(models: Any, skill: Any, knowledge: Any, percepts: Tensor, *given: Any) -> Tensor:
        return (torch.arange(8) < 8 * solved).expand(len(percepts), 8)

    monkeypatch.setattr(causes, "imagined_successes", imagined)
    assert set(found_in(TABLE, nearly(-0.2), models()).causes()) == {cause}
