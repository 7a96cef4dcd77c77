"""Why a skill fails: kinds, examples, what Γ and C say, and where prediction and world part."""

import json
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import pytest
import torch
from driven_cart import cart, pusher
from members import nearly
from reaching import TABLE, small_knowledge
from support import random_skill, seeded
from trained import Trained

from cgtorch import open_run
from cgtorch.domains.registry import make_domain
from cgtorch.ground.errors import SettingsError
from cgtorch.ground.fields import named
from cgtorch.report.failure_files import write_failures
from cgtorch.report.failure_words import FIRST, LAST, as_text, table_of
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training import failures
from cgtorch.training.evaluate import Score, evaluate_skill
from cgtorch.training.explained import explained
from cgtorch.training.failures import Background, failures_of, split_of

SKILL = nearly(0.25)
SCORE = evaluate_skill(SKILL, TABLE, "perimeter", 60, 2)


def known() -> Background:
    return Background(small_knowledge(), modelled=True)


def test_each_failure_is_of_one_kind_and_the_most_frequent_comes_first() -> None:
    assert 5 < SCORE.successes < 55
    found = failures_of(SKILL, TABLE, SCORE)
    kinds = found.kinds
    rows = sorted(row for kind in kinds for row in kind.scenarios)
    assert rows == (~SCORE.succeeded).nonzero()[:, 0].tolist()
    assert found.looked == found.failed == len(rows)
    assert found.lucky == 0
    sizes = [len(kind.scenarios) for kind in kinds]
    assert sizes == sorted(sizes, reverse=True)
    assert len({(kind.end, kind.node) for kind in kinds}) == len(kinds)
    for kind in kinds:
        last = kind.way.acts[-1]
        assert kind.node == f"{last.node} → {last.outcome}"
        assert kind.way.end == kind.end
        assert kind.way.parts is None
        assert all(motion.predicted is None for act in kind.way.acts for motion in act.motions)
        looked = [number for cause in kind.causes for number in cause.scenarios]
        assert set(looked) <= set(kind.scenarios)
        assert kind.scenarios[0] in kind.causes[0].scenarios
    assert sum(found.causes().values()) == sum(len(c.scenarios) for k in kinds for c in k.causes)


def test_what_succeeds_when_it_is_met_again_is_no_failure() -> None:
    every = replace(SCORE, succeeded=torch.zeros_like(SCORE.succeeded))
    found, wanted = failures_of(SKILL, TABLE, every), failures_of(SKILL, TABLE, SCORE)
    assert [kind.scenarios for kind in found.kinds] == [kind.scenarios for kind in wanted.kinds]


@pytest.mark.parametrize("seed", range(4))
def test_the_way_is_that_of_a_rollout(seed: int) -> None:
    skill = random_skill(seed, "some", paper_actions(), max_transitions=9)
    score = evaluate_skill(skill, TABLE, "near", 12, seed)
    for kind in failures_of(skill, TABLE, score).kinds:
        for row in kind.scenarios[:1]:
            world = TABLE.world(score.scenarios[row : row + 1])
            runs = rollout(skill.graph, skill.actions, world, max_transitions=9)
            acts = kind.way.acts
            assert len(acts) == int(runs.transitions)
            assert (kind.end == "timeout") == bool(runs.timed_out)
            assert torch.equal(acts[-1].percept, runs.percept[0, 0])
            assert torch.equal(kind.way.first, score.percepts[row])
            before = kind.way.first
            for act in acts:
                if not act.motions and "Detect" not in act.node:
                    assert torch.equal(act.percept, before)
                for motion in act.motions:
                    assert "MoveBase" in act.node
                    assert torch.equal(motion.became, act.percept)
                assert (act.refused is None) or not act.motions
                before = act.percept


def test_a_refused_control_is_told_and_where_nothing_moves_any_more() -> None:
    """The table is in the way of a base that drives on and on."""
    score = evaluate_skill(nearly(1.0), TABLE, "near", 8, 0)
    (kind, *_) = failures_of(nearly(1.0), TABLE, score).kinds
    refused = [i for i, act in enumerate(kind.way.acts) if act.refused is not None]
    assert refused
    assert all(kind.way.acts[i].outcome == "failure" for i in refused)
    assert kind.way.acts[refused[0]].refused.tolist() == pytest.approx([1.0, 0.0, 0.0])  # type: ignore[union-attr]
    moved = [i for i, act in enumerate(kind.way.acts) if act.motions]
    assert kind.way.still == (moved[-1] + 1 if moved else 0)
    assert "refused: dx 1 m, dy 0 m, dθ 0 rad" in str(table_of(kind.way, TABLE, FIRST, LAST))


