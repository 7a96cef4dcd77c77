import math
from dataclasses import replace

import pytest
import torch
from planar import driven, plain_percept
from support import FOOTPRINT, graspable, seeded, world
from torch import Tensor

from cgtorch.ground.environment import Environment, Lanes, start_lanes
from cgtorch.ground.errors import SettingsError
from cgtorch.tabletop.world import (
    LAB_NOISE,
    Noise,
    Scenarios,
    TabletopWorld,
    cluttered_scenarios,
    motion_possible,
    percept_of,
    random_scenarios,
    stage_scenarios,
)
from cgtorch.tabletop.world.clear_motion import CLEARANCE, MAX_TRANSLATION

QUIET = Noise(0, 0)


def lanes_of(environment: TabletopWorld) -> Lanes:
    return start_lanes(environment, torch.arange(environment.num_scenarios), 3, 0)


def test_it_is_an_environment() -> None:
    environment: Environment = world(0, 3)
    assert isinstance(environment, Environment)
    assert (environment.num_scenarios, environment.percept_size) == (3, 7)
    assert environment.control_size == 3


def test_motions_without_noise_are_exact() -> None:
    environment = world(0, 50, QUIET)
    lanes = lanes_of(environment)
    back = torch.tensor([-0.3, 0.2, 0.4]).expand(50, 3)
    after, done = environment.step(lanes, back)
    assert done.all()
    for i in range(50):
        pose = driven(lanes.state[i, :3].tolist(), (-0.3, 0.2, 0.4))
        assert after.state[i, :3].tolist() == pytest.approx(pose, abs=1e-5)
        table, placed = lanes.state[i, 3:9].tolist(), lanes.state[i, 9:11].tolist()
        wanted = plain_percept(pose, table, placed)
        assert after.percept[i].tolist() == pytest.approx(wanted, abs=1e-5)
    assert torch.equal(after.state[:, 3:11], lanes.state[:, 3:11])


@pytest.mark.parametrize(
    "control",
    [
        (1.5, 0.0, 0.0),  # into the table
        (-MAX_TRANSLATION - 0.01, 0.0, 0.0),  # too far
        (math.nan, 0.0, 0.0),
        (0.0, 0.0, math.inf),
    ],
)
@pytest.mark.parametrize("noise", [QUIET, LAB_NOISE])
def test_a_motion_that_fails_leaves_everything_as_it_is(
    control: tuple[float, ...], noise: Noise
) -> None:
    environment = world(0, 20, noise)
    lanes = lanes_of(environment)
    after, done = environment.step(lanes, torch.tensor(control).expand(20, 3))
    assert not done.any()
    assert torch.equal(after.state, lanes.state)
    assert torch.equal(after.percept, lanes.percept)


def test_the_base_stops_before_the_clearance_and_not_after() -> None:
    pose = torch.tensor([[-1.4, 0.0, 0.0]])
    table = torch.tensor([[0.0, 0.0, 0.0, 0.8, 1.2, 0.74]])
    scene = Scenarios(pose, table, torch.zeros(1, 2), torch.zeros(1, dtype=torch.long))
    environment = TabletopWorld(scene, graspable, FOOTPRINT, QUIET)
    gap = 1.0 - FOOTPRINT[1]
    for x, wanted in ((gap - CLEARANCE - 1e-3, True), (gap - CLEARANCE + 1e-3, False)):
        _, done = environment.step(lanes_of(environment), torch.tensor([[x, 0.0, 0.0]]))
        assert done.item() is wanted


def test_motion_possible_asks_nothing_of_the_rest_of_its_batch() -> None:
    generator = seeded(0)
    motion = torch.randn(200, 3, generator=generator)
    table = torch.cat([torch.randn(200, 3, generator=generator), torch.full((200, 2), 0.8)], 1)
    footprint = torch.tensor(FOOTPRINT)
    whole = motion_possible(motion, table, footprint)
    one = [motion_possible(motion[i : i + 1], table[i : i + 1], footprint) for i in range(200)]
    assert torch.equal(torch.cat(one), whole)


def test_noise_has_the_size_it_says() -> None:
    count, noise = 4000, Noise(0.01, 0.02)
    environment, exact = world(0, count, noise), world(0, count, QUIET)
    lanes, truth = lanes_of(environment), lanes_of(exact)
    blur = lanes.percept - truth.percept
    control = torch.tensor([-0.5, 0.0, 0.0]).expand(count, 3)
    after, _ = environment.step(lanes, control)
    wanted, _ = exact.step(truth, control)
    drift = after.state[:, :3] - wanted.state[:, :3]
    seen = percept_of(after.state[:, :3], after.state[:, 3:9], after.state[:, 9:11])
    second = after.percept - seen
    for values, size in (
        *((column, noise.position) for column in blur.T),
        *((column, noise.position) for column in second.T),
        (drift[:, 0], noise.position),
        (drift[:, 1], noise.position),
        (drift[:, 2], noise.heading),
    ):
        assert values.mean().item() == pytest.approx(0, abs=5 * size / count**0.5)
        assert values.std().item() == pytest.approx(size, rel=0.05)
    together = torch.corrcoef(torch.cat([blur, second, drift], 1).T)
    assert (together - torch.eye(17)).abs().max() < 0.08  # every look has noise of its own


