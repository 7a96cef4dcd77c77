"""What an arm must keep clear of, and how much its joints bring it nearer."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from cgtorch.tabletop.kinematics import scene
from cgtorch.tabletop.kinematics.arm import ChainTable
from cgtorch.tabletop.kinematics.clear_ways import (
    APPROACH,
    CARRY,
    HELD,
    LIFT,
    MARGIN,
    OBJECT,
    OWN,
    POSTURE,
    REACH,
    TABLE,
    Scene,
)
from cgtorch.tabletop.kinematics.scene import (
    ABOVE,
    ALWAYS,
    BELOW_COSTS,
    BITS,
    BUILT_IN,
    CENTRE,
    _clear_of_nothing_else,
    _corners,
    _near_enough,
    _pairs,
    _reach,
    home_postures,
    random_postures,
    scene_of,
)
from cgtorch.tabletop.kinematics.solids import Solids, fixed_solids, with_boxed_hand
from cgtorch.tabletop.world.scenarios import HEIGHT


def pose(*at: float, turn: list[list[float]] | None = None) -> Tensor:
    """(3, 4)."""
    made = torch.eye(3, 4, dtype=torch.float64)
    made[:, 3] = torch.tensor(at)
    if turn is not None:
        made[:, :3] = torch.tensor(turn)
    return made


def arm(joints: int = 3) -> Any:
    """One that turns about z, slides along x, and turns about y, 1.4 m above its base."""
    table = ChainTable(
        offset=torch.stack([pose(0, 0, 1), pose(0.3, 0, 0.4), pose(0, 0, 0), pose(0, 0, 0.6)]),
        axis=torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 0, 0], [0, 1, 0]]).double(),
        kind=torch.tensor([1, 2, 0, 1]), joint=torch.tensor([0, 1, -1, 2]),
        gain=torch.ones(4).double(),
    )  # fmt: skip
    return SimpleNamespace(
        joint_names=("a", "b", "c")[:joints], chain=lambda like: (None, table),
        lower=torch.tensor([-1.0, -0.2, 0.1]).double(), upper=torch.tensor([1.0, 0.5, 2]).double(),
    )  # fmt: skip


BOX = torch.tensor([0.1, 0.2, 0.3, 0.0, 0.05]).double()


def carried() -> Solids:
    """The same box three times, a metre above the last frame."""
    three = torch.tensor([3, 3, 3])
    return Solids(pose(0, 0, 1).expand(3, 3, 4), BOX.expand(3, 5), three, three)


@pytest.mark.parametrize("base", [0, 1, 2, 3])
def test_a_joint_moves_what_it_carries_by_its_distance_from_the_axis(base: int) -> None:
    found = _reach(arm(), carried(), TABLE, base)
    last = math.hypot(0.1, 1.3) + 0.05
    beyond = math.hypot(0.1, 0.2, 1.3) + 0.05 + 0.6 + 0.5  # drawn out, in one line
    assert found.tolist() == pytest.approx([0.0] * base + [0.3 + beyond, 1.0, last][base:])


@pytest.mark.parametrize("gain", [0.5, -0.5])
def test_a_joint_that_others_follow_moves_it_by_these_too(gain: float) -> None:
    last, far = math.hypot(0.1, 1.3) + 0.05, math.hypot(0.1, 0.2, 1.3) + 0.05 + 0.6
    turned, slid = arm(2), arm(2)
    table = turned.chain(None)[1]
    table.joint[3], table.gain[3] = 0, gain
    alone = 0.3 + far + 0.5
    for base, found in enumerate(([alone + 0.5 * last, 1.0], [0.5 * last, 1.0], [0.5 * last, 0.0])):
        assert _reach(turned, carried(), TABLE, base).tolist() == pytest.approx(found)
    table = slid.chain(None)[1]
    table.joint[1:], table.gain[1] = torch.tensor([0, -1, 1]), gain
    drawn = 0.3 + far + 0.5 * 1.0  # half as far as the first joint turns
    assert _reach(slid, carried(), TABLE, 0).tolist() == pytest.approx([drawn + 0.5, last])


def test_an_object_is_turned_about_the_tool_as_it_is_held() -> None:
    ball = float(carried().radius[HELD])
    found = _reach(arm(), carried(), HELD, 0)
    assert found.tolist() == pytest.approx([0.3 + ball + 0.6 + 0.5, 1.0, ball])


def test_a_box_is_around_a_solid_without_its_ball() -> None:
    quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    size = torch.tensor([[0.1, 0.2, 0.3, 0.05, 0.7]]).double()
    found = _corners(fixed_solids(pose(1, 2, 3, turn=quarter)[None], size), 0)
    assert len({tuple(corner) for corner in found.round(decimals=6).tolist()}) == 8
    off = (found - torch.tensor([1, 2, 3])).abs()
    torch.testing.assert_close(off, torch.tensor([0.25, 0.15, 0.3]).double().expand(8, 3))


def test_pairs_are_those_that_may_meet_on_some_ways() -> None:
    """Of an arm with three solids, the body, and another arm with two."""
    one, two, hand, torso, shoulder, wrist = range(OWN, OWN + 6)
    found = {(a, b): kinds for a, b, kinds in _pairs([1, 4, 7], 1, [3, 7], 7).tolist()}
    held = LIFT | CARRY
    assert found == {
        (HELD, TABLE): CARRY, **{(HELD, k): held for k in (torso, shoulder, wrist, one, two)},
        **{(k, TABLE): ALWAYS | POSTURE for k in (one, two, hand)},
        (one, OBJECT): REACH | APPROACH, (two, OBJECT): REACH | APPROACH, (hand, OBJECT): REACH,
        **{(k, torso): ALWAYS | POSTURE for k in (two, hand)},
        **{(k, wrist): ALWAYS for k in (one, two, hand)},
        **{(k, shoulder): ALWAYS for k in (two, hand)},
        (two, one): ALWAYS, (hand, one): ALWAYS, (hand, two): ALWAYS,
    }  # fmt: skip
    neighbours = _pairs([1, 2, 3], 0, [], 3).tolist()
    assert [OWN + 2, OWN, ALWAYS] in neighbours
    assert [OWN + 1, OWN, ALWAYS] not in neighbours


def test_what_is_farther_than_an_arm_is_long_is_left_out() -> None:
    """Only what stands still, and only beside an arm whose first joint turns, about z here."""
    robot, still = arm(), OWN + 1
    robot.frames = lambda q: torch.eye(4).double().expand(4, 1, 4, 4)
    away = torch.tensor([0, 0, 0, 0, 2.5, 2.5, 2.7]).double()
    poses = torch.eye(3, 4).double().repeat(7, 1, 1)
    poses[:, 0, 3] = away
    frame = torch.tensor([-1, -1, 3, 3, -1, 3, -1])
    pairs = torch.tensor([[OWN, b, ALWAYS] for b in (TABLE, still, still + 1, still + 2)])
    radius = torch.full((7,), 0.5).double()
    reach = torch.full((4, 3), 2.0).double()
    one = Scene(poses, BOX.expand(7, 5), radius, frame, pairs, reach)
    assert _near_enough(robot, one).tolist() == [True, True, True, False]
    one.pose[still, 0, 3] += MARGIN
    one.pose[still, 2, 3] += 9  # along the axis, where the reach does not count
    assert _near_enough(robot, one).tolist() == [True, True, True, False]
    one.pose[still, 0, 3] += 1e-6
    assert _near_enough(robot, one).tolist() == [True, False, True, False]
    robot.chain(None)[1].kind[0] = 2
    assert _near_enough(robot, one).all()


def test_other_arms_are_in_the_way_at_home_with_boxes_for_hands(pr2: Any) -> None:
    for which, one in enumerate(pr2.arms):
        other, home = pr2.arms[1 - which], pr2.home[1 - which]
        boxed = with_boxed_hand(other.solids, len(home))
        assert len(boxed) < len(other.solids)
        placed = boxed.placed(other.frames(home[None])[:, 0])
        made = scene_of(one, pr2.body, replace(placed, joints=boxed.joints))
        apart = {*map(frozenset, pr2.description.excludes)}
        names = dict(enumerate(["", "", "", *one.solid_links, *pr2.body_links]))
        pairs = made.pairs.tolist()
        kept = [{names.get(a), names.get(b)} not in apart for a, b, _ in pairs]
        found = pr2.scenes[which]
        assert torch.equal(found.pose, made.pose)
        assert torch.equal(found.pairs, made.pairs[torch.tensor(kept)])
        assert torch.equal(found.reach, made.reach[torch.tensor(kept)])
        assert len(found.size) == OWN + len(one.solids) + len(pr2.body) + len(boxed)


def test_what_touches_in_most_postures_is_built_so(
    pr2: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Told for one pair after the other."""
    seen = list[Scene]()

    def noted(arm: Any, made: Scene) -> Tensor:
        seen.append(made)
        return torch.zeros(len(made.pairs), dtype=torch.bool)

    model, built_in = pr2.arms[0], scene._built_in
    monkeypatch.setattr(scene, "_built_in", noted)
    monkeypatch.setattr(scene, "SPREAD", 40)
    scene_of(model, pr2.body, pr2.body[:0])
    (made,) = seen
    found, q = built_in(model, made), random_postures(model, 40)
    own = [k for k, (a, b, _) in enumerate(made.pairs.tolist()) if min(a, b) >= OWN]
    assert len(own) > BITS
    assert 3 < int(found.sum()) < len(own) - 3
    assert not found[[k for k in range(len(found)) if k not in own]].any()
    for k in own:
        pair = torch.cat([made.pairs[k, :2], torch.tensor([REACH])])[None]
        alone = replace(made, pairs=pair, reach=made.reach[k : k + 1])
        clear = _clear_of_nothing_else(model, alone, torch.full((40,), REACH), q)
        assert bool(found[k]) == (int((~clear).sum()) > BUILT_IN * 40)


