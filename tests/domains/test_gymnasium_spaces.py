"""Spaces of Gymnasium as percepts and controls."""

from typing import Any

import numpy as np
import pytest
import torch
from support import seeded

from cgtorch.domains.check import check_domain
from cgtorch.domains.gymnasium import Gymnasium
from cgtorch.domains.gymnasium_controls import controls_of, tried
from cgtorch.domains.gymnasium_limits import bounds_of_percepts
from cgtorch.domains.gymnasium_settings import GymnasiumSettings
from cgtorch.domains.gymnasium_spaces import LISTED, percepts_of
from cgtorch.domains.registry import make_domain
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import DomainError

gymnasium = pytest.importorskip("gymnasium")
from gymnasium import spaces  # noqa: E402
from tiny_worlds import GOAL, MUTE, TALK, ZOO  # noqa: E402


def domain_of(name: str, **settings: Any) -> Gymnasium:
    settings = {"target_return": -1.0, **settings}
    made = make_domain(f"gymnasium:{name}", GymnasiumSettings(**settings))
    assert isinstance(made, Gymnasium)
    return made


def remarks_of(domain: Gymnasium) -> list[str]:
    return domain.pictures(domain).remarks()


def names_of(domain: Gymnasium) -> list[str]:
    return [field.name for field in domain.percept]


def test_each_number_of_an_observation_has_a_name() -> None:
    assert names_of(domain_of(ZOO)) == [
        "observation[1] 1", "observation[1] 2",
        "observation[2].level = 1", "observation[2].level = 2", "observation[2].level = 3",
        "observation[2].matrix 1,1", "observation[2].matrix 1,2",
        "observation[2].matrix 2,1", "observation[2].matrix 2,2",
        "observation[3] 1 = 0", "observation[3] 1 = 1",
        "observation[3] 2 = 0", "observation[3] 2 = 1", "observation[3] 2 = 2",
        "observation[4]",
    ]  # fmt: skip
    assert names_of(domain_of("CartPole-v1"))[:2] == ["observation 1", "observation 2"]
    assert names_of(domain_of("FrozenLake-v1"))[15] == "observation = 15"


def test_percepts_are_what_gymnasium_flattens() -> None:
    space = gymnasium.make(ZOO).observation_space
    percepts = percepts_of(space, (), ZOO)
    for seed in range(5):
        space.seed(seed)
        seen = space.sample()
        flat = spaces.flatten(space, seen)
        assert isinstance(flat, np.ndarray)
        assert percepts.of(seen) == pytest.approx(flat)


def test_each_number_of_an_action_has_a_name_and_bounds() -> None:
    fields = {f.name: (f.low, f.high) for f in domain_of(ZOO).control}
    assert fields == {
        **{f"arm {place}": (-9, 9) for place in ("1,1", "1,2", "2,1", "2,2")},
        **dict.fromkeys(["preference for both[1] = 5", "preference for both[1] = 6"], (-1, 1)),
        "both[2] 1": (-1, 1),
        **{
            f"preference for keys {end}": (-1, 1)
            for end in ("1 = 0", "1 = 1", "2 = 0", "2 = 1", "2 = 2")
        },
        **dict.fromkeys(["preference for lamps 1", "preference for lamps 2"], (-1, 1)),
    }


def test_the_preferred_choices_are_taken() -> None:
    controls = controls_of(gymnasium.make(ZOO).action_space, ZOO)
    rows = [
        [1, -20, 3, 20, 0.5, 0.2, 7, -1, 1, 0, 2, 3, 1, -1],
        [0, 0, 0, 0, 0.1, 0.2, -7, 1, -1, 2, 1, 0, -1, 0.1],
    ]
    one, other = controls.actions(np.array(rows, dtype=np.float32))
    assert one["arm"].tolist() == [[1, -9], [3, 9]]
    assert (one["both"][0], one["both"][1].tolist()) == (5, [1])
    assert (one["keys"].tolist(), one["lamps"].tolist()) == ([1, 2], [1, 0])
    assert (other["both"][0], other["both"][1].tolist()) == (6, [-1])
    assert (other["keys"].tolist(), other["lamps"].tolist()) == ([0, 0], [0, 1])
    grid = spaces.MultiDiscrete(np.array([[2, 2], [2, 2]]), start=np.array([[0, 1], [2, 3]]))
    chosen = controls_of(grid, "grid").actions(np.array([[0, 1, 1, 0, 0, 1, 1, 0.0]]))
    assert chosen[0].tolist() == [[1, 1], [3, 3]]
    assert grid.contains(chosen[0])


