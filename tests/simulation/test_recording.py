"""A world that is recorded: what was asked, by whom, and no more than is allowed."""

from collections import Counter as Count
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from members import nearly
from support import random_graphs, world
from told_by_runs import tensors_of
from torch import Tensor

from cgtorch.graphs import Graphs
from cgtorch.ground.asked import Asked, BudgetSpentError, Purse
from cgtorch.ground.environment import Dataset, Environment, Lanes, start_lanes
from cgtorch.simulation import Recording, Rollouts, rollout
from cgtorch.tabletop.actions import paper_actions

ACTIONS = paper_actions()
COUNT = 6


class Counted:
    """A world of which each scenario grants only so many actions, counted lane by lane."""

    def __init__(self, seed: int, most: float = float("inf")) -> None:
        self.inner: Environment = world(seed, COUNT)
        self.most = most
        self.motions, self.tests, self.looks = Count[int](), Count[int](), Count[int]()
        self.moved: list[tuple[int, int, Tensor, Tensor, Tensor]] = []
        self.tested: list[tuple[int, int, Tensor, bool]] = []
        self.num_scenarios, self.percept_size = COUNT, self.inner.percept_size
        self.control_size, self.seeds = self.inner.control_size, torch.arange(COUNT)
        self.observe = self.inner.observe

    def start(self, scenario: Tensor) -> tuple[Tensor, Tensor]:
        self.looks.update(scenario.tolist())
        return self.inner.start(scenario)

    def spent(self, scenario: int) -> int:
        return self.motions[scenario] + self.tests[scenario]

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        done = torch.zeros(len(lanes), dtype=torch.bool)
        for i, scenario in enumerate(lanes.scenario.tolist()):
            row = torch.tensor([i])
            if self.spent(scenario) < self.most and control[i].isfinite().all():
                self.motions[scenario] += 1
                after, done[row] = self.inner.step(lanes.rows(row), control[row])
                if done[i]:
                    about = lanes.percept[i].clone(), control[i].clone(), after.percept[0].clone()
                    self.moved.append((int(lanes.step[i]), scenario, *about))
                lanes = lanes.with_rows(row, after)
        return lanes, done

    def success(self, lanes: Lanes) -> tuple[Lanes, Tensor]:
        result = torch.zeros(len(lanes))
        for i, scenario in enumerate(lanes.scenario.tolist()):
            row = torch.tensor([i])
            if self.spent(scenario) < self.most:
                self.tests[scenario] += 1
                after, result[row] = self.inner.success(lanes.rows(row))
                tested = lanes.percept[i].clone(), bool(result[i] > 0.5)
                self.tested.append((int(lanes.step[i]), scenario, *tested))
                lanes = lanes.with_rows(row, after)
        return lanes, result

    def was_asked(self) -> Asked:
        return Asked(self.motions.total(), self.tests.total(), self.looks.total())

    def experience(self) -> Dataset:
        """All that was met, by step and then by scenario."""
        moved = sorted(self.moved, key=lambda row: row[:2])
        tested = sorted(self.tested, key=lambda row: row[:2])
        d = torch.zeros(0, self.percept_size)
        return Dataset(
            torch.stack([row[2] for row in moved]) if moved else d,
            torch.stack([row[3] for row in moved]) if moved else d[:, :3],
            torch.stack([row[4] for row in moved]) if moved else d,
            torch.stack([row[2] for row in tested]) if tested else d,
            torch.tensor([row[3] for row in tested], dtype=torch.bool),
        )


def graph_of(seed: int) -> Graphs:
    """A random graph, or one that drives ahead and grasps until it is stopped."""
    if seed % 4 == 0:
        return nearly(0.1 + seed % 7 / 10).graph
    many = random_graphs(seed, 40, ACTIONS, nodes=(4, 8))
    acting = [(many.action == ACTIONS.index(name)).any(1) for name in ("MoveBase", "Grasp")]
    return many[(acting[0] & acting[1]).nonzero()[:1, 0]]


def assert_same(found: Rollouts, wanted: Rollouts) -> None:
    for name, value in tensors_of(wanted).items():
        assert torch.equal(tensors_of(found)[name], value), name


GIVEN = {"seed": st.integers(0, 2**20), "limit": st.integers(1, 20)}


@given(**GIVEN)
def test_what_is_recorded_is_what_was_done(seed: int, limit: int) -> None:
    purse, plain = Purse(), Counted(seed)
    place, graph = Recording(world(seed, COUNT), purse, "practice"), graph_of(seed)
    found, wanted, counted = (
        rollout(graph, ACTIONS, e, max_transitions=limit)
        for e in (place, world(seed, COUNT), plain)
    )
    assert_same(found, wanted)
    assert_same(counted, wanted)
    assert purse.spent == {"practice": plain.was_asked()}
    assert place.actions.tolist() == [plain.spent(i) for i in range(COUNT)]
    assert torch.equal(place.first, world(seed, COUNT).start(torch.arange(COUNT))[1])
    for name, rows in vars(plain.experience()).items():
        assert torch.equal(vars(Dataset(*place.experience()))[name], rows), name


