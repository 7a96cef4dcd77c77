"""Why a skill fails: kinds, examples, what Γ and C say, and where prediction and world part."""

import json
from dataclasses import replace
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
from cgtorch.simulation import rollout
from cgtorch.tabletop.actions import paper_actions
from cgtorch.training import failures
from cgtorch.training.evaluate import Score, evaluate_skill
from cgtorch.training.failures import FIRST, LAST, as_text, failures_of, write_failures

SKILL = nearly(0.25)
SCORE = evaluate_skill(SKILL, TABLE, "perimeter", 60, 2)


def test_each_failure_is_of_one_kind_and_the_most_frequent_comes_first() -> None:
    assert 5 < SCORE.successes < 55
    kinds = failures_of(SKILL, TABLE, SCORE)
    rows = sorted(row for kind in kinds for row in kind.scenarios)
    assert rows == (~SCORE.succeeded).nonzero()[:, 0].tolist()
    sizes = [len(kind.scenarios) for kind in kinds]
    assert sizes == sorted(sizes, reverse=True)
    assert len({(kind.end, kind.node) for kind in kinds}) == len(kinds)
    for kind in kinds:
        last = kind.way[-1]
        assert kind.node == f"{last.node}: {last.outcome}"
        assert kind.parts is None
        assert all(motion.predicted is None for act in kind.way for motion in act.motions)


def test_what_succeeds_when_it_is_met_again_is_no_failure() -> None:
    every = replace(SCORE, succeeded=torch.zeros_like(SCORE.succeeded))
    found, wanted = failures_of(SKILL, TABLE, every), failures_of(SKILL, TABLE, SCORE)
    assert [kind.scenarios for kind in found] == [kind.scenarios for kind in wanted]


@pytest.mark.parametrize("seed", range(4))
def test_the_way_is_that_of_a_rollout(seed: int) -> None:
    skill = random_skill(seed, "some", paper_actions(), max_transitions=9)
    score = evaluate_skill(skill, TABLE, "near", 12, seed)
    for kind in failures_of(skill, TABLE, score):
        for row in kind.scenarios[:1]:
            world = TABLE.world(score.scenarios[row : row + 1])
            runs = rollout(skill.graph, skill.actions, world, max_transitions=9)
            assert len(kind.way) == int(runs.transitions)
            assert (kind.end == "timeout") == bool(runs.timed_out)
            assert torch.equal(kind.way[-1].percept, runs.percept[0, 0])
            assert torch.equal(kind.first, score.percepts[row])
            before = kind.first
            for act in kind.way:
                if not act.motions and "Detect" not in act.node:
                    assert torch.equal(act.percept, before)
                for motion in act.motions:
                    assert "MoveBase" in act.node
                    assert torch.equal(motion.became, act.percept)
                before = act.percept


def test_what_gamma_and_c_say_and_where_the_world_parts_from_it() -> None:
    """A Γ that is wrong by far parts from the world with the first motion."""
    known = small_knowledge()
    kinds = failures_of(SKILL, TABLE, SCORE, known)
    moved = [kind for kind in kinds if any(act.motions for act in kind.way)]
    assert moved
    for kind in moved:
        before = kind.first
        for act in kind.way:
            assert act.chance == pytest.approx(float(known.classifier(act.percept[None])), abs=1e-6)
            for motion in act.motions:
                predicted = known.gamma(before[None], motion.control[None])[0]
                assert torch.allclose(motion.predicted, predicted)
                assert motion.error is not None
            before = act.percept
    wrong: Any = replace(known, gamma=Shifted(known.gamma))
    for kind in failures_of(SKILL, TABLE, SCORE, wrong):
        first = [number for number, act in enumerate(kind.way) if act.motions]
        assert kind.parts == (first[0] if first else None)


