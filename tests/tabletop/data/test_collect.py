"""What Γ and C learn from: transitions the world made, and labels from where they teach most."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from planar import driven, plain_percept
from support import FOOTPRINT, graspable, seeded
from torch import Tensor

from cgtorch.ground.environment import Dataset, Lanes
from cgtorch.ground.errors import DataError, SettingsError
from cgtorch.native.processes import listening
from cgtorch.tabletop.data import (
    ANYWHERE,
    ARENA,
    BESIDE,
    PROBE,
    Scenes,
    collect,
    drive,
    grasp_labels,
    in_table,
    poses_around,
)
from cgtorch.tabletop.world import LAB_NOISE, Noise, Scenarios, TabletopWorld, stage_scenarios
from cgtorch.tabletop.world.scenarios import TABLE_DEPTH, TABLE_WIDTH

EXACT = Noise(0, 0)


class Watched(TabletopWorld):
    """A tabletop that remembers every step that was asked of it."""

    steps: list[tuple[Lanes, Tensor, Lanes, Tensor]]

    def step(self, lanes: Lanes, control: Tensor) -> tuple[Lanes, Tensor]:
        after, done = super().step(lanes, control)
        self.steps.append((lanes, control, after, done))
        return after, done


def scenes_of(noise: Noise = EXACT) -> Scenes:
    return Scenes(lambda scenarios: TabletopWorld(scenarios, graspable, FOOTPRINT, noise))


@pytest.fixture(scope="module")
def drives() -> tuple[tuple[Tensor, Tensor, Tensor], dict[str, Tensor]]:
    """500 transitions and, for each, what the world did when it was made."""
    steps: list[tuple[Lanes, Tensor, Lanes, Tensor]] = []

    def watched(scenarios: Scenarios) -> TabletopWorld:
        world = Watched(scenarios, graspable, FOOTPRINT, EXACT)
        world.steps = steps
        return world

    rows = drive(Scenes(watched), 500, seeded(1))
    all_steps = {
        "percept": torch.cat([before.percept for before, _, _, _ in steps]),
        "motion": torch.cat([motion for _, motion, _, _ in steps]),
        "before": torch.cat([before.state for before, _, _, _ in steps]),
        "after": torch.cat([after.state for _, _, after, _ in steps]),
        "done": torch.cat([done for _, _, _, done in steps]),
    }
    same = (all_steps["motion"] == rows[1][:, None]).all(2)
    assert (same.sum(1) == 1).all()  # each transition is one that was really made, and made once
    made = same.long().argmax(1)
    assert len(set(made.tolist())) == 500
    return rows, {name: value[made] for name, value in all_steps.items()}


def test_transitions_are_rigid_motions(
    drives: tuple[tuple[Tensor, ...], dict[str, Tensor]],
) -> None:
    (p, u, q), made = drives
    assert p.shape == q.shape == (500, 7)
    assert u.shape == (500, 3)
    assert torch.equal(p, made["percept"])
    for row in range(500):
        state = made["before"][row].tolist()
        wanted = plain_percept(driven(state[:3], u[row].tolist()), state[3:9], state[9:11])
        assert q[row].tolist() == pytest.approx(wanted, abs=1e-5)


def test_no_blocked_motion_and_none_out_of_the_arena(
    drives: tuple[tuple[Tensor, ...], dict[str, Tensor]],
) -> None:
    _, made = drives
    assert made["done"].all()
    for state in (made["before"], made["after"]):
        there = Scenarios(state[:, :3], state[:, 3:9], state[:, 9:11], torch.arange(len(state)))
        assert not in_table(there, torch.tensor(FOOTPRINT)).any()
    assert made["after"][:, :2].norm(dim=1).max() <= ARENA
    # Only a first pose may be in a corner of the square around the arena.
    first = made["before"][:, 11] == 1
    assert (first | (made["before"][:, :2].norm(dim=1) <= ARENA)).all()


def test_the_robot_is_driven_along_all_sides(
    drives: tuple[tuple[Tensor, ...], dict[str, Tensor]],
) -> None:
    _, made = drives
    x, y = made["after"][:, 0], made["after"][:, 1]
    sides = (x < -TABLE_DEPTH / 2, x > TABLE_DEPTH / 2, y < -TABLE_WIDTH / 2, y > TABLE_WIDTH / 2)
    assert all(int(side.sum()) >= 75 for side in sides)


def test_start_poses_are_free() -> None:
    scenarios = poses_around(scenes_of(), 300, seeded(2))
    assert len(scenarios) == 300
    assert not in_table(scenarios, torch.tensor(FOOTPRINT)).any()
    assert scenarios.pose[:, :2].abs().max() <= ARENA


@pytest.mark.parametrize(
    ("kind", "percept", "size"), [("general", "yaw", 9), ("general-clutter", "box", 11)]
)
def test_data_of_other_scenes(kind: str, percept: str, size: int) -> None:
    asked: list[Scenarios] = []

    def watched(scenarios: Scenarios) -> TabletopWorld:
        asked.append(scenarios)
        return TabletopWorld(scenarios, graspable, FOOTPRINT, percept=percept)

    data = collect(Scenes(watched, kind), 200, 200, seeded(3))
    assert data.percept.shape == data.next_percept.shape == data.tested.shape == (200, size)
    assert data.percept[:, 6].min() < 0.65 < 0.85 < data.percept[:, 6].max()
    for scenarios in asked:
        assert not in_table(scenarios, torch.tensor(FOOTPRINT)).any()
        assert len(scenarios.table.unique(dim=0)) == len(scenarios)


def test_edges_of_one_table_share_their_scenes() -> None:
    world = scenes_of().world
    near, perimeter = (Scenes(world, kind) for kind in ("near", "perimeter"))
    assert torch.equal(near.draw(9, seeded(0)).object, perimeter.draw(9, seeded(0)).object)
    assert near.paper_table
    assert Scenes(world, "general").arena > near.arena == perimeter.arena
    with pytest.raises(SettingsError, match="unknown placement 'far away'"):
        Scenes(world, "far away").draw(1, seeded(0))


def test_nobody_starts_in_an_obstacle() -> None:
    scenes = stage_scenarios("near", 2)
    box = torch.tensor([[[-1.4, 0.0, 0.3, 0.4, 0.4]], [[0.0] * 5]])
    blocked = in_table(replace(scenes, obstacles=box), torch.tensor(FOOTPRINT))
    assert blocked.tolist() == [True, False]


def never(at: Tensor, table: Tensor) -> Tensor:
    return torch.zeros(len(at), dtype=torch.bool)


def always(at: Tensor, table: Tensor) -> Tensor:
    return torch.ones(len(at), dtype=torch.bool)


def hardly(at: Tensor, table: Tensor) -> Tensor:
    return (at[:, :2].norm(dim=1) - 0.5).abs() < 0.002


@pytest.mark.parametrize("arms", [never, always, hardly])
def test_a_robot_that_cannot_learn_to_grasp_is_an_error(arms: Callable[..., Tensor]) -> None:
    with pytest.raises(DataError, match=r"a grasp succeeds at .*% of random poses") as caught:
        collect(Scenes(lambda s: TabletopWorld(s, arms, FOOTPRINT)), 50, 300, seeded(7))
    assert "\n" not in str(caught.value)


def test_how_many_data_there_are_is_told_as_they_come() -> None:
    told = list[tuple[str, int, int]]()
    with listening(lambda *given: told.append(given)):
        drive(scenes_of(), 40, seeded(0))
    assert {(what, total) for what, _, total in told} == {("transitions", 40)}
    done = [each for _, each, _ in told]
    assert done[0] == 0
    assert done == sorted(done)
    assert len(set(done)) > 3
    assert done[-1] >= 40
    told.clear()
    with listening(lambda *given: told.append(given)):
        grasp_labels(scenes_of(), 100, seeded(0))
    probes, anywhere, beside = PROBE, int(100 * ANYWHERE), int(100 * BESIDE) // 2
    every = [0, probes, probes + beside, probes + 2 * beside, probes + 2 * beside + anywhere]
    assert told == [("labels", done, every[-1]) for done in every]


@pytest.mark.parametrize(("thrift", "robots"), [(1, 2 + 20), (4, 2 + 5)])
def test_who_is_thrifty_drives_fewer_robots_at_once(thrift: int, robots: int) -> None:
    begun = list[int]()

    def watched(scenarios: Scenarios) -> TabletopWorld:
        begun.append(len(scenarios))
        return TabletopWorld(scenarios, graspable, FOOTPRINT, EXACT)

    p, u, q = drive(Scenes(watched, thrift=thrift), 40, seeded(2))
    assert len(p) == len(u) == len(q) == 40
    assert next(count for count in begun if count) == robots
    assert all(count <= robots for count in begun)


def equal(one: Dataset, other: Dataset) -> bool:
    return all(torch.equal(a, vars(other)[name]) for name, a in vars(one).items())


def test_the_generator_decides() -> None:
    first, again, other = (collect(scenes_of(LAB_NOISE), 80, 60, seeded(s)) for s in (8, 8, 9))
    assert len(first.percept) == 80
    assert equal(first, again)
    assert not equal(first, other)


def test_more_data_come_last() -> None:
    first, more = (collect(scenes_of(), 60, 60, seeded(s)) for s in (10, 11))
    both = first.extended(more)
    for name, value in vars(both).items():
        assert torch.equal(value[: len(vars(first)[name])], vars(first)[name])
        assert torch.equal(value[len(vars(first)[name]) :], vars(more)[name])