def test_the_noise_of_a_scenario_is_its_own() -> None:
    """The same scenario in another batch, or another world, meets the same noise."""
    scenes = random_scenarios("perimeter", 6, seeded(3))
    whole = TabletopWorld(scenes, graspable, FOOTPRINT)
    some = torch.tensor([4, 1])
    part = TabletopWorld(scenes[some], graspable, FOOTPRINT)
    control = torch.tensor([[-0.3, 0.1, 0.2]])

    def life(environment: TabletopWorld, scenario: Tensor) -> Tensor:
        lanes = start_lanes(environment, scenario, 3, 0)
        seen = [lanes.percept]
        for _ in range(3):
            lanes = environment.observe(lanes)
            lanes, _ = environment.step(lanes, control.expand(len(lanes), 3))
            seen.append(lanes.percept)
        return torch.stack(seen)

    assert torch.equal(life(whole, some), life(part, torch.arange(2)))
    twins = life(whole, torch.tensor([4, 4]))
    assert torch.equal(twins[:, 0], twins[:, 1])
    again = replace(scenes, seed=scenes.seed + 1)
    other = TabletopWorld(again, graspable, FOOTPRINT)
    assert not torch.equal(life(whole, some), life(other, some))


def test_more_looks_than_were_drawn_use_the_noise_again() -> None:
    scenes = random_scenarios("near", 2, seeded(0))
    environment = TabletopWorld(scenes, graspable, FOOTPRINT, looks=3)
    lanes = lanes_of(environment)
    seen = [lanes.percept]
    for _ in range(6):
        lanes = environment.observe(lanes)
        seen.append(lanes.percept)
    assert torch.equal(seen[0], seen[3])
    assert torch.equal(seen[1], seen[4])
    assert not torch.equal(seen[0], seen[1])


def test_success_asks_for_the_truth_not_for_what_is_seen() -> None:
    asked: list[tuple[Tensor, Tensor]] = []

    def arms(at: Tensor, table: Tensor) -> Tensor:
        asked.append((at, table))
        return at[:, 0] > 1.5

    scenes = random_scenarios("perimeter", 30, seeded(0))
    environment = TabletopWorld(scenes, arms, FOOTPRINT, Noise(0.3, 0.3))
    lanes = lanes_of(environment)
    _, success = environment.success(lanes)
    ((at, table),) = asked
    exact = percept_of(scenes.pose, scenes.table, scenes.object)
    torch.testing.assert_close(at, exact[:, 4:])
    assert success.tolist() == (exact[:, 4] > 1.5).float().tolist()
    assert 0 < success.mean() < 1
    torch.testing.assert_close(table[:, 3:], torch.tensor([0.8, 1.2, 0.74]).expand(30, 3))
    torch.testing.assert_close(table[:, 2], -scenes.pose[:, 2])
    where = torch.cat([scenes.object, scenes.table[:, 5:6]], 1)
    torch.testing.assert_close(environment.placed(lanes.state), where)


def in_the_way(x: float) -> Scenarios:
    """A box 0.4 m across behind the robot, its near side at x, and another place without one."""
    scene = stage_scenarios("near", 1)
    box, nothing = [x - 0.2, 0.0, 0.0, 0.4, 0.4], [0.0] * 5
    return replace(scene, obstacles=torch.tensor([[nothing, box]]))


def test_the_base_stops_before_an_obstacle_as_before_the_table() -> None:
    gap = 1.0 + FOOTPRINT[0]
    environment = TabletopWorld(in_the_way(-2.4), graspable, FOOTPRINT, QUIET)
    for x, wanted in ((gap - CLEARANCE - 1e-3, True), (gap - CLEARANCE + 1e-3, False)):
        _, done = environment.step(lanes_of(environment), torch.tensor([[-x, 0.0, 0.0]]))
        assert done.item() is wanted
    # Turning beside it is blocked where a corner of the base would touch it.
    near = TabletopWorld(in_the_way(-1.4 - 0.4), graspable, FOOTPRINT, QUIET)
    for turn, wanted in ((math.pi / 4, False), (0.0, True)):
        _, done = near.step(lanes_of(near), torch.tensor([[0.0, 0.0, turn]]))
        assert done.item() is wanted


