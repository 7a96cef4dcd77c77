"""Updates of a tuning with whole episodes or truncated ones, as its horizon says."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from support import seeded
from torch import Generator, Tensor
from walking import RewardedPath, chain, walking_actions, walks

from cgtorch.evolution.cma import Distribution, updated
from cgtorch.ground.environment import Lanes
from cgtorch.improvement import tuning as module
from cgtorch.improvement.horizon import HORIZONS, Horizon
from cgtorch.improvement.pace import BY_STEP
from cgtorch.improvement.paired_race import Fresh
from cgtorch.improvement.tuning import SAMPLES, WIDER, Tuning, begun, update


class LatePath(RewardedPath):
    """One on which only what comes after the third step counts."""

    def returns(self, lanes: Lanes) -> Tensor:
        return torch.where(lanes.state[:, 1] > 3, super().returns(lanes), 0.0)


WALKING = walking_actions()


def forty_steps(kind: type[RewardedPath]) -> Callable[[int, Generator], RewardedPath]:
    """Makes worlds in which walks have forty steps."""

    def world(count: int, generator: Generator) -> RewardedPath:
        drawn = walks(count, generator)
        return kind(replace(drawn, length=torch.full_like(drawn.length, 40)))

    return world


def walked(
    horizon: Horizon, kind: type[RewardedPath] = RewardedPath, scenarios: int = 2
) -> tuple[Tuning, bool, Fresh]:
    """A walk's tuning after an update, whether lengths count, and what was played."""

    place = Fresh(forty_steps(kind), 99, BY_STEP)
    found = begun(chain(WALKING, "Aim", "Step", speed=0.5), WALKING, scenarios)
    assert found is not None
    found = replace(found, horizon=horizon, recent=(-9.0, -8.0))
    [(after, lengthy)] = update([found], WALKING, place, seeded(0))
    assert after.distribution.updates == found.distribution.updates + 1
    return after, lengthy, place


def test_updates_have_whole_episodes_or_truncated_ones_as_the_horizon_says() -> None:
    most = SAMPLES * 2 * 6  # actions of two scenarios, of which each of three steps takes two
    for horizon in (Horizon(3.0), Horizon(3.0, updates=4, cost=9), Horizon(3.0, updates=3)):
        after, _, place = walked(horizon)
        assert place.executed <= most
        assert after.recent == (-9.0, -8.0)
        assert (after.horizon.steps, after.horizon.updates) == (3, horizon.updates + 1)
        assert after.horizon.since == place.executed / 2 / SAMPLES
    after, _, place = walked(Horizon(3.0, updates=4))
    assert place.executed > most
    assert len(after.recent) == 1  # as others had another horizon
    assert after.horizon.updates == 0
    after, _, place = walked(Horizon())
    assert place.executed > most
    assert len(after.recent) == 3
    assert HORIZONS[0] <= after.horizon.steps < torch.inf
    assert after.horizon.cost == place.executed / 2 / SAMPLES


def test_truncated_episodes_have_further_starts_which_whole_ones_go_with() -> None:
    several = Horizon(3.0, starts=5)
    _, _, place = walked(several)
    assert place.episodes == SAMPLES * 5
    assert walked(several, scenarios=7)[2].episodes == SAMPLES * 7
    due = replace(several, updates=4)
    after, _, place = walked(due)
    assert place.episodes == SAMPLES * 5  # two whole ones, and three others
    assert place.executed < walked(due, scenarios=5)[2].executed
    alone, _, _ = walked(Horizon(3.0, updates=4))
    assert after.recent == alone.recent  # which whole ones alone tell
    assert after.horizon == alone.horizon
    assert not torch.equal(after.distribution.mean, alone.distribution.mean)
    as_many, _, _ = walked(replace(due, starts=2))
    assert torch.equal(as_many.distribution.mean, alone.distribution.mean)


def test_of_tunings_that_are_updated_together_the_longest_horizon_counts() -> None:
    def updated_both(*horizons: Horizon) -> tuple[Fresh, list[Horizon]]:
        place = Fresh(forty_steps(RewardedPath), 99, BY_STEP)
        first = begun(chain(WALKING, "Aim", "Step", speed=0.1), WALKING, 2)
        assert first is not None
        both = [replace(first, horizon=each) for each in horizons]
        found = update(both, WALKING, place, seeded(0))
        return place, [tuning.horizon for tuning, _ in found]

    place, after = updated_both(Horizon(3.0, starts=5), Horizon(6.0, starts=3))
    assert place.episodes == 2 * SAMPLES * 5
    assert all(3 * 5 < each.since <= 6 * 5 for each in after)
    for horizons in ((Horizon(3.0), Horizon()), (Horizon(), Horizon(3.0))):
        assert all(each.cost > 0 for each in updated_both(*horizons)[1])


def test_all_starts_of_a_whole_update_count_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[Tensor]()

    def remembered(before: Distribution, rows: Tensor, worth: Tensor) -> Distribution:
        seen.append(worth)
        return updated(before, rows, worth)

    monkeypatch.setattr(module, "updated", remembered)
    walked(Horizon(3.0, starts=5, updates=4))
    walked(Horizon(3.0, starts=5))
    assert seen[0].tolist() != seen[1].tolist()  # on other starts
    assert float(seen[0].min()) > -60  # of which whole ones would cost some hundred
    assert float(seen[0].mean()) == pytest.approx(float(seen[1].mean()), rel=0.2)


def test_what_truncated_episodes_do_not_tell_is_told_by_whole_ones() -> None:
    usual, _, _ = walked(Horizon(3.0))
    after, lengthy, _ = walked(Horizon(3.0), LatePath)
    assert after.horizon.steps == torch.inf
    assert after.distribution.step < WIDER * 0.9
    assert after.distribution.step == pytest.approx(usual.distribution.step, rel=0.2)
    assert not lengthy