@pytest.mark.parametrize("name", [ZOO, GOAL, "FrozenLake-v1", "Blackjack-v1"])
def test_other_spaces_keep_the_interface(name: str) -> None:
    domain = domain_of(name, env=("is_slippery=false",) if name == "FrozenLake-v1" else ())
    check_domain(domain, "starts")
    world = domain.world(domain.draw("starts", 3, seeded(0)))
    lanes = start_lanes(world, torch.arange(3), world.control_size, 0)
    for _ in range(3):
        control = torch.rand(3, world.control_size, generator=seeded(1))
        lanes, _ = world.step(lanes, control)
    assert lanes.percept.isfinite().all()


def test_percepts_are_chosen_by_names_and_patterns() -> None:
    assert names_of(domain_of(GOAL, percepts=("*_goal",))) == [
        "achieved_goal 1", "achieved_goal 2", "desired_goal 1", "desired_goal 2",
    ]  # fmt: skip
    few = domain_of(GOAL, percepts=("desired_goal 2", "observation"))
    assert names_of(few) == ["observation 1", "observation 2", "desired_goal 2"]
    assert names_of(domain_of(ZOO, percepts=("observation[4]",))) == ["observation[4]"]
    assert remarks_of(few) == []


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1"])
def test_chosen_percepts_are_those_of_all(name: str) -> None:
    every, few = domain_of(name), domain_of(name, percepts=("observation 1", "observation 3"))
    seen = []
    for domain in (every, few):
        world = domain.world(domain.draw("starts", 3, seeded(0)))
        lanes = start_lanes(world, torch.arange(3), world.control_size, 0)
        lanes, _ = world.step(lanes, torch.ones(3, world.control_size))
        seen.append(lanes.percept)
    assert torch.equal(seen[0][:, [0, 2]], seen[1])


def test_what_has_no_numbers_is_left_out_and_told() -> None:
    domain = domain_of(GOAL)
    assert len(domain.percept) == 6
    lacks = "Percepts lack mission (it has no fixed numbers)."
    assert remarks_of(domain) == [lacks]
    assert ("Remark", remarks_of(domain)[0]) in domain.pictures(domain).about()


def test_a_box_without_numbers_is_no_percept() -> None:
    with pytest.raises(DomainError, match=r"observations Box\(.*\(0,\).*, and these have no fixed"):
        percepts_of(spaces.Box(-1, 1, (0,)), (), "Empty-v0")


@pytest.mark.parametrize(
    ("name", "percepts", "message"),
    [
        (MUTE, (), "has observations Text.*, and these have no fixed numbers"),
        (TALK, (), r"has word in Text.*; only numbers and choices can be controls"),
        (GOAL, ("mission",), r"percepts 'mission': mission of environment .* is Text\(.*leave it"),
        (GOAL, ("gaol",), "percepts 'gaol' matches nothing .* it has observation, achieved"),
    ],
)  # fmt: skip
def test_other_spaces_are_refused(name: str, percepts: tuple[str, ...], message: str) -> None:
    with pytest.raises(DomainError, match=message):
        domain_of(name, percepts=percepts)


def test_an_action_without_numbers_is_refused() -> None:
    with pytest.raises(DomainError, match=r"has actions Dict.*; only numbers and choices"):
        controls_of(spaces.Dict(), "Empty-v0")
    names = spaces.Dict({f"part{i}": spaces.Discrete(2) for i in range(20)})
    with pytest.raises(DomainError, match=r"part11.*, …$|, …$"):
        percepts_of(names, ("nose",), "Long-v0")


FAR = 1e30
WIDE = spaces.Box(
    np.array([-1.0, -FAR, 0.0]), np.array([FAR, 2.0, np.inf]), dtype=np.float64
)  # whose second and third number have one bound each that counts


def same(one: spaces.Space[Any], other: spaces.Space[Any]) -> bool:
    return one == other and one.dtype == other.dtype


def test_random_actions_are_drawn_from_boxes_without_bounds_that_are_as_far_as_none() -> None:
    free = spaces.Box(
        np.array([-1.0, -np.inf, 0.0]), np.array([np.inf, 2.0, np.inf]), dtype=np.float64
    )
    assert same(tried(WIDE), free)
    steps = spaces.Box(-5, 5, (2,), dtype=np.int64)
    kept = spaces.Discrete(3), spaces.MultiBinary(2), steps
    assert all(tried(each) is each for each in kept)
    nested: list[spaces.Space[Any]] = [
        spaces.Dict({"a": spaces.Tuple((box, steps)), "b": spaces.Discrete(3)})
        for box in (WIDE, free)
    ]
    both, wanted = tried(nested[0]), nested[1]
    assert both == wanted
    assert both["a"][0].dtype == np.float64
    assert {f.name: (f.low, f.high) for f in controls_of(WIDE, "wide").fields} == {
        "action 1": (-1.0, np.inf), "action 2": (-np.inf, 2.0), "action 3": (0.0, np.inf),
    }  # fmt: skip