def test_an_obstacle_is_seen_where_it_is_and_nothing_is_seen_without_noise() -> None:
    environment = TabletopWorld(in_the_way(-2.4), graspable, FOOTPRINT)
    assert environment.percept_size == 15
    lanes = lanes_of(environment)
    assert lanes.percept.shape == (1, 15)
    for _ in range(3):
        there = lanes.percept[0, 11:]
        assert there.tolist() == pytest.approx([-1.4, -1.0, -0.2, 0.2], abs=0.03)
        assert not torch.equal(there, torch.tensor([-1.4, -1.0, -0.2, 0.2]))
        assert not lanes.percept[0, 7:11].any()
        lanes = environment.observe(lanes)


def test_obstacles_have_noise_of_the_same_size() -> None:
    scenes = cluttered_scenarios(4000, seeded(0))
    noisy, exact = (
        lanes_of(TabletopWorld(scenes, graspable, FOOTPRINT, noise))
        for noise in (Noise(0.01, 0.02), QUIET)
    )
    there = scenes.obstacles[:, 0, 3] > 0
    blur = (noisy.percept - exact.percept)[there]
    assert blur.mean(0).abs().max() < 0.001
    assert blur.std(0).tolist() == pytest.approx([0.01] * 11, rel=0.1)
    assert (torch.corrcoef(blur.T) - torch.eye(11)).abs().max() < 0.1
    assert not noisy.percept[~there, 7:].any()


def test_room_for_obstacles_changes_nothing_about_a_scenario() -> None:
    """Beside cluttered scenes, the paper's meet the noise they meet alone."""
    alone = random_scenarios("perimeter", 5, seeded(0))
    mixed = cluttered_scenarios(3, seeded(1)).joined(alone)
    assert mixed.obstacles.shape == (8, 1, 5)
    one, two = (TabletopWorld(s, graspable, FOOTPRINT) for s in (alone, mixed))
    first = lanes_of(one)
    second = start_lanes(two, torch.arange(3, 8), 3, 0)
    control = torch.tensor([[-0.3, 0.1, 0.2]]).expand(5, 3)
    for _ in range(3):
        assert torch.equal(second.percept[:, :7], first.percept)
        assert not second.percept[:, 7:].any()
        assert torch.equal(second.state[:, :12], first.state)
        (first, done), (second, also) = one.step(first, control), two.step(second, control)
        assert torch.equal(done, also)
        first, second = one.observe(first), two.observe(second)


def test_arms_reach_over_obstacles() -> None:
    scenes = cluttered_scenarios(50, seeded(2))
    without = replace(scenes, obstacles=0 * scenes.obstacles)
    one, two = (TabletopWorld(s, graspable, FOOTPRINT) for s in (scenes, without))
    assert torch.equal(one.success(lanes_of(one))[1], two.success(lanes_of(two))[1])


def test_a_percept_may_tell_the_tables_yaw() -> None:
    scenes = cluttered_scenarios(500, seeded(3))
    box, yaw = (
        TabletopWorld(scenes, graspable, FOOTPRINT, percept=name) for name in ("box", "yaw")
    )
    assert (box.percept_size, yaw.percept_size) == (11, 13)
    plain, telling = lanes_of(box), lanes_of(yaw)
    assert torch.equal(telling.percept[:, :7], plain.percept[:, :7])
    assert torch.equal(telling.state, plain.state)
    exact = lanes_of(TabletopWorld(scenes, graspable, FOOTPRINT, QUIET, percept="yaw"))
    length = exact.percept[:, 7:9].norm(dim=1)
    torch.testing.assert_close(length, scenes.table[:, 3])
    blur = (telling.percept - exact.percept)[:, 7:9]
    assert blur.std(0).tolist() == pytest.approx([0.005] * 2, rel=0.1)
    control = torch.tensor([[-0.2, 0.1, 0.3]]).expand(500, 3)
    (one, done), (two, also) = box.step(plain, control), yaw.step(telling, control)
    assert torch.equal(done, also)
    assert torch.equal(one.percept[:, :7], two.percept[:, :7])


def test_other_percepts_are_unknown() -> None:
    with pytest.raises(SettingsError, match="percept is 'photo'; use one of box, yaw"):
        TabletopWorld(stage_scenarios("near"), graspable, FOOTPRINT, percept="photo")


def test_each_look_has_noise_of_its_own_that_adds_to_what_is_there() -> None:
    scenes = random_scenarios("near", 4, seeded(0))
    environment = TabletopWorld(scenes, graspable, FOOTPRINT, Noise(0.01, 0.02), looks=3)
    lanes = lanes_of(environment)
    exact = percept_of(scenes.pose, scenes.table, scenes.object)
    for look in (0, 1, 2, 0):  # then they come again
        torch.testing.assert_close(lanes.percept, exact + environment.blur[:, look])
        lanes = environment.observe(lanes)
    assert environment.blur.std() == pytest.approx(0.01, rel=0.3)
    drift = environment.drift.std((0, 1))
    assert drift.tolist() == pytest.approx([0.01, 0.01, 0.02], rel=0.9)
    assert (LAB_NOISE.position, LAB_NOISE.heading) == (0.005, pytest.approx(math.radians(0.5)))
    assert LAB_NOISE.repeats
