"""The coreset of W: what stays covers what goes, and what goes is not forgotten."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from reaching import world_of
from support import seeded
from torch import Tensor
from watched import NONE, Watched, along, improved, keys, known, of_kind, recruited

from cgtorch.graphs import Skill
from cgtorch.improvement.compose import cover
from cgtorch.improvement.events import SkillAccepted, WorldTested
from cgtorch.improvement.setup import Progress, Setup
from cgtorch.improvement.state import StageState
from cgtorch.improvement.trial import try_skill
from cgtorch.tabletop.world import random_scenarios

EARLIER, FAR = replace(nearly(0.25), name="S0"), replace(nearly(0.55), name="far")


@given(st.integers(0, 2**31), st.integers(0, 60), st.integers(1, 70))
def test_every_scenario_has_a_kept_one_near(seed: int, count: int, size: int) -> None:
    percepts = torch.randn(count, 3, generator=seeded(seed))
    rows, distance = cover(percepts, size)
    assert rows.tolist() == sorted(set(rows.tolist()))
    assert len(rows) == min(count, size)
    if count:
        nearest = (percepts[:, None] - percepts[rows]).norm(dim=2).amin(1)
        assert distance == pytest.approx(float(nearest.max()), abs=1e-5)


def test_the_same_percept_is_kept_once() -> None:
    rows, distance = cover(torch.eye(3).repeat(4, 1), 10)
    assert rows.tolist() == [0, 1, 2]
    assert distance == 0
    rows, distance = cover(torch.zeros(4, 2), 4)  # unless there is room for all
    assert (rows.tolist(), distance) == ([0, 1, 2, 3], 0)
    assert cover(torch.arange(9.0)[:, None], 1) == (torch.tensor([0]), 8)


def test_it_is_at_most_twice_as_far_as_with_the_best_choice() -> None:
    """Four heaps: four are enough to be near everything."""
    centres = torch.tensor([[0.0, 0], [9, 0], [0, 9], [9, 9]])
    heaps = centres.repeat_interleave(25, 0) + 0.2 * torch.rand(100, 2, generator=seeded(0))
    rows, distance = cover(heaps, 4)
    assert sorted((rows // 25).tolist()) == [0, 1, 2, 3]
    assert distance < 0.3


@pytest.fixture(scope="module")
def begun() -> Progress[Any]:
    """W is what the earlier skill solves, and M what only the far one does."""
    scenarios = random_scenarios("perimeter", 60, seeded(5))
    world = world_of(scenarios)
    first, second = (try_skill(m, world).succeeded for m in (EARLIER, FAR))
    assert (first & second).any()
    assert (first & ~second).any()
    rows = (first & second).nonzero()[:, 0], (first & ~second).nonzero()[:, 0]
    return known(world_of, EARLIER, scenarios[torch.cat(rows)], scenarios[second & ~first])


def far_is_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the models the far one solves all, and others what they solve in the world."""

    def shares(setup: Setup[Any], state: StageState[Any], skills: list[Skill]) -> Tensor:
        world, found = world_of(state.scenarios), list[Tensor]()
        for skill in skills:
            trusted = skill.depth == 1 and skill.num_nodes == 3 and skill.name != "S0"
            share = try_skill(skill, world).succeeded.float()
            found.append(torch.ones_like(share) if trusted else share)
        return torch.stack(found, 1)

    monkeypatch.setattr("cgtorch.improvement.team.shares", shares)


@pytest.mark.parametrize("core", [1, 2, 6, 1000])
def test_acceptance_is_checked_on_all_of_w(
    begun: Progress[Any], core: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eq. 1a holds for scenarios that no member was tried on; those once lost are not lost again.

    The models believe that one member solves everything, and branches send everything to it, until
    the world has said where it does not.
    """
    recruited(monkeypatch, FAR)
    far_is_trusted(monkeypatch)
    how = {"core": core, "practice": 0, "looks": 4, "attempts": 24}
    after, told = improved(begun, NONE, along("near"), **how)
    assert after.skill is not None
    assert after.skill is not EARLIER
    assert try_skill(after.skill, world_of(begun.solved)).succeeded.all()
    both = keys(after.solved) + keys(after.missed)
    assert sorted(both) == sorted(keys(begun.solved) + keys(begun.missed))
    assert len(after.solved) > len(begun.solved)
    assert set(keys(after.solved)) >= set(keys(begun.solved))
    (accepted,) = of_kind(told, SkillAccepted)
    assert len(accepted.scenarios) == len(both)
    assert set(keys(accepted.scenarios[accepted.keep])) == set(keys(begun.solved))
    again = try_skill(accepted.skill, world_of(accepted.scenarios)).succeeded
    assert torch.equal(again, accepted.succeeded)
    assert again[accepted.keep].all()


@pytest.mark.parametrize("core", [2, 1000])
def test_who_loses_something_of_w_is_not_accepted(
    begun: Progress[Any], core: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where the models believe in it: the world has the last word."""
    recruited(monkeypatch, FAR)
    far_is_trusted(monkeypatch)
    watched, how = Watched(), {"core": core, "practice": 0, "looks": 4, "attempts": 1}
    after, told = improved(begun, NONE, along("near"), world_of=watched, **how)
    assert len(watched.trials) >= 1
    assert all(e.solved_w < e.size_w for e in of_kind(told, WorldTested))
    assert after.skill is EARLIER
    assert after.solved is begun.solved
    assert after.missed is begun.missed
    assert not of_kind(told, SkillAccepted)


def test_a_scenario_that_was_lost_is_tried_first_from_then_on(
    begun: Progress[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a failed try has lost of the rest of W joins those that skills are compared on."""
    recruited(monkeypatch, FAR)
    far_is_trusted(monkeypatch)
    watched, how = Watched(), {"core": 1, "practice": 0, "looks": 4, "attempts": 24}
    improved(begun, NONE, along("near"), world_of=watched, **how)
    first, second, *_ = watched.trials
    rest = set(keys(begun.solved)) & set(first.keys)
    lost = {first.keys[i] for i in first.actions if i not in first.succeeded}
    assert len(rest) == len(begun.solved) - 1
    assert lost
    assert set(second.keys) == rest - lost


def test_where_a_candidate_would_be_no_better_all_stays(begun: Progress[Any]) -> None:
    alone = replace(begun, missed=NONE, seen=begun.seen[: len(begun.solved)])
    after, _ = improved(alone, NONE, along("near"), practice=0, looks=0, attempts=3)
    assert after.skill is EARLIER
    assert after.solved is begun.solved