def test_only_joints_that_move_one_of_two_solids_alone_bring_them_nearer(
    robot_and_arm: tuple[Any, Any],
) -> None:
    robot, model = robot_and_arm
    made = robot.scenes[robot.arms.index(model)]
    joints = [0, 0, 7, *model.solids.joints.tolist()]
    still = joints + [0] * (len(made.size) - len(joints))  # also where other arms are at home
    for (a, b, _), reach in zip(made.pairs.tolist(), made.reach.tolist(), strict=True):
        moves = [value > 0 for value in reach]
        assert moves == [still[b] <= joint < still[a] for joint in range(7)]


def test_random_postures_are_within_limits_and_always_the_same() -> None:
    limits = torch.tensor([-1.0, 0.0, 2.0]).double(), torch.tensor([1.0, 0.5, 3.0]).double()
    robot: Any = SimpleNamespace(turn_limits=limits)
    found = random_postures(robot, 500)
    assert torch.equal(random_postures(robot, 500), found)
    share = (found - limits[0]) / (limits[1] - limits[0])
    assert float(share.min()) >= 0
    assert float(share.max()) <= 1
    assert share.mean(0).tolist() == pytest.approx([0.5] * 3, abs=0.05)
    first = torch.tensor([[0.9701, 0.7078, 0.4594], [0.9207, 0.6450, 0.7911]]).double()
    torch.testing.assert_close(share[:2], first, atol=1e-4, rtol=0)  # or homes would be others