@given(**GIVEN, most=st.integers(1, 12))
def test_who_is_broken_off_asks_nothing_more(seed: int, limit: int, most: int) -> None:
    purse, plain, asked = Purse(), Counted(seed, most), Counted(seed)
    place, graph = Recording(asked, purse, most=most), graph_of(seed)
    found, wanted = (rollout(graph, ACTIONS, e, max_transitions=limit) for e in (place, plain))
    assert_same(found, wanted)
    assert purse.spent == {"trials": plain.was_asked()}
    assert asked.was_asked() == plain.was_asked()
    assert place.actions.tolist() == [plain.spent(i) for i in range(COUNT)]
    assert int(place.actions.max()) <= most
    for name, rows in vars(plain.experience()).items():
        assert torch.equal(vars(Dataset(*place.experience()))[name], rows), name


def test_some_are_broken_off_and_others_are_not() -> None:
    """Lanes of both kinds in one batch, which the world treats by themselves."""
    place = Recording(world(0, 4), most=2)
    lanes = start_lanes(place, torch.arange(4), 3, 0)
    ahead = torch.tensor([[-0.1, 0.0, 0.0]])
    for rows, moved in (([0, 1], [True, True]), ([1], [True]), ([1, 2], [False, True])):
        some = torch.tensor(rows)
        after, done = place.step(lanes.rows(some), ahead.expand(len(rows), -1))
        assert done.tolist() == moved
        lanes = lanes.with_rows(some, after)
    assert place.actions.tolist() == [1, 2, 1, 0]
    after, result = place.success(lanes)
    plain, wanted = world(0, 4).success(lanes)
    assert place.actions.tolist() == [2, 2, 2, 1]
    assert result[1] == 0
    rest = torch.tensor([0, 2, 3])
    assert torch.equal(result[rest], wanted[rest])
    assert torch.equal(after.state[rest], plain.state[rest])
    assert len(place.experience()[3]) == 3


@given(st.integers(0, 2**20), st.integers(0, 40))
def test_what_the_budget_does_not_cover_is_not_asked(seed: int, limit: int) -> None:
    asked, purse = Counted(seed), Purse({"actions": limit})
    graph = nearly(0.1).graph
    free = Purse()
    rollout(graph, ACTIONS, Recording(world(seed, COUNT), free))
    place = Recording(asked, purse)
    if free.total.actions <= limit:
        rollout(graph, ACTIONS, place)
        assert purse.total == free.total
    else:
        with pytest.raises(BudgetSpentError):
            rollout(graph, ACTIONS, place)
        assert purse.exhausted
    assert purse.total == asked.was_asked()
    assert purse.total.actions <= limit


def test_who_has_no_control_to_send_asks_for_no_motion() -> None:
    """A graph may come to its motion before any network has said where to go."""
    purse, plain = Purse({"motions": 2}), world(0, 3)
    place = Recording(plain, purse, most=2)
    lanes = start_lanes(place, torch.arange(3), 3, 0)
    control = torch.tensor([[-0.1, 0, 0], [torch.nan, 0, 0], [0, 0, torch.inf]])
    for _ in range(2):
        after, done = place.step(lanes, control)
        assert done.tolist() == [True, False, False]
        assert not after.rows(torch.tensor([1, 2])).differs(lanes.rows(torch.tensor([1, 2]))).any()
    assert place.actions.tolist() == [2, 0, 0]
    assert purse.total.motions == 2


def test_looks_are_counted_and_their_percepts_kept_whichever_come_first() -> None:
    purse, plain = Purse({"looks": 3}), world(3, 4)
    place = Recording(plain, purse, "looks")
    for rows in ([2], [3, 0]):
        place.start(torch.tensor(rows))
    wanted = plain.start(torch.arange(4))[1]
    assert torch.equal(place.first[[0, 2, 3]], wanted[[0, 2, 3]])
    assert not place.first[1].any()
    assert purse.spent == {"looks": Asked(looks=3)}
    with pytest.raises(BudgetSpentError):
        place.start(torch.tensor([1]))
    assert not place.first[1].any()


def test_looking_again_is_free() -> None:
    """A skill may detect as often as it likes, as only arms and wheels wear."""
    purse = Purse()
    place = Recording(world(0, 2), purse, most=1)
    lanes = start_lanes(place, torch.arange(2), 0, 0)
    seen = place.observe(place.observe(lanes))
    assert not torch.equal(seen.percept, lanes.percept)
    assert purse.total == Asked(looks=2)
    assert not place.actions.any()


def test_worlds_of_other_numbers_are_recorded_too() -> None:
    plain = world(0, 3, dtype=torch.float64)
    place: Any = Recording(plain)
    _, percept = place.start(torch.arange(3))
    assert torch.equal(place.first.double(), percept.to(place.first).double())


def test_seeds_are_those_of_the_world() -> None:
    plain = world(5, 3)
    assert torch.equal(Recording(plain).seeds, plain.seeds)


class LowLevel(Counted):
    """Each motion takes three low-level steps, of which one was known, and a test one."""

    steps = 0

    @property
    def asked(self) -> Asked:
        return Asked(steps=self.steps, simulated=2 * (self.steps // 3))

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        self.steps += 3 * len(lanes)
        return super().step(lanes, control)


def test_low_level_steps_are_counted_even_of_what_is_broken_off() -> None:
    place, purse = LowLevel(3), Purse({"motions": 5})
    recording = Recording(place, purse, "exploration")
    lanes = start_lanes(recording, torch.arange(COUNT), 3, 0)
    some = lanes.rows(torch.arange(4))
    recording.step(some, torch.zeros(4, 3))
    with pytest.raises(BudgetSpentError):
        recording.step(some, torch.zeros(4, 3))
    spent = purse.spent["exploration"]
    assert (spent.motions, spent.steps, spent.simulated) == (4, 12, 8)