def test_what_gamma_and_c_say_and_where_the_world_parts_from_it() -> None:
    """A Γ that is wrong by far parts from the world with the first motion."""
    models = small_knowledge()
    kinds = failures_of(SKILL, TABLE, SCORE, known()).kinds
    moved = [kind for kind in kinds if any(act.motions for act in kind.way.acts)]
    assert moved
    for kind in moved:
        before = kind.way.first
        for act in kind.way.acts:
            chance = float(models.classifier(act.percept[None]))
            assert act.chance == pytest.approx(chance, abs=1e-6)
            for motion in act.motions:
                about = before[None], motion.control[None]
                assert torch.allclose(motion.predicted, models.gamma(*about)[0])  # type: ignore[arg-type]
                assert motion.novelty == pytest.approx(float(models.gamma.novelty(*about)))
                assert motion.error is not None
                assert motion.errors is not None
                assert motion.errors.shape == act.percept.shape
            before = act.percept
    wrong: Any = replace(models, gamma=Shifted(models.gamma))
    for kind in failures_of(SKILL, TABLE, SCORE, Background(wrong, True)).kinds:
        first = [number for number, act in enumerate(kind.way.acts) if act.motions]
        assert kind.way.parts == (first[0] if first else None)
        for motion in (m for act in kind.way.acts for m in act.motions):
            assert int(motion.errors.argmax()) == 5  # type: ignore[union-attr]