def test_numbers_that_cannot_vary_are_no_controls() -> None:
    box = spaces.Box(np.array([[-1, 5], [0, -2]]), np.array([[1, 5], [4, 3]]), dtype=np.int64)
    controls = controls_of(box, "box")
    assert [f.name for f in controls.fields] == ["action 1,1", "action 2,1", "action 2,2"]
    (action,) = controls.actions(np.array([[-3.0, 2.0, 7.0]]))
    assert action.tolist() == [[-1, 5], [2, 3]]
    assert action.dtype == np.int64
    with pytest.raises(DomainError, match="only numbers and choices that vary can be controls"):
        controls_of(spaces.Box(2.0, 2.0, (3,)), "still")


@pytest.mark.parametrize(
    "space",
    [
        spaces.Discrete(1),
        spaces.MultiDiscrete([1, 1]),
        spaces.Tuple([spaces.Discrete(1, start=3), spaces.Box(2.0, 2.0, (3,))]),
    ],
)
def test_an_action_with_nothing_to_choose_is_refused(space: spaces.Space[Any]) -> None:
    with pytest.raises(DomainError, match="only numbers and choices that vary can be controls"):
        controls_of(space, "still")


@pytest.mark.parametrize(
    ("low", "high", "dtype", "names"),
    [
        (950, 1050, np.float32, ("950", "1050")),
        (-1200, -1000, np.float64, ("-1200", "-1000")),
        (-1e-5, 1e-5, np.float64, ("-1e-05", "1e-05")),
        (0, 0.004, np.float32, ("0", "0.004")),
        (-3e-6, 3e-6, np.float32, ("-3e-06", "3e-06")),
        (-1e4, 1e4, np.float16, ("-1e+04", "1e+04")),
        (-1e5, 1e6, np.float64, ("-100000", "1000000")),
        (1e15, 1e15 + 8, np.float64, ("1e+15", "1e+15")),
    ],
)
def test_numbers_far_from_one_are_shares_of_their_range(
    low: float, high: float, dtype: Any, names: tuple[str, str]
) -> None:
    space = spaces.Box(dtype(low), dtype(high), (1,), dtype)
    controls = controls_of(space, "odd")
    (field,) = controls.fields
    if low < 1e15:
        assert field.name == f"action 1 from {names[0]} (-1) to {names[1]} (1)"
    assert (field.low, field.high) == (-1, 1)
    found = np.asarray(controls.actions(np.array([[-1], [0], [1], [-7], [7], [0.5]])))
    middle, half = (float(dtype(low)) + float(dtype(high))) / 2, float(dtype(high) - dtype(low)) / 2
    wanted = [middle + share * half for share in (-1, 0, 1, -1, 1, 0.5)]
    assert found.dtype == dtype
    assert found[:, 0].tolist() == pytest.approx(wanted, rel=1e-3)
    assert found[:5, 0].tolist() == [dtype(x) for x in wanted[:5]]
    assert all(space.contains(each) for each in found)


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (-2, 2), (-0.4, 0.4), (0, 1), (-100, 100), (-0.01, 0.01), (100, 200), (150, 250),
        (-np.inf, np.inf), (1000, np.inf), (-FAR, FAR), (-1e16, 1e16),
    ],
)  # fmt: skip
def test_usual_numbers_are_controls_as_they_are(low: float, high: float) -> None:
    controls = controls_of(spaces.Box(low, high, (1,), np.float64), "usual")
    assert controls.fields[0].name == "action 1"
    control = np.array([[-0.3], [0.1], [170.0]])
    assert np.array_equal(controls.actions(control), control.clip(low, high))


def test_whole_numbers_and_parts_are_shares_each_by_itself() -> None:
    low, high = np.array([[0, -3], [7, 1000]]), np.array([[1000, 3], [7, 1010]])
    part = spaces.Dict({"a": spaces.Box(low, high, dtype=np.int64), "b": spaces.Discrete(2)})
    controls = controls_of(part, "mixed")
    assert [f.name for f in controls.fields] == [
        "a 1,1 from 0 (-1) to 1000 (1)", "a 1,2", "a 2,2 from 1000 (-1) to 1010 (1)",
        "preference for b = 0", "preference for b = 1",
    ]  # fmt: skip
    assert [(f.low, f.high) for f in controls.fields[:3]] == [(-1, 1), (-3, 3), (-1, 1)]
    rows = np.array([[-1, 2.7, 1, 0, 1], [0.0017, -9, 0.1, 1, 0]], dtype=np.float32)
    one, other = controls.actions(rows)
    assert one["a"].tolist() == [[0, 2], [7, 1010]]
    assert other["a"].tolist() == [[501, -3], [7, 1006]], "shares are rounded"
    assert (one["b"], other["b"], one["a"].dtype) == (1, 0, np.int64)