def test_a_computed_home_is_raised_near_the_body_and_on_its_own_side(
    robot_and_arm: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The posture of the least cost, told point by point, among those that are clear."""
    robot, model = robot_and_arm
    footprint = x_min, x_max, y_min, y_max = robot.description.footprint
    q, solids = random_postures(model, 40), model.solids
    frames, (ends, radii) = model.frames(q), solids.capsules()
    side = {"left": 1.0, "right": -1.0, "arm": 0.0}[model.name]
    assert bool(side) == (abs(float(frames[1, 0, 1, 3])) > CENTRE)

    def cost(row: int) -> float:
        beyond, under, crossed, height = [0.0], [0.0], [0.0], [0.0]
        for k, radius in enumerate(radii.tolist()):
            pose = frames[int(solids.frame[k % len(solids)]), row]
            x, y, z = (pose[:3, :3] @ ends[k] + pose[:3, 3]).tolist()
            out = max(x - x_max, x_min - x, y - y_max, y_min - y) + radius
            low = max(0.0, ABOVE + radius - z)
            beyond.append(out)
            under.append(min(out, low))
            crossed.append(radius - side * y if side else 0.0)
            height.append(low if solids.joints[k % len(solids)] > 3.5 else 0.0)
        return max(beyond) + max(height) + BELOW_COSTS * (max(under) + max(crossed))

    assert HEIGHT[1] < ABOVE < HEIGHT[1] + 0.2  # of tables
    order = sorted(range(40), key=cost)
    own, table = [OWN + 1, OWN, ALWAYS], [OWN, TABLE, ALWAYS]
    poses = torch.eye(3, 4).double().expand(OWN + 2, 3, 4)
    some = Scene(
        poses, BOX.expand(OWN + 2, 5), torch.ones(OWN + 2), torch.zeros(OWN + 2).long(),
        torch.tensor([table, own]), torch.tensor([[1.0], [2.0]]),
    )  # fmt: skip

    def clear(arm: Any, alone: Scene, kind: Tensor, at: Tensor) -> Tensor:
        assert arm is model
        assert (alone.pairs.tolist(), alone.reach.tolist()) == ([own], [[2.0]])
        assert kind.tolist() == [REACH] * 30
        assert torch.equal(at, q[order[:30]])
        return torch.arange(30) > 2

    monkeypatch.setattr(scene, "SAMPLES", 40)
    monkeypatch.setattr(scene, "TRIED", 30)
    monkeypatch.setattr(scene, "scene_of", lambda arm, body, others: some)
    monkeypatch.setattr(scene, "_clear_of_nothing_else", clear)
    monkeypatch.setattr(scene, "shoulders_clear", lambda arm, body, q: torch.arange(len(q)) != 3)
    (home,) = home_postures((model,), robot.body, footprint, {})
    assert torch.equal(home, q[order[4]])  # as first links would touch the body at the one before


@pytest.mark.parametrize("name", ["pr2", "fetch"])
def test_at_a_computed_home_no_part_of_the_robot_touches_another(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene, "SAMPLES", 60)
    robot = request.getfixturevalue(name)
    (model, *_), none = robot.arms, robot.body[:0]
    (home,) = home_postures((model,), robot.body, robot.description.footprint, {})
    q = random_postures(model, 60)
    made = scene_of(model, robot.body, none)
    own = (made.pairs[:, :2] >= OWN).all(1)
    alone = replace(made, pairs=made.pairs[own], reach=made.reach[own])
    clear = _clear_of_nothing_else(model, alone, torch.full((60,), REACH), q)
    assert 1 < int(clear.sum()) < 60
    assert clear[int((q == home).all(1).long().argmax())]


def test_a_named_home_is_nought_or_the_nearest_limit_for_other_joints() -> None:
    body = fixed_solids(torch.empty(0, 3, 4).double(), torch.empty(0, 5).double())
    home = home_postures((arm(), arm()), body, (0.0, 0.0, 0.0, 0.0), {"a": 0.7})
    assert [each.tolist() for each in home] == [pytest.approx([0.7, 0.0, 0.1])] * 2