class Shifted:
    """A Γ that says something else of the object's y outside its data."""

    def __init__(self, gamma: Any) -> None:
        self.gamma = gamma

    def __call__(self, percept: torch.Tensor, control: torch.Tensor) -> torch.Tensor:
        return self.predict_with_novelty(percept, control)[0]

    def predict_with_novelty(self, *about: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        after, novelty = self.gamma.predict_with_novelty(*about)
        after[:, 5] += 100.0 * (len(after) == 1)
        return after, novelty

    def errors(self, predicted: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        errors: torch.Tensor = self.gamma.errors(predicted, seen)
        return errors


def test_files_say_the_same(tmp_path: Path) -> None:
    found = failures_of(SKILL, TABLE, SCORE, known())
    paths = write_failures(tmp_path / "why", found, SKILL, TABLE, SCORE.scenarios)
    assert [path.name for path in paths] == ["failures.md", "failures.json"]
    data = json.loads(paths[1].read_text())
    assert data["skill"] == SKILL.name
    assert data["causes"] == found.causes()
    assert data["blame"] == found.blame
    assert [row["text"] for row in data["advice"]] == [advice.text for advice in found.advice]
    for row, kind in zip(data["kinds"], found.kinds, strict=True):
        assert row["scenarios"] == list(kind.scenarios)
        assert row["causes"] == {cause.name: list(cause.scenarios) for cause in kind.causes}
        assert [act["outcome"] for act in row["way"]] == [act.outcome for act in kind.way.acts]
        names = [field.name for field in TABLE.percept]
        first = kind.way.first.tolist()
        assert row["first"] == pytest.approx(dict(zip(names, first, strict=True)))
        for act, one in zip(row["way"], kind.way.acts, strict=True):
            assert len(act["motions"]) == len(one.motions)
    text = paths[0].read_text()
    assert f"{60 - SCORE.successes} of 60 scenarios fail." in text
    for number, kind in enumerate(found.kinds, 1):
        assert f"## {number}. {kind.end}, ending at {kind.node}\n" in text


def test_a_long_way_is_cut_in_the_text_and_few_failures_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(failures, "MOST", 3)
    found = failures_of(SKILL, TABLE, SCORE)
    assert sum(len(kind.scenarios) for kind in found.kinds) == found.looked == 3
    way = found.kinds[0].way
    long = replace(found.kinds[0], way=replace(way, acts=way.acts[:1] * 60))
    text = as_text(replace(found, kinds=(long,)), TABLE, {})
    assert text.count("\n| ") == FIRST + LAST + 4
    assert "\n| 59 | " in text
    assert "\n| … | 20 more steps |" in text
    assert "3 of them were looked at." in text


def test_the_causes_of_many_long_failures_are_looked_for_in_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where each takes long; there are some at least."""
    few = [len(c.scenarios) for k in failures_of(SKILL, TABLE, SCORE).kinds for c in k.causes]
    monkeypatch.setattr(failures, "ACTS", 1)
    kinds = failures_of(SKILL, TABLE, SCORE).kinds
    looked = [sum(len(cause.scenarios) for cause in kind.causes) for kind in kinds]
    assert looked == [min(failures.FEWEST, len(kind.scenarios)) for kind in kinds]
    assert sum(few) > sum(looked)


@pytest.mark.parametrize("above", [True, False])
def test_what_tells_failures_from_successes_at_the_start(above: bool) -> None:
    percepts = torch.rand(40, 3, generator=seeded(0))
    percepts[:, 1] = torch.arange(40.0)
    percepts[:, 2] = torch.arange(40) // 2 % 2  # equal numbers are on one side of a threshold
    failed = (percepts[:, 1] > 29.5) == above
    failed[0] = True
    score = Score(None, percepts, ~failed)
    split = split_of(score, named("a", "b", "c", unit="m"))
    assert split is not None
    assert (split.name, split.unit, split.threshold, split.above) == ("b", "m", 29.5, above)
    assert split.failed == (int(failed.sum()) - above, int(failed.sum()))
    assert split.solved == (0, int((~failed).sum()))
    few = replace(score, succeeded=torch.arange(40) > 1)
    assert split_of(few, named("a", "b", "c")) is None, "as chance would tell two apart, too"
    more = replace(score, succeeded=torch.arange(40) > 4)
    assert split_of(more, named("a", "b", "c")) is not None
    chance = replace(score, succeeded=torch.arange(40) % 2 == 0)
    assert split_of(chance, named("a", "b", "c")) is None


def test_equal_numbers_are_on_one_side_of_a_threshold() -> None:
    """Though the order of the scenarios would divide them."""
    percepts = torch.tensor([0.0] * 20 + [1.0] * 20)[:, None]
    failed = torch.arange(40) >= 30
    split = split_of(Score(None, percepts, ~failed), named("a"))
    assert split is not None
    assert (split.threshold, split.failed, split.solved) == (0.5, (10, 10), (10, 30))
    turned = split_of(Score(None, -percepts, ~failed), named("a"))
    assert turned is not None
    assert (turned.threshold, turned.above, turned.failed) == (-0.5, False, (10, 10))


@pytest.mark.parametrize(("numbers", "fewest"), [(3, 3), (20, 4)])
def test_the_more_numbers_there_are_the_more_failures_tell_something(
    numbers: int, fewest: int
) -> None:
    """With f of 40 failing, 2 · numbers · exp(-2 f (40 - f) / 40) has to be 5 % at most."""
    percepts = torch.zeros(40, numbers)
    percepts[:, 1] = torch.arange(40.0)
    for failures_, told in ((fewest - 1, False), (fewest, True)):
        score = Score(None, percepts, torch.arange(40) >= failures_)
        assert (split_of(score, named(*map(str, range(numbers)))) is not None) is told


@pytest.mark.parametrize(("share", "told"), [(0.45, False), (0.55, True)])
def test_a_number_has_to_tell_three_of_four_apart(share: float, told: bool) -> None:
    """A balanced accuracy of (1 + share) / 2, in so many scenarios that it is no chance."""
    good = torch.arange(2000) % 2 == 0
    percepts = (~good & (torch.arange(2000) < 2000 * share)).float()[:, None]
    assert (split_of(Score(None, percepts, good), named("a")) is not None) is told


def test_a_number_without_a_name_has_its_place() -> None:
    percepts = torch.stack([torch.zeros(40), torch.arange(40.0)], 1)
    split = split_of(Score(None, percepts, torch.arange(40) < 20), named("a"))
    assert split is not None
    assert (split.name, split.unit, split.threshold) == ("1", "", 19.5)
    for good in (torch.ones(40, dtype=torch.bool), torch.zeros(40, dtype=torch.bool)):
        assert split_of(Score(None, percepts, good), named("a")) is None


def test_a_film_of_each_kind_where_the_domain_draws(tmp_path: Path) -> None:
    domain = make_domain("gymnasium:CartPole-v1")
    actions = domain.actions()
    skill = replace(random_skill(0, "any", actions), actions=actions)
    score = evaluate_skill(skill, domain, domain.kinds[0], 6, 0)
    found = failures_of(skill, domain, score)
    paths = write_failures(tmp_path, found, skill, domain, score.scenarios)
    films = [path for path in paths if path.suffix == ".webp"]
    assert [path.name for path in films] == [f"kind-{i}.webp" for i in range(1, len(films) + 1)]
    assert all(path.read_bytes()[:4] == b"RIFF" for path in films)
    data = json.loads((tmp_path / "failures.json").read_text())
    assert [kind["film"] for kind in data["kinds"]] == [path.name for path in films]
    for kind, row in zip(found.kinds, data["kinds"], strict=True):
        assert len(kind.returns) == len(kind.scenarios)
        assert row["returns"] == [r if isfinite(r) else None for r in kind.returns]


def test_who_cannot_draw_is_asked_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Graphics libraries may end a process that tries again."""
    tried = list[int]()

    def film(*given: Any) -> None:
        tried.append(1)
        raise SettingsError("MuJoCo cannot draw here")

    monkeypatch.setattr(TABLE.pictures, "film", film)
    found = failures_of(SKILL, TABLE, SCORE)
    assert len(found.kinds) > 1
    assert len(write_failures(tmp_path, found, SKILL, TABLE, SCORE.scenarios)) == 2
    assert tried == [1]


def test_a_run_tells_why_its_skill_fails(trained: Trained) -> None:
    run = open_run(trained.folder)
    score = run.evaluate(5, "far", seed=0)
    assert sum(len(kind.scenarios) for kind in run.failures(score).kinds) == 5 - score.successes
    worse = run.evaluate(5, "far", seed=0, skill=SKILL)  # it fails on every machine
    kinds = run.failures(worse, SKILL).kinds
    assert sum(len(kind.scenarios) for kind in kinds) == 5 - worse.successes > 0
    assert all(act.chance is not None for kind in kinds for act in kind.way.acts)
    with pytest.raises(SettingsError, match=r"of a skill .* that run .* does not have; give a sc"):
        run.failures(worse)
    with pytest.raises(SettingsError, match=r"score is of skill .*, and skill is another one"):
        run.failures(score, SKILL)


def test_a_score_is_of_the_skill_that_was_tried(trained: Trained) -> None:
    run = open_run(trained.folder)
    first, *_, last = run.skills.values()
    score = run.evaluate(20, "far", skill=first)
    assert score.successes < run.evaluate(20, "far").successes
    found = run.failures(score)
    assert found.skill == first.name != last.name
    assert sum(len(kind.scenarios) for kind in found.kinds) == 20 - score.successes
    assert repr(run.failures(score, first).kinds) == repr(found.kinds)


def test_a_score_of_another_run_has_no_failures_in_this_one(trained: Trained) -> None:
    run = open_run(trained.folder)
    pole = make_domain("gymnasium:CartPole-v1")
    other = Score(pole.draw("starts", 1, seeded(0)), torch.zeros(1, 4), torch.tensor([False]))
    with pytest.raises(SettingsError, match="score is of scenarios of another domain than 'table"):
        run.failures(other)


def test_a_report_tries_the_scenarios_of_all_stages_and_those_missed(trained: Trained) -> None:
    why = explained(open_run(trained.folder))
    assert why is not None
    tried = {each.kind: each for each in why.found.tried}
    assert list(tried)[:2] == ["near", "left"]
    assert tried["left"].tried == 40
    fresh = trained.results[-1]["fresh"]
    assert tried["left"].succeeded == fresh["succeeded"], "as the result of the stage says"
    assert why.succeeded is not None
    assert len(why.scenarios) == len(why.succeeded) == sum(each.tried for each in tried.values())
    assert why.found.label(0) == "near 0"
    assert why.found.label(41) == "left 1"


def test_a_robot_is_not_asked_again(tmp_path: Path) -> None:
    domain = cart(tmp_path / "log")
    missed = torch.zeros(3, dtype=torch.bool)
    score = Score(domain.draw("near", 3, seeded(0)), torch.zeros(3, 2), missed)
    with pytest.raises(SettingsError, match="a robot cannot be put back to where it failed"):
        failures_of(pusher(domain, 0.1), domain, score)