@pytest.mark.filterwarnings("error")
def test_bounds_of_half_the_size_are_taken_without_a_warning() -> None:
    box = spaces.Box(np.float16(-50), np.float16(50), (2,), np.float16)
    assert tried(box) == box
    low, high = bounds_of_percepts(percepts_of(box, (), "half"))
    assert (low.tolist(), high.tolist()) == ([-50, -50], [50, 50])


def test_bounds_of_choices_are_nought_and_one() -> None:
    box = spaces.Box(np.array([-1.0, -FAR]), np.array([FAR, 2.0]), dtype=np.float64)
    both = spaces.Tuple((box, spaces.Discrete(2), spaces.MultiBinary(1)))
    low, high = bounds_of_percepts(percepts_of(both, (), "both"))
    assert low.tolist() == [-1, -np.inf, 0, 0, 0]
    assert high.tolist() == [np.inf, 2, 1, 1, 1]
    low, high = bounds_of_percepts(percepts_of(both, ("observation[1] 2", "*[3]*"), "both"))
    assert (low.tolist(), high.tolist()) == ([-np.inf, 0], [2, 1])


def test_percepts_are_copies_of_the_kind_that_was_declared() -> None:
    box = spaces.Box(-1, 1, (2, 2), dtype=np.float32)
    percepts = percepts_of(box, (), "box")
    seen = np.ones((2, 2), dtype=np.float32)
    found = percepts.of(seen)
    seen[:] = 7
    assert found.tolist() == [1.0] * 4
    assert found.dtype == np.float32
    assert (percepts.columns, percepts.left_out) == (None, {})
    with pytest.raises(ValueError, match=r"^observation has 3 numbers, not Box\("):
        percepts.of(np.ones(3))
    with pytest.raises(ValueError, match=r"^observation is of type <U"):
        percepts.of(np.array(["a"] * 4))
    every = percepts_of(box, ("observation 1,2", "observation ?,1"), "box")
    assert [field.name for field in every.fields] == [
        "observation 1,1", "observation 1,2", "observation 2,1",
    ]  # fmt: skip
    assert every.of(np.array([[1.0, 2.0], [3.0, 4.0]])).tolist() == [1, 2, 3]
    assert percepts_of(box, ("*",), "box").columns is None, "as all are taken"


@pytest.mark.parametrize(("count", "more"), [(LISTED, ""), (LISTED + 1, ", …")])
def test_a_few_parts_are_listed_where_a_pattern_matches_none(count: int, more: str) -> None:
    parts: dict[str, Any] = {f"part{i:02}": spaces.Discrete(2) for i in range(count)}
    listed = ", ".join(f"part{i:02}" for i in range(LISTED))
    with pytest.raises(DomainError) as caught:
        percepts_of(spaces.Dict(parts), ("nose",), "Long-v0")
    assert str(caught.value).endswith(f"'Long-v0' shows; it has {listed}{more}")


def test_what_has_far_too_many_numbers_is_left_out_and_no_action() -> None:
    huge, few = spaces.Discrete(2**40), spaces.Box(-1, 1, (2,))
    percepts = percepts_of(spaces.Dict(huge=huge, few=few), (), "Huge-v0")
    assert (len(percepts.fields), percepts.left_out) == (2, {"huge": "more than 200,000 numbers"})
    with pytest.raises(DomainError, match=r"observations Discrete\(.*than 200,000 numbers; wrap"):
        percepts_of(huge, (), "Huge-v0")
    with pytest.raises(DomainError, match=r"action in Discrete\(.*more than 200,000 numbers; wrap"):
        controls_of(huge, "Huge-v0")


@pytest.mark.parametrize(
    ("space", "value", "told"),
    [
        (spaces.Discrete(5), 5, r"observation has 5, and Discrete\(5\) has 0 to 4 there"),
        (spaces.Discrete(5), -1, "observation has -1, and .* 0 to 4 there"),  # not the last one
        (spaces.Discrete(5, start=1), 0, "observation has 0, and .* has 1 to 5 there"),
        (spaces.MultiDiscrete([2, 3]), [1, 3], "observation has 3, and .* has 0 to 2 there"),
        (spaces.MultiDiscrete([2, 3]), [2, 0], "observation has 2, and .* has 0 to 1 there"),
    ],
)
def test_a_choice_out_of_its_range_is_told(space: Any, value: Any, told: str) -> None:
    percepts = percepts_of(space, (), "Mine-v0")
    with pytest.raises(ValueError, match=f"{told}: is its start right"):
        percepts.of(np.array(value))
    space.seed(0)
    for _ in range(20):
        assert percepts.of(space.sample()).sum() == (1 if isinstance(space, spaces.Discrete) else 2)