class Shifted:
    """A Γ that says something else outside its data."""

    def __init__(self, gamma: Any) -> None:
        self.gamma = gamma

    def __call__(self, percept: torch.Tensor, control: torch.Tensor) -> torch.Tensor:
        after: torch.Tensor = self.gamma(percept, control)
        return after + 100.0 * (len(percept) == 1)

    def errors(self, predicted: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        errors: torch.Tensor = self.gamma.errors(predicted, seen)
        return errors


def test_files_say_the_same(tmp_path: Path) -> None:
    kinds = failures_of(SKILL, TABLE, SCORE, small_knowledge())
    paths = write_failures(tmp_path / "why", SKILL, TABLE, SCORE, kinds)
    assert [path.name for path in paths] == ["failures.md", "failures.json"]
    data = json.loads(paths[1].read_text())
    assert data["skill"] == SKILL.name
    for row, kind in zip(data["kinds"], kinds, strict=True):
        assert row["scenarios"] == list(kind.scenarios)
        assert [act["outcome"] for act in row["way"]] == [act.outcome for act in kind.way]
        names = [field.name for field in TABLE.percept]
        assert row["first"] == pytest.approx(dict(zip(names, kind.first.tolist(), strict=True)))
        for act, one in zip(row["way"], kind.way, strict=True):
            assert len(act["motions"]) == len(one.motions)
    text = paths[0].read_text()
    assert f"{60 - SCORE.successes} of 60 scenarios failed." in text
    for number, kind in enumerate(kinds, 1):
        assert f"## {number}. {kind.end} at {kind.node}\n" in text


def test_a_long_way_is_cut_in_the_text_and_few_failures_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(failures, "MOST", 3)
    kinds = failures_of(SKILL, TABLE, SCORE)
    assert sum(len(kind.scenarios) for kind in kinds) == 3
    long = replace(kinds[0], way=kinds[0].way[:1] * 60)
    text = as_text("some", SCORE, [long], TABLE.control, {})
    assert text.count("\n| ") == FIRST + LAST + 2
    assert "\n| 59 | " in text
    assert f"{len(long.scenarios)} of them were looked at." in text


def test_a_film_of_each_kind_where_the_domain_draws(tmp_path: Path) -> None:
    domain = make_domain("gymnasium:CartPole-v1")
    actions = domain.actions()
    skill = replace(random_skill(0, "any", actions), actions=actions)
    score = evaluate_skill(skill, domain, domain.kinds[0], 6, 0)
    kinds = failures_of(skill, domain, score)
    paths = write_failures(tmp_path, skill, domain, score, kinds)
    films = [path for path in paths if path.suffix == ".webp"]
    assert [path.name for path in films] == [f"kind-{i}.webp" for i in range(1, len(films) + 1)]
    assert all(path.read_bytes()[:4] == b"RIFF" for path in films)
    data = json.loads((tmp_path / "failures.json").read_text())
    assert [kind["film"] for kind in data["kinds"]] == [path.name for path in films]


def test_who_cannot_draw_is_asked_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Graphics libraries may end a process that tries again."""
    tried = list[int]()

    def film(*given: Any) -> None:
        tried.append(1)
        raise SettingsError("MuJoCo cannot draw here")

    monkeypatch.setattr(TABLE.pictures, "film", film)
    kinds = failures_of(SKILL, TABLE, SCORE)
    assert len(kinds) > 1
    assert len(write_failures(tmp_path, SKILL, TABLE, SCORE, kinds)) == 2
    assert tried == [1]


def test_a_run_tells_why_its_skill_fails(trained: Trained) -> None:
    run = open_run(trained.folder)
    score = run.evaluate(40, "far", seed=1)
    kinds = run.failures(score)
    assert sum(len(kind.scenarios) for kind in kinds) == 40 - score.successes
    assert all(act.chance is not None for kind in kinds for act in kind.way)


def test_a_robot_is_not_asked_again(tmp_path: Path) -> None:
    domain = cart(tmp_path / "log")
    missed = torch.zeros(3, dtype=torch.bool)
    score = Score(domain.draw("near", 3, seeded(0)), torch.zeros(3, 2), missed)
    with pytest.raises(SettingsError, match="a robot cannot be put back to where it failed"):
        failures_of(pusher(domain, 0.1), domain, score)
